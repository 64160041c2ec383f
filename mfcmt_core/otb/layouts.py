"""Data sets other than OTB: GOT-10k, VOT, UAV123 and plain folders with a ground-truth file.

Frames without a usable annotation (absent targets) are left out of their scores, as their own toolkits do.
"""

from __future__ import annotations

import csv
from collections.abc import Callable
from dataclasses import replace
from importlib import resources
from pathlib import Path

import numpy as np

from ..errors import DataError, NoData
from ..images.files import list_images
from .dataset import (
    ONE_BASED,
    Dataset,
    Sequence,
    locate_otb,
    numbered_images,
    open_otb,
    read_boxes,
)
from .metrics import Array
from .video import SUFFIXES as VIDEO_SUFFIXES
from .video import count_frames

ZERO_BASED: Array = np.zeros(4)

TRUTH_FILES = ("groundtruth.txt", "groundtruth_rect.txt", "gt.txt")
IMAGE_FOLDERS = ("", "img", "color", "imgs", "images")


def open_dataset(root: Path, layout: str = "auto", subset: str = "OTB-2015") -> Dataset:
    """Open the data set in a folder.

    Parameters
    ----------
    root : Path
        The folder.
    layout : str, optional
        A name of :data:`LAYOUTS`, or ``auto``, which finds the layout by what is in the folder.
    subset : str, optional
        ``OTB-2015``, ``OTB-2013`` or ``TB-50``; only OTB has subsets.

    Returns
    -------
    Dataset
        Its boxes are 0-based, in pixels, whatever the files count from.

    Raises
    ------
    NoData
        The folder has no sequence of this layout.
    DataError
        The folder does not exist, or a sequence in it cannot be used.
    """
    if not root.is_dir():
        raise DataError(f"{root}: no such folder")
    if layout == "auto":
        layout = detect(root)
    return open_otb(root, subset) if layout == "otb" else LAYOUTS[layout](root)


def detect(root: Path) -> str:
    """Return the layout of a folder by the files and folders that only this layout has."""
    if (root / "anno" / "UAV123").is_dir():
        return "uav123"
    if any(p.is_dir() and p.name.startswith("GOT-10k_") for p in root.iterdir()):
        return "got10k"
    if any(locate_otb(root).values()):
        return "otb"
    if (root / "list.txt").is_file() and any(p.is_file() for p in root.glob("*/groundtruth.txt")):
        return "vot"
    return "videos" if _videos(root) else "plain"


def open_got10k(root: Path) -> Dataset:
    """Open ``GOT-10k_*/groundtruth.txt`` beside the images; the boxes count from 0 (taken as they are)."""
    folders = sorted(p for p in root.iterdir() if p.is_dir() and (p / "groundtruth.txt").is_file())
    return _gathered("GOT-10k", root, {p.name: _sequence(p.name, p) for p in folders})


def open_vot(root: Path) -> Dataset:
    """Open folders named by ``list.txt``: rectangles or polygons (their upright bounding box), counted from 0."""
    listing = root / "list.txt"
    names = listing.read_text(encoding="utf-8").split() if listing.is_file() else sorted(p.name for p in root.iterdir())
    folders = {name: root / name for name in names if (root / name / "groundtruth.txt").is_file()}
    found = _gathered("VOT", root, {n: _sequence(n, p) for n, p in folders.items()})
    return replace(found, missing=tuple(n for n in names if n not in folders) if listing.is_file() else ())


def open_uav123(root: Path) -> Dataset:
    """Open ``anno/UAV123/<name>.txt`` over ``data_seq/UAV123/<folder>``, counted from 1; NaN is an absent target."""
    text = resources.files(__package__).joinpath("data/uav123.csv").read_text(encoding="utf-8")
    parts = {row["name"]: (row["folder"], int(row["first"])) for row in csv.DictReader(text.splitlines())}
    found, missing = {}, []
    for path in sorted((root / "anno" / "UAV123").glob("*.txt")):
        folder, first = parts.get(path.stem, (path.stem, 1))
        images = root / "data_seq" / "UAV123" / folder
        if not images.is_dir():
            missing.append(path.stem)
            continue
        boxes = read_boxes(path) - ONE_BASED
        frames = numbered_images(images, first, first + len(boxes) - 1)
        found[path.stem] = Sequence.of(path.stem, frames, boxes, first)
    return replace(_gathered("UAV123", root, found), missing=tuple(missing))


def open_plain(root: Path) -> Dataset:
    """Open each folder that has a ground-truth file, counted from 1, and ``root`` itself if it has one."""
    folders = [p for p in (root, *sorted(root.iterdir())) if p.is_dir() and _truth(p) is not None]
    return _gathered(
        root.resolve().name, root, {p.resolve().name: _sequence(p.resolve().name, p, ONE_BASED) for p in folders}
    )


def open_videos(root: Path) -> Dataset:
    """Open ``<name>.mp4`` beside ``<name>.txt``, whose boxes count from 0; NaN is an absent target."""
    found = {}
    for path in _videos(root):
        boxes = read_boxes(path.with_suffix(".txt"))
        frames = count_frames(path)
        if frames is not None and frames != len(boxes):
            raise DataError(f"{path.with_suffix('.txt')}: {len(boxes)} boxes for {frames} frames")
        found[path.stem] = Sequence.of(path.stem, [path] * len(boxes), boxes)
    return _gathered(root.resolve().name, root, found)


def _videos(root: Path) -> list[Path]:
    """Return the videos of a folder that have a text file of their name beside them."""
    videos = (p for p in root.iterdir() if p.suffix.lower() in VIDEO_SUFFIXES and not p.name.startswith("."))
    return sorted(p for p in videos if p.with_suffix(".txt").is_file())


LAYOUTS: dict[str, Callable[[Path], Dataset]] = {
    "otb": open_otb,
    "got10k": open_got10k,
    "vot": open_vot,
    "uav123": open_uav123,
    "videos": open_videos,
    "plain": open_plain,
}


def _sequence(name: str, folder: Path, origin: Array = ZERO_BASED) -> Sequence:
    truth = _truth(folder)
    assert truth is not None
    boxes = _upright(read_boxes(truth, (4, 8))) - origin
    images = next((found for sub in IMAGE_FOLDERS if (found := list_images(folder / sub))), [])
    if len(images) != len(boxes):
        raise DataError(f"{truth}: {len(boxes)} boxes for {len(images)} images")
    return Sequence.of(name, images, boxes)


def _truth(folder: Path) -> Path | None:
    return next((folder / name for name in TRUTH_FILES if (folder / name).is_file()), None)


def _upright(lines: Array) -> Array:
    """Return the rectangles around polygons of four corners."""
    if lines.shape[1] == 4:
        return lines
    x, y = lines[:, 0::2], lines[:, 1::2]
    return np.stack([x.min(1), y.min(1), np.ptp(x, axis=1), np.ptp(y, axis=1)], axis=1)


def _gathered(name: str, root: Path, sequences: dict[str, Sequence]) -> Dataset:
    if not sequences:
        raise NoData(f"{root}: no sequence of {name} is here")
    return Dataset(name, sequences, (), root)
