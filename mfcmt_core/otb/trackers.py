"""What takes part in an evaluation: our own engine by configuration, peers, and folders of result files."""

from __future__ import annotations

import ast
import functools
import hashlib
import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from ..config import MFCMTConfig
from ..errors import DataError
from ..geometry import Image
from ..tracker import MFCMT
from .dataset import read_boxes
from .results import Record, read_record
from .score import Speed
from .trust import STATUSES


class Tracker(Protocol):
    """What the runner asks of a tracker: boxes are x, y, w, h, 0-based; images are BGR.

    ``update`` returns a box or something with a ``box``. A tracker that knows how sure it is has a number
    ``confidence``, and perhaps a ``status``, on that or on itself.
    """

    def init(self, image: Image, box: Iterable[float]) -> Any:
        """Start on the box."""

    def update(self, image: Image) -> Any:
        """Find the target in the next frame."""


def said(result: Any, tracker: Tracker) -> tuple[float, float]:
    """Return how sure a tracker is of its last result, and the index of its status; NaN for what it does not say.

    Both are looked for as ``confidence`` and ``status`` on the result, then on the tracker.
    """
    confidence = getattr(result, "confidence", getattr(tracker, "confidence", None))
    status = getattr(result, "status", getattr(tracker, "status", None))
    return (
        float("nan") if confidence is None else float(confidence),
        float(STATUSES.index(status)) if status in STATUSES else float("nan"),
    )


class Entry(Protocol):
    """A tracker by name that can be made anew for each run, also in another process (it is pickled)."""

    @property
    def name(self) -> str:
        """Return its label, which is also the name of its folder of results."""

    @property
    def identity(self) -> dict[str, Any]:
        """Return configuration and a hash of the code as values for JSON; results are kept while both stay the same."""

    def make(self) -> Tracker:
        """Return a tracker that has not started."""


@dataclass(frozen=True)
class Engine:
    """Our own tracker with one configuration."""

    name: str
    config: MFCMTConfig

    @property
    def identity(self) -> dict[str, Any]:
        table = self.config.color_name_table
        more = {"table": hashlib.sha256(Path(table).read_bytes()).hexdigest()} if table else {}
        return {"code": code_hash(), "config": self.config.to_dict(), **more}

    def make(self) -> Tracker:
        return MFCMT(self.config)


@dataclass(frozen=True)
class ResultFolder:
    """Boxes of any tracker as text files, ``<folder>/<Sequence>.txt``, 1-based.

    ``{protocol}`` in the folder stands for OPE, TRE or SRE.
    """

    name: str
    folder: Path

    def under(self, protocol: str) -> ResultFolder:
        """Return the folder for a protocol."""
        return ResultFolder(self.name, Path(str(self.folder).replace("{protocol}", protocol)))

    def find(self, sequence: str, key: str) -> Path:
        """Return the file of a run. Raises DataError if there is none."""
        base, dash, number = sequence.partition("-")
        spellings = [sequence] + ([f"{base}.{number}", f"{base}_{number}", f"{base}{number}"] if dash else [])
        suffix = f".{key}.txt" if key else ".txt"
        for name in [s + suffix for s in spellings]:
            for path in (self.folder / name, self.folder / (name[0].lower() + name[1:])):
                if path.is_file():
                    return path
        raise DataError(f"{self.folder}: has no {sequence}{suffix}")

    def record(self, sequence: str) -> Record | None:
        """Return how the files were made; None if they are not our own."""
        return read_record(self.folder / f"{sequence}.json")

    def speed(self, sequence: str) -> Speed | None:
        """Return the speed by the record or ``times/<Sequence>_time.txt``, got10k's seconds a frame; None without."""
        if (record := self.record(sequence)) is not None:
            return record.speed
        path = self.folder / "times" / f"{sequence}_time.txt"
        if not path.is_file():
            return None
        seconds = read_boxes(path, (1,))[:, 0]
        seconds = seconds[seconds > 0]
        rate = float(np.mean(1 / seconds)) if len(seconds) else 0.0
        return Speed(len(seconds), float(seconds.sum()), rate) if len(seconds) else None


BESIDE_THE_TRACKER = {"otb", "cli", "synthetic", "adapters.py"}
"""Parts of the package that do not change what the tracker does."""


@functools.cache
def code_hash() -> str:
    """Return a hash of the tracker's source, 16 hex digits: comments, docstrings and layout do not change it."""
    package = Path(__file__).resolve().parents[1]
    digest = hashlib.sha256()
    for path in sorted(package.rglob("*.py")):
        part = path.relative_to(package)
        if part.parts[0] not in BESIDE_THE_TRACKER:
            tree = _WithoutStrings().visit(ast.parse(path.read_text(encoding="utf-8")))
            digest.update(f"{part}\n{ast.dump(tree)}\n".encode())
    return digest.hexdigest()[:16]


class _WithoutStrings(ast.NodeTransformer):
    """Drops strings that stand alone: docstrings and the notes under fields."""

    def visit_Expr(self, node: ast.Expr) -> ast.Expr | None:
        return None if isinstance(node.value, ast.Constant) and isinstance(node.value.value, str) else node


def identity_hash(identity: dict[str, Any]) -> str:
    """Return a short hash of an :attr:`Entry.identity`."""
    return hashlib.sha256(json.dumps(identity, sort_keys=True, default=str).encode()).hexdigest()[:16]
