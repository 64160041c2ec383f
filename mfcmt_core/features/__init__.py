"""The template features of section III-A on one grid of cells: raw pixels, fHOG and color names.

Each cue is a block of planes of one stack, ``(cells, channels, cells)`` float32, rows first, times the Hann window.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ..config import MFCMTConfig
from ..geometry import CELL, Image
from ..kernels.cells import color_name_cells, gray_cells
from ..kernels.hog import CHANNELS, SIGNED, hog_cells
from ..workspace import scratch
from .color_names import table


def usable_cues(config: MFCMTConfig, is_gray: bool) -> tuple[str, ...]:
    """Return the cues of a configuration that work on the target: a gray one has no color names."""
    return tuple(cue for cue in config.features if not (is_gray and cue == "color_names"))


def hann_window(cells: int) -> npt.NDArray[np.float32]:
    """Return the separable Hann window (cells, cells) float32, without its border of zeros."""
    hann = np.hanning(cells + 2)[1:-1]
    return np.outer(hann, hann).astype(np.float32)


class FeatureStack:
    """Extracts the usable cues of a configuration. ``blocks`` maps each of them to its feature planes."""

    def __init__(self, config: MFCMTConfig, is_gray: bool) -> None:
        self.cells = config.patch_size // CELL
        self.hann = hann_window(self.cells)
        self.epsilon = np.float32(config.hog_epsilon)
        self.blocks: dict[str, slice] = {}
        cues = usable_cues(config, is_gray)
        widths = {"gray": 1, "fhog": CHANNELS}
        if "color_names" in cues:
            self.names = table(config.color_name_table)
            widths["color_names"] = self.names.shape[1]
        start = 0
        for cue in cues:
            self.blocks[cue] = slice(start, start + widths[cue])
            start += widths[cue]
        self.channels = start

    def extract(self, patch: Image, gray: Image) -> npt.NDArray[np.float32]:
        """Return the windowed features of a patch, (cells, channels, cells) float32: rows, planes, columns.

        ``patch`` is (H, W) or (H, W, 3) uint8 and ``gray`` (H, W) its gray version. The array is scratch until the
        next call.
        """
        n, side = self.cells, self.cells * CELL
        if len(patch) != side:  # 150 pixels hold 37 cells; the rest is left out
            margin = (len(patch) - side) // 2
            patch, gray = (
                np.ascontiguousarray(p[margin : margin + side, margin : margin + side]) for p in (patch, gray)
            )
        out = scratch("features", (n, self.channels, n))
        if block := self.blocks.get("gray"):
            gray_cells(gray, self.hann, block.start, out)
        if block := self.blocks.get("fhog"):
            hog_cells(
                gray,
                self.hann,
                self.epsilon,
                block.start,
                scratch("magnitude", (side, side)),
                scratch("orientation", (side, side), np.uint8),
                scratch("rows", (4, SIGNED, n + 2)),
                scratch("cells", (n, SIGNED, n + 2)),
                scratch("norms", (n + 1, n + 1)),
                out,
            )
        if block := self.blocks.get("color_names"):
            color_name_cells(patch, self.names, self.hann, block.start, out)
        return out
