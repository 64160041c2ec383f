"""Sequences of frames with ground truth, and the OTB benchmark as it is distributed."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from functools import cached_property
from importlib import resources
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ..errors import DataError, NoData
from ..images.files import BadImageFile, list_images, read_image
from .metrics import Array, Mask
from .video import SUFFIXES as VIDEO_SUFFIXES
from .video import read_video_frame

Image = npt.NDArray[np.uint8]

ONE_BASED: Array = np.array([1.0, 1.0, 0.0, 0.0])
"""What a box of a file (MATLAB's pixels, 1-based) has more than one of ours."""

NO_AREA: Array = np.array([-np.inf, -np.inf, 0.0, 0.0])
"""A box needs more than this to be one."""

ATTRIBUTES = {
    "IV": "illumination variation",
    "OPR": "out-of-plane rotation",
    "SV": "scale variation",
    "OCC": "occlusion",
    "DEF": "deformation",
    "MB": "motion blur",
    "FM": "fast motion",
    "IPR": "in-plane rotation",
    "OV": "out of view",
    "BC": "background clutter",
    "LR": "low resolution",
}
"""The 11 attributes in the order of the toolkit."""


@dataclass(frozen=True, eq=False)
class Sequence:
    """One target: its frames and where it is in them.

    ``boxes`` is ``(N, 4)`` float64, x, y, w, h in pixels, 0-based. ``valid`` is ``(N,)`` and tells the frames
    with a usable annotation, ``startable`` those on which a run of TRE may start. Frames that are not valid
    count the OTB way (lost for success, found for precision) unless ``skip_invalid``. ``first`` is the number
    of the first frame in its folder. ``frames`` is empty where only annotations are at hand; of a video it names
    the file once for each frame.
    """

    name: str
    frames: tuple[Path, ...]
    boxes: Array
    valid: Mask
    startable: Mask
    first: int = 1
    sets: frozenset[str] = frozenset()
    attributes: tuple[str, ...] = ()
    skip_invalid: bool = False

    @classmethod
    def of(cls, name: str, frames: Iterable[Path], boxes: Array, first: int = 1) -> Sequence:
        """Return a sequence with 0-based boxes ``(N, 4)``; a frame whose box has no area or NaN is not scored.

        Raises DataError if no frame has a box.
        """
        valid: Mask = np.all(np.isfinite(boxes) & (boxes > NO_AREA), axis=1)
        if not valid.any():
            raise DataError(f"{name}: no frame has a valid annotation")
        return cls(name, tuple(frames), boxes, valid, valid, first, skip_invalid=True)

    def __len__(self) -> int:
        return len(self.boxes)

    @property
    def last(self) -> int:
        """Return the number of the last frame in its folder."""
        return self.first + len(self) - 1

    @property
    def is_video(self) -> bool:
        """Return whether the frames are those of one video file."""
        return bool(self.frames) and self.frames[0].suffix.lower() in VIDEO_SUFFIXES

    @property
    def source(self) -> str:
        """Return the data set that its name gives, ``VOT`` of ``VOT-bag``; an empty string if it gives none."""
        return self.name.partition("-")[0] if self.is_video and "-" in self.name else ""

    @cached_property
    def image_size(self) -> tuple[int, int] | None:
        """Return width and height of the frames in pixels; None without frames."""
        if not self.frames:
            return None
        height, width = self.read(0).shape[:2]
        return width, height

    def read(self, index: int) -> Image:
        """Decode a frame: ``(H, W, 3)`` uint8, BGR. Raises DataError for a file that is no whole image."""
        if self.is_video:
            return read_video_frame(self.frames[index], index)
        try:
            return read_image(self.frames[index])
        except BadImageFile as bad:
            raise DataError(str(bad)) from bad


@dataclass(frozen=True)
class Dataset:
    """Sequences by name, in the benchmark's order. ``missing`` are those that are not there."""

    name: str
    sequences: dict[str, Sequence]
    missing: tuple[str, ...] = ()
    root: Path = field(default_factory=Path)

    def __len__(self) -> int:
        return len(self.sequences)

    def __iter__(self) -> Iterator[Sequence]:
        return iter(self.sequences.values())

    def __getitem__(self, name: str) -> Sequence:
        return self.sequences[name]

    @property
    def coverage(self) -> str:
        """Return ``"29 of 100"`` if some sequences are missing, else ``"100"``."""
        total = len(self) + len(self.missing)
        return f"{len(self)} of {total}" if self.missing else str(total)

    def select(self, names: Iterable[str]) -> Dataset:
        """Return the data set with the named sequences alone. Raises DataError for a name that is not there."""
        names = list(names)
        if unknown := [n for n in names if n not in self.sequences]:
            raise DataError(f"{self.name} at {self.root} has no {', '.join(unknown)}")
        return Dataset(f"part of {self.name}", {n: self.sequences[n] for n in names}, (), self.root)


@dataclass(frozen=True)
class OtbTarget:
    """A target of OTB: frame numbers, sets, attributes, frames where TRE does not start."""

    name: str
    first: int
    last: int
    sets: frozenset[str]
    attributes: tuple[str, ...]
    omit: tuple[tuple[int, int], ...]


def otb_targets(subset: str = "OTB-2015") -> list[OtbTarget]:
    """Return the targets of ``OTB-2015`` (100), ``OTB-2013`` (51) or ``TB-50``, in the benchmark's order."""
    text = resources.files(__package__).joinpath("data/otb100.csv").read_text(encoding="utf-8")
    targets = [
        OtbTarget(
            row["name"],
            int(row["first"]),
            int(row["last"]),
            frozenset(["OTB-2015", *row["sets"].split()]),
            tuple(row["attributes"].split()),
            tuple((int(a), int(b)) for a, b in (span.split("-") for span in row["omit"].split())),
        )
        for row in csv.DictReader(text.splitlines())
    ]
    return [t for t in targets if subset in t.sets]


def open_otb(root: Path, subset: str = "OTB-2015") -> Dataset:
    """Open OTB as it is distributed, or a folder of annotations alone (``<Sequence>.txt``).

    Raises NoData if no target of ``subset`` is in ``root``, and DataError if a sequence is there and cannot be used.
    """
    places = locate_otb(root, subset)
    found = {target.name: _open_target(target, place) for target, place in places.items() if place}
    if not found:
        raise NoData(f"{root}: none of the {len(places)} targets of {subset} is here")
    return Dataset(subset, found, tuple(t.name for t, place in places.items() if not place), root)


def locate_otb(root: Path, subset: str = "OTB-2015") -> dict[OtbTarget, Path | None]:
    """Return the folder or the annotation file of each target, None if it is missing; any usual spelling counts."""
    if not root.is_dir():
        raise DataError(f"{root}: no such folder")
    entries = {entry.name.lower(): entry for entry in sorted(root.iterdir())}
    places: dict[OtbTarget, Path | None] = {}
    for target in otb_targets(subset):
        base, dash, number = target.name.lower().partition("-")
        spellings = [
            base + dash + number,
            *([f"{base}.{number}", f"{base}_{number}", base + number, base] if dash else []),
        ]
        names = [name for spelling in spellings for name in (spelling, f"{spelling}.txt")]
        places[target] = next((entries[name] for name in names if name in entries), None)
    return places


def _open_target(target: OtbTarget, place: Path) -> Sequence:
    frames: tuple[Path, ...] = ()
    if place.is_dir():
        if not (place / "img").is_dir() and (place / place.name / "img").is_dir():
            place = place / place.name  # some archives nest the folder in one of its own name
        truth = _truth_file(place, target.name.partition("-")[2])
        frames = numbered_images(place / "img", target.first, target.last)
    else:
        truth = place
    lines = read_boxes(truth)
    if len(lines) >= target.last:  # one line a frame from number 1 on
        lines = lines[target.first - 1 : target.last]
    if len(lines) != target.last - target.first + 1:
        raise DataError(f"{truth}: {len(lines)} boxes for the frames {target.first} to {target.last}")
    numbers = np.arange(target.first, target.last + 1)
    omitted = np.zeros(len(lines), bool)
    for begin, end in target.omit:
        omitted |= (numbers >= begin) & (numbers <= end)
    valid = np.all(lines > 0, axis=1)  # the toolkit's rule: all four numbers, 1-based, above zero
    if not valid.any():
        raise DataError(f"{truth}: no frame has a valid annotation")
    return Sequence(
        target.name, frames, lines - ONE_BASED, valid, valid & ~omitted, target.first, target.sets, target.attributes
    )


def _truth_file(folder: Path, number: str) -> Path:
    names = ["groundtruth_rect.txt"]
    if number:
        names.insert(0, f"groundtruth_rect.{number}.txt")
    for name in names:
        if (folder / name).is_file():
            return folder / name
    raise DataError(f"{folder}: has no {' or '.join(names)}")


def numbered_images(folder: Path, first: int, last: int) -> tuple[Path, ...]:
    """Return the images ``first`` to ``last`` by the numbers in their names, however many digits these have.

    A folder that was numbered anew but has exactly as many images is taken as it is.
    Raises DataError if one of them is missing.
    """
    images = list_images(folder)
    by_number = {_number(p): p for p in images}
    wanted = range(first, last + 1)
    absent = [n for n in wanted if n not in by_number]
    if not absent:
        return tuple(by_number[n] for n in wanted)
    if len(images) == len(wanted):
        return tuple(images)
    raise DataError(f"{folder}: {len(absent)} of the images {first} to {last} are missing, first number {absent[0]}")


def _number(path: Path) -> int:
    digits = re.findall(r"\d+", path.stem)
    return int(digits[-1]) if digits else -1


def read_boxes(path: Path, columns: tuple[int, ...] = (4,)) -> Array:
    """Return the boxes of a text file: one a line, numbers separated by comma, tab or space.

    NaN is allowed. Empty lines at the end are ignored. ``columns`` are the counts of numbers that a line may have;
    the result is float64 of shape ``(N, count)``. Raises DataError, which names the file and the line.
    """
    try:
        lines = path.read_text(encoding="utf-8-sig").rstrip().splitlines()
    except (OSError, UnicodeDecodeError) as failed:
        raise DataError(f"{path}: {failed}") from None
    rows = []
    for number, line in enumerate(lines, 1):
        try:
            row = [float(f) for f in line.replace(",", " ").split()]
        except ValueError:
            raise DataError(f"{path}:{number}: not numbers: {line.strip()[:60]!r}") from None
        if len(row) not in columns:
            wanted = " or ".join(map(str, columns))
            raise DataError(f"{path}:{number}: {len(row)} numbers where {wanted} are wanted: {line.strip()[:60]!r}")
        rows.append(row)
    if not rows:
        raise DataError(f"{path}: is empty")
    if len({len(row) for row in rows}) > 1:
        odd = next(n for n, row in enumerate(rows, 1) if len(row) != len(rows[0]))
        raise DataError(f"{path}:{odd}: {len(rows[odd - 1])} numbers after lines of {len(rows[0])}")
    return np.array(rows, dtype=np.float64)
