"""Batches: each job has a result, is tried again, or is lost by name."""

from __future__ import annotations

import os
import signal
from dataclasses import dataclass
from pathlib import Path

import pytest

from mfcmt_core.errors import DataError
from mfcmt_core.otb.batch import ATTEMPTS, Lost, run_batch


@dataclass(frozen=True)
class Job:
    """Does ``how`` in its first ``times`` attempts, which it counts in a file."""

    name: str
    folder: Path
    how: str = ""
    times: int = 0

    @property
    def attempts(self) -> int:
        path = self.folder / self.name
        return len(path.read_text()) if path.exists() else 0


def work(job: Job) -> str:
    with (job.folder / job.name).open("a") as file:
        file.write("x")
    if job.attempts <= job.times:
        if job.how == "die":
            os.kill(os.getpid(), signal.SIGKILL)
        if job.how == "refuse":
            raise DataError("no such box")
        if job.how == "disk":
            raise OSError(5, "Input/output error", "film.mp4")
        raise RuntimeError("a fault")
    return job.name.upper()


def run(jobs: list[Job], processes: int = 2) -> dict[str, str | Lost]:
    return {job.name: result for job, result in run_batch(work, jobs, processes)}


@pytest.mark.parametrize("processes", [1, 2])
def test_every_job_has_its_result(tmp_path: Path, processes: int) -> None:
    jobs = [Job(name, tmp_path) for name in "abcde"]
    assert run(jobs, processes) == {name: name.upper() for name in "abcde"}
    assert all(job.attempts == 1 for job in jobs)


@pytest.mark.parametrize("how", ["die", "disk", "raise"])
def test_a_job_that_fails_once_is_tried_again(tmp_path: Path, how: str) -> None:
    jobs = [Job("a", tmp_path), Job("b", tmp_path, how, 1), Job("c", tmp_path)]
    assert run(jobs) == {"a": "A", "b": "B", "c": "C"}
    assert jobs[1].attempts == 2


def test_a_job_that_kills_every_process_is_the_only_one_lost(tmp_path: Path) -> None:
    jobs = [Job("a", tmp_path), Job("killer", tmp_path, "die", 9), *(Job(name, tmp_path) for name in "bcd")]
    found = run(jobs)
    lost = found.pop("killer")
    assert isinstance(lost, Lost)
    assert "its process died" in lost.reason
    assert found == {"a": "A", "b": "B", "c": "C", "d": "D"}
    assert jobs[1].attempts == ATTEMPTS


def test_a_job_that_fails_each_time_is_lost_with_the_reason(tmp_path: Path) -> None:
    jobs = [Job("a", tmp_path, "refuse", 9), Job("b", tmp_path, "disk", 9), Job("c", tmp_path, "raise", 9)]
    found = run(jobs)
    assert found == {
        "a": Lost("no such box", final=True),
        "b": Lost("film.mp4: Input/output error"),
        "c": Lost("RuntimeError: a fault"),
    }
    assert [job.attempts for job in jobs] == [1, ATTEMPTS, ATTEMPTS]


@pytest.mark.parametrize("backend", ["ray", "dask"])
def test_a_backend_that_is_not_installed_is_named_with_its_extra(tmp_path: Path, backend: str) -> None:
    with pytest.raises(DataError, match=rf"pip install 'mfcmt\[{backend}\]'"):
        list(run_batch(work, [Job("a", tmp_path)], backend=backend))
