"""Batches on real clusters of two nodes: the same bits as here, films of a lost node are tried again."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import cv2
import pytest

from mfcmt_core import synthetic
from mfcmt_core.video.write import VideoWriter
from tests.conftest import ROOT, require

BIN = ROOT / ".venv-clusters" / "bin"
VARIABLES = {"ray": "RAY_ADDRESS", "dask": "DASK_SCHEDULER_ADDRESS"}
LENGTH = 10
PATIENCE_S = 600
STARTS = 4
"""Ray gives up after 30 s, which a busy machine may need."""


class Cluster:
    """Two nodes in a process of their own; ``mfcmt`` runs in the same environment."""

    def __init__(self, backend: str) -> None:
        self.backend = backend
        words = [BIN / "python", ROOT / "tests/clusters/cluster.py", backend]
        for _ in range(STARTS):
            self._process = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
            assert self._process.stdout is not None
            if address := self._process.stdout.readline().strip():
                break
            self._process.communicate()
        assert address, "the cluster does not start"
        self._environment = os.environ | {VARIABLES[backend]: address}

    def start(self, *words: object, backend: str | None = None) -> subprocess.Popen[str]:
        command = [BIN / "mfcmt", *map(str, words), "--backend", backend or self.backend]
        return subprocess.Popen(
            command, env=self._environment, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )

    def run(self, *words: object, backend: str | None = None) -> tuple[int, str]:
        """Run ``mfcmt`` and return its exit code and what it said of failures."""
        with self.start(*words, backend=backend) as process:
            _, said = process.communicate(timeout=PATIENCE_S)
        return process.returncode, said

    def kill(self) -> None:
        """Kill one of the nodes."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write("kill\n")
        self._process.stdin.flush()
        assert self._process.stdout.readline() == "killed\n"

    def close(self) -> None:
        self._process.communicate(timeout=60)


@pytest.fixture(scope="module", params=["ray", "dask"])
def cluster(request: pytest.FixtureRequest) -> Iterator[Cluster]:
    require((BIN / "python").exists(), "needs .venv-clusters (make clusters)")
    cluster = Cluster(request.param)
    yield cluster
    cluster.close()


@pytest.fixture(scope="module")
def clip() -> synthetic.Clip:
    return synthetic.clip("motion")


@pytest.fixture
def films(clip: synthetic.Clip, tmp_path: Path) -> Path:
    """Return a folder of two films and a broken one."""
    folder = tmp_path / "films"
    folder.mkdir()
    write_film(folder / "a.mp4", clip, LENGTH)
    write_film(folder / "b.mp4", clip, 2 * LENGTH)
    (folder / "cut.mp4").write_bytes((folder / "a.mp4").read_bytes()[:500])
    return folder


def write_film(path: Path, clip: synthetic.Clip, length: int) -> None:
    writer = VideoWriter(path, 25)
    for at in range(length):
        writer.write(clip.frames[at % 2 * LENGTH + at % LENGTH], at / 25)
    writer.close()


def boxes_of(folder: Path, clip: synthetic.Clip) -> Path:
    path = folder.with_suffix(".json")
    path.write_text(json.dumps({film.name: list(map(float, clip.boxes[0])) for film in folder.iterdir()}))
    return path


def test_a_cluster_tracks_bit_for_bit_what_this_machine_tracks(
    cluster: Cluster, films: Path, clip: synthetic.Clip, tmp_path: Path
) -> None:
    words = ("track", films, "--boxes", boxes_of(films, clip), "--output")
    here, there = tmp_path / "here", tmp_path / "there"
    assert cluster.run(*words, here, backend="processes")[0] == 1
    code, said = cluster.run(*words, there)
    assert (code, "mfcmt track: cut.mp4: not a video" in said) == (1, True), said
    for name in ("a.mp4.csv", "b.mp4.csv"):
        assert (there / name).read_bytes() == (here / name).read_bytes()
    shutil.copy(films / "a.mp4", films / "cut.mp4")
    code, said = cluster.run(*words, there)
    assert (code, "2 of 3 are finished already" in said) == (0, True), said
    assert (there / "cut.mp4.csv").read_bytes() == (there / "a.mp4.csv").read_bytes()
    assert [path.name for path in there.iterdir() if path.name.startswith(".")] == []


def test_a_cluster_evaluates_bit_for_bit_what_this_machine_evaluates(
    cluster: Cluster, clip: synthetic.Clip, tmp_path: Path
) -> None:
    for name, first in (("One", 0), ("Two", 5)):
        folder = tmp_path / "data" / name / "img"
        folder.mkdir(parents=True)
        for number, frame in enumerate(clip.frames[first : first + LENGTH], 1):
            cv2.imwrite(str(folder / f"{number:04}.jpg"), frame)
        rows = [",".join(f"{value:.0f}" for value in box) for box in clip.boxes[first : first + LENGTH]]
        (folder.parent / "groundtruth_rect.txt").write_text("\n".join(rows) + "\n")
    words = ("eval", "--data", tmp_path / "data", "--trackers", "default,paper", "--protocol", "sre", "--results")
    made = []
    for backend in ("processes", cluster.backend):
        results = tmp_path / backend
        code, said = cluster.run(*words, results, backend=backend)
        assert code == 0, said
        made.append({path.relative_to(results): path.read_bytes() for path in results.rglob("*.txt")})
    assert made[0] == made[1]
    assert len(made[0]) > 20


def test_the_films_of_a_lost_node_are_tracked_again(cluster: Cluster, clip: synthetic.Clip, tmp_path: Path) -> None:
    """The last test of a cluster: one of its nodes is gone after it."""
    films, out = tmp_path / "long", tmp_path / "out"
    films.mkdir()
    write_film(films / "a.mp4", clip, 900)
    shutil.copy(films / "a.mp4", films / "b.mp4")
    process = cluster.start("track", films, "--boxes", boxes_of(films, clip), "--output", out)
    try:
        give_up = time.monotonic() + PATIENCE_S
        while sum(path.stat().st_size > 5000 for path in out.glob("*.csv")) < 2:  # both nodes have one
            assert process.poll() is None, process.communicate()
            assert time.monotonic() < give_up
            time.sleep(0.01)
        cluster.kill()
        _, said = process.communicate(timeout=PATIENCE_S)
    finally:
        process.kill()
    assert process.returncode == 0, said
    rows = (out / "a.mp4.csv").read_text().splitlines()
    assert len(rows) == 1 + 900
    assert (out / "b.mp4.csv").read_text().splitlines() == rows


@pytest.mark.parametrize(("backend", "says"), [("ray", "set RAY_ADDRESS"), ("dask", "set DASK_SCHEDULER_ADDRESS")])
def test_a_cluster_that_is_not_there_is_told(backend: str, says: str, tmp_path: Path) -> None:
    require((BIN / "python").exists(), "needs .venv-clusters (make clusters)")
    (tmp_path / "films").mkdir()
    (tmp_path / "films" / "a.mp4").write_bytes(b"")
    (tmp_path / "b.csv").write_text("file,x,y,w,h\na.mp4,1,2,30,40\n")
    environment = {name: value for name, value in os.environ.items() if name not in VARIABLES.values()}
    words = [
        "track",
        tmp_path / "films",
        "--boxes",
        tmp_path / "b.csv",
        "--output",
        tmp_path / "o",
        "--backend",
        backend,
    ]
    done = subprocess.run([BIN / "mfcmt", *words], env=environment, capture_output=True, text=True, check=False)
    assert (done.returncode, says in done.stderr) == (1, True), done.stderr
    assert "Traceback" not in done.stderr
