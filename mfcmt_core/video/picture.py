"""Convert decoded pictures to pixels as FFmpeg's command does: turned upright, 8 bits, BGR."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from . import turn
from .errors import VideoError
from .library import library

Image = npt.NDArray[np.uint8]


class Converter:
    """Converts the pictures of one stream. The filters are made again when a picture has another form."""

    def __init__(self) -> None:
        self._form: tuple[object, ...] = ()
        self._graph: Any = None

    def convert(self, picture: Any) -> Image:
        """Return ``(H, W, 3)`` uint8 pixels, BGR, of an ``av.VideoFrame``. Raises VideoError for an odd rotation."""
        av = library()
        beside = picture.side_data.get(av.sidedata.sidedata.Type.DISPLAYMATRIX)
        matrix = None if beside is None else bytes(beside)
        form = (
            picture.width,
            picture.height,
            picture.format.name,
            int(picture.colorspace),
            int(picture.color_range),
            matrix,
        )
        if form != self._form:
            self._graph, self._form = self._filters(*form), form
        picture.pts = None  # it is not needed here, and filters refuse odd ones
        self._graph.push(picture)
        return np.ascontiguousarray(self._graph.vpull().to_ndarray())

    @staticmethod
    def _filters(width: int, height: int, pixels: str, matrix_name: int, span: int, display: bytes | None) -> Any:
        turns = turn.filters(display)
        if turns is None:
            raise VideoError("the picture is to be shown turned by an angle that is no multiple of 90 degrees")
        graph = library().filter.Graph()
        graph.threads = 1
        nodes = [
            graph.add(
                "buffer",
                video_size=f"{width}x{height}",
                pix_fmt=pixels,
                time_base="1/1000",
                colorspace=str(matrix_name),
                range=str(span),
            )
        ]
        nodes += [graph.add(name, argument) for name, argument in turns]
        nodes += [graph.add("format", "bgr24"), graph.add("buffersink")]
        graph.link_nodes(*nodes).configure()
        return graph
