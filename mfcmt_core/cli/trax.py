"""``mfcmt trax``: the tracker for the VOT toolkit and other programs that speak TraX, which start this command.

They send file names and regions over standard input and get rectangles over standard output. Polygons and masks count
as the boxes around them. Each object has a tracker of its own.
"""

from __future__ import annotations

import argparse
import sys
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from ..config import PRESETS, MFCMTConfig
from ..errors import MFCMTError
from ..images.files import read_image
from ..result import Box, TrackResult
from ..tracker import MFCMT
from . import UsageError

MISSING = "needs the package vot-trax: pip install vot-trax"


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument("--preset", choices=PRESETS, default="default", help="configuration of the tracker")


def run(args: argparse.Namespace) -> int:
    """Serve until the client quits. Exit code 1 says that a frame or a region could not be used."""
    try:
        trax: Any = import_module("trax")
    except ImportError:
        raise UsageError(MISSING) from None
    if sys.stdin.isatty():
        raise UsageError("is started by the VOT toolkit, not by hand: see docs/integrations.md for its trackers.ini")
    config = MFCMTConfig.preset(args.preset)
    regions = [trax.Region.RECTANGLE, trax.Region.POLYGON, trax.Region.MASK]
    server = trax.Server(
        regions,
        [trax.Image.PATH],
        [trax.ImageChannel.COLOR],
        tracker_name="MFCMT",
        metadata={"vot": "python"},
        multiobject=True,
    )
    try:
        _serve(trax, server, config)
    except (MFCMTError, trax.TraxException) as failed:
        server.quit(str(failed))
        print(f"mfcmt trax: {failed}", file=sys.stderr)
        return 1
    server.quit()
    return 0


def box_of(trax: Any, region: Any) -> Box:
    """Return the box (x, y, w, h) around a region of TraX, in pixels."""
    if region.type == trax.Region.RECTANGLE:
        x, y, w, h = region.bounds()
        return x, y, w, h
    if region.type == trax.Region.POLYGON:
        corners = np.array(list(region), float).reshape(-1, 2)
        (x, y), (right, bottom) = corners.min(0), corners.max(0)
        return float(x), float(y), float(right - x), float(bottom - y)
    if region.type != trax.Region.MASK:
        raise MFCMTError("a region is a rectangle, a polygon or a mask")
    rows, columns = np.nonzero(region.array())
    if not len(rows):
        raise MFCMTError("the mask is empty: nothing is there to follow")
    left, top = region.offset()
    x, y = columns.min(), rows.min()
    return float(left + x), float(top + y), float(columns.max() + 1 - x), float(rows.max() + 1 - y)


def _serve(trax: Any, server: Any, config: MFCMTConfig) -> None:
    """Answer each request with a rectangle and a confidence for each object."""
    trackers: list[MFCMT] = []
    while (request := server.wait()).type in (trax.TraxStatus.INITIALIZE, trax.TraxStatus.FRAME):
        image = read_image(Path(next(iter(request.image.values())).path()), turned=False)
        begins = request.type == trax.TraxStatus.INITIALIZE
        results = [] if begins else [tracker.update(image) for tracker in trackers]
        if begins:
            trackers = []
        for region, _ in request.objects or ():
            tracker = MFCMT(config)
            results.append(tracker.init(image, box_of(trax, region)))
            trackers.append(tracker)
        server.status([_answer(trax, result) for result in results])


def _answer(trax: Any, result: TrackResult) -> tuple[Any, dict[str, str]]:
    return trax.Rectangle.create(*result.box), {"confidence": f"{result.confidence:.6f}", "status": result.status}
