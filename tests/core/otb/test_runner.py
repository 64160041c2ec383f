"""Running trackers: what is finished is kept, what fails loses only its sequence."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mfcmt_core.geometry import Image
from mfcmt_core.otb import DataError, Dataset, ResultFolder, ResultStore, evaluate, open_otb
from mfcmt_core.otb.dataset import ONE_BASED
from mfcmt_core.otb.results import read_result, read_trust, trust_path
from mfcmt_core.otb.runner import judged


class Still:
    """Stays where it began; fails on purpose on frames of one width."""

    def __init__(self, fail_at_width: int, how: str) -> None:
        self._fail_at_width = fail_at_width
        self._how = how

    def init(self, image: Image, box: Iterable[float]) -> None:
        self._box = tuple(box)

    def update(self, image: Image) -> tuple[float, ...]:
        if image.shape[1] == self._fail_at_width:
            if self._how == "raise":
                raise RuntimeError("I am lost")
            if self._how == "die":
                os.kill(os.getpid(), signal.SIGKILL)
            if self._how == "interrupt":
                raise KeyboardInterrupt
        return self._box


@dataclass(frozen=True)
class Made:
    """An entry whose every start is counted, in this process."""

    name: str = "still"
    version: int = 1
    fail_at_width: int = 0
    how: str = ""
    starts: list[int] = field(default_factory=list, compare=False)

    @property
    def identity(self) -> dict[str, Any]:
        return {"code": "still", "config": {"version": self.version}}

    def make(self) -> Still:
        self.starts.append(1)
        return Still(self.fail_at_width, self.how)


@pytest.fixture(scope="module")
def three(otb_root: Path) -> Dataset:
    """Deer is 704 pixels wide, Crossing 360, Football1 352."""
    return open_otb(otb_root).select(["Deer", "Crossing", "Football1"])


@pytest.mark.parametrize("protocol", ["OPE", "TRE", "SRE", "STARTS"])
def test_finished_work_is_kept_until_code_or_config_change(three: Dataset, tmp_path: Path, protocol: str) -> None:
    dataset = three.select(["Football1"])
    first = Made()
    (before,) = evaluate(dataset, [first], protocol, results=tmp_path, jobs=1)
    assert sum(first.starts) > 0
    again = Made()
    (after,) = evaluate(dataset, [again], protocol, results=tmp_path, jobs=1)
    assert not again.starts
    assert after.success == before.success
    assert after.fps == pytest.approx(before.fps)
    changed = Made(version=2)
    evaluate(dataset, [changed], protocol, results=tmp_path, jobs=1)
    assert sum(changed.starts) == sum(first.starts)


def test_a_lost_file_is_made_again(three: Dataset, tmp_path: Path) -> None:
    evaluate(three, [Made()], results=tmp_path, jobs=1)
    (tmp_path / "OPE" / "still" / "Deer.txt").unlink()
    again = Made()
    (result,) = evaluate(three, [again], results=tmp_path, jobs=1)
    assert sum(again.starts) == 2  # one of them to warm up
    assert len(result.scores) == 3


def test_processes_give_what_one_process_gives(three: Dataset, tmp_path: Path) -> None:
    steps: list[tuple[int, int]] = []
    (apart,) = evaluate(
        three,
        [Made()],
        "TRE",
        results=tmp_path,
        jobs=2,
        progress=lambda done, total: steps.append((done, total)),
    )
    (alone,) = evaluate(three, [Made()], "TRE", jobs=1)
    assert {n: s.success for n, s in apart.scores.items()} == {n: s.success for n, s in alone.scores.items()}
    assert steps[-1][0] == steps[-1][1] > 0


@pytest.mark.parametrize(
    ("jobs", "how", "says"), [(1, "raise", "I am lost"), (2, "raise", "I am lost"), (2, "die", "died")]
)
def test_a_tracker_that_fails_loses_only_its_sequence(
    three: Dataset, tmp_path: Path, jobs: int, how: str, says: str
) -> None:
    (result,) = evaluate(three, [Made(fail_at_width=360, how=how)], results=tmp_path, jobs=jobs)
    assert sorted(result.scores) == ["Deer", "Football1"]
    assert says in result.missing["Crossing"]
    if how == "raise":
        assert "Crossing, frame 2: RuntimeError" in result.missing["Crossing"]
    record = ResultStore(tmp_path).record("OPE", "still", "Crossing")
    assert record is not None
    assert record.error == result.missing["Crossing"]
    # and it is tried again
    (mended,) = evaluate(three, [Made()], results=tmp_path, jobs=1)
    assert not mended.missing


def test_an_interrupt_keeps_what_is_finished(three: Dataset, tmp_path: Path) -> None:
    """Crossing (120 frames) goes first, then Football1 (74), then Deer (71)."""
    with pytest.raises(KeyboardInterrupt):
        evaluate(three, [Made(fail_at_width=704, how="interrupt")], results=tmp_path, jobs=1)
    again = Made()
    (result,) = evaluate(three, [again], results=tmp_path, jobs=1)
    assert sum(again.starts) == 2
    assert len(result.scores) == 3


def test_results_take_part_as_a_folder(three: Dataset, tmp_path: Path) -> None:
    for protocol in ("OPE", "SRE"):
        (ours,) = evaluate(three, [Made()], protocol, results=tmp_path, jobs=1)
        (theirs,) = evaluate(three, [ResultFolder("copy", tmp_path / protocol / "still")], protocol)
        assert theirs.success == pytest.approx(ours.success, abs=1e-12)


@pytest.mark.parametrize("tool", ["got10k", "pysot"])
def test_results_of_other_tools_take_part_as_a_folder(three: Dataset, tmp_path: Path, tool: str) -> None:
    """got10k writes three decimals, pysot ``str`` of each number; both keep the files' 1-based boxes."""
    (ours,) = evaluate(three, [Made()], jobs=1, results=tmp_path / "ours")
    folder = tmp_path / tool / "OTB100" / "still"
    folder.mkdir(parents=True)
    for name in three.sequences:
        boxes = read_result(tmp_path / "ours" / "OPE" / "still" / f"{name}.txt", three[name]) + ONE_BASED
        if tool == "got10k":
            np.savetxt(folder / f"{name}.txt", boxes, fmt="%.3f", delimiter=",")
        else:
            (folder / f"{name}.txt").write_text("".join(",".join(map(str, map(float, box))) + "\n" for box in boxes))
    (theirs,) = evaluate(three, [ResultFolder(tool, folder)])
    assert theirs.success == pytest.approx(ours.success, abs=1e-12)


def test_scores_of_a_still_tracker_are_what_the_truth_says(three: Dataset) -> None:
    (result,) = evaluate(three, [Made()], jobs=1)
    deer = three["Deer"]
    distance = np.linalg.norm((deer.boxes - deer.boxes[0])[:, :2] + (deer.boxes - deer.boxes[0])[:, 2:] / 2, axis=1)
    assert result.scores["Deer"].precision == pytest.approx(float((distance <= 20).mean()))
    assert result.fps is not None
    assert result.mean_rate is not None
    assert result.mean_rate >= result.fps * 0.5


@dataclass(frozen=True)
class Sure:
    """A box with what the tracker thinks of it."""

    box: tuple[float, ...]
    confidence: float
    status: str


class Boasting(Still):
    """Stays where it began and is sure of it; counts its frames in the confidence."""

    def init(self, image: Image, box: Iterable[float]) -> None:
        super().init(image, box)
        self._frames = 0

    def update(self, image: Image) -> Any:
        self._frames += 1
        return Sure(super().update(image), 1 / self._frames, "tracking")


@dataclass(frozen=True)
class Boaster(Made):
    def make(self) -> Still:
        return Boasting(0, "")


def test_what_a_tracker_says_of_its_boxes_is_kept(three: Dataset, tmp_path: Path) -> None:
    evaluate(three, [Boaster("boaster"), Made("still")], results=tmp_path, jobs=1)
    said = judged(Boaster("boaster"), three, "OPE", tmp_path)
    assert [j.name for j in said] == [s.name for s in three]
    for j, sequence in zip(said, three, strict=True):
        assert len(j.overlap) == sequence.valid.sum() - 1  # the first box is given
        assert j.confidence[:3] == pytest.approx([1, 1 / 2, 1 / 3], rel=1e-5)
        assert (j.status == 0).all()
    assert judged(Made("still"), three, "OPE", tmp_path) == []


def test_a_file_of_confidences_that_is_broken_is_named(three: Dataset, tmp_path: Path) -> None:
    evaluate(three, [Boaster("boaster")], results=tmp_path, jobs=1)
    sequence = next(iter(three))
    path = tmp_path / "OPE" / "boaster" / f"{sequence.name}.txt"
    trust_path(path).write_text("0.5,sure\n")
    with pytest.raises(DataError, match=r"\.trust\.csv: not lines of confidence,status"):
        read_trust(path, 1)
    trust_path(path).write_text("0.5,tracking\n")
    with pytest.raises(DataError, match="1 lines for 2 frames"):
        read_trust(path, 2)
