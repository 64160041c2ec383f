"""Track in many videos at once: one process a video, as many at a time as there are cores, resumable."""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from multiprocessing import connection, get_context
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from pathlib import Path

import cv2

from ..config import MFCMTConfig
from ..errors import MFCMTError
from ..exports import Options
from ..files import replaced
from ..images.files import list_images, natural_key
from ..video import SUFFIXES
from . import UsageError
from .follow import Task, follow, open_task
from .progress import Progress
from .signals import Ended, Ending
from .targets import Start

ENDINGS = {"jsonl": ".jsonl", "csv": ".csv", "cvat": ".xml", "mot": ".txt", "otb": ".txt", "yolo": ""}
DONE = "finished.json"
"""Names what is finished in a folder of results, with a digest of what it was made from."""


def is_many(folder: Path) -> bool:
    """Return True if it is a folder of videos, or of folders of images, and not of images."""
    return folder.is_dir() and not list_images(folder) and not list_images(folder / "img")


def track_many(args: argparse.Namespace, starts: dict[str, list[Start]], config: MFCMTConfig) -> int:
    """Track what the boxes name in the folder, and return the exit code: 1 if something failed."""
    if args.output is None:
        raise UsageError("a folder of videos needs --output, a folder for the results")
    if args.output.exists() and not args.output.is_dir():
        raise UsageError(f"--output {args.output} is no folder; many videos need one")
    if args.video is not None and args.video.resolve() == Path(args.source).resolve():
        raise UsageError(f"--video {args.video} has the sources, which would be overwritten")
    if "" in starts:
        raise UsageError(f"{args.boxes} does not say which file each box is for: add a column file")
    folder = Path(args.source)
    args.output.mkdir(parents=True, exist_ok=True)
    if args.video is not None:
        args.video.mkdir(parents=True, exist_ok=True)
    tasks, failures = _tasks(args, folder, starts, config)
    done = _Finished(args.output / DONE)
    todo = {name: task for name, task in tasks.items() if not done.has(name, task)}
    if len(todo) < len(tasks):
        print(f"{len(tasks) - len(todo)} of {len(tasks)} are finished already", file=sys.stderr)
    try:
        with Ending() as ending:
            for name, end in _in_processes(todo, max(1, args.jobs), ending):
                if end.error is None:
                    done.add(name, todo[name])
                    statuses = ", ".join(f"{n} {status}" for status, n in end.counts.items())
                    print(f"{name}: {statuses}", file=sys.stderr)
                else:
                    failures.append(f"{name}: {end.error}")
    except Ended as ended:
        return ended.code
    for failure in failures:
        print(f"mfcmt track: {failure}", file=sys.stderr)
    if failures:
        print(f"mfcmt track: {len(failures)} failed; the same command tries them again", file=sys.stderr)
    return int(bool(failures))


def _tasks(
    args: argparse.Namespace, folder: Path, starts: dict[str, list[Start]], config: MFCMTConfig
) -> tuple[dict[str, Task], list[str]]:
    """Return a task for each file that has a box, and why others have none."""
    videos = {p.name: p for p in folder.iterdir() if p.suffix.lower() in SUFFIXES and not p.name.startswith(".")}
    found: dict[str, Task] = {}
    failures = []
    style = args.format or "csv"
    for file, of_file in starts.items():
        by_stem = [name for name in videos if Path(name).stem == file]
        name = file if (folder / file).exists() else by_stem[0] if len(by_stem) == 1 else None
        if name is None:
            failures.append(f"{file}: " + ("several videos have this name" if by_stem else f"not in {folder}"))
            continue
        videos.pop(name, None)
        twice = {start.target.name for start in of_file if sum(s.target == start.target for s in of_file) > 1}
        if twice or (style == "otb" and len(of_file) > 1):
            failures.append(f"{name}: " + (f"several boxes of {min(twice)}" if twice else "otb has one target"))
            continue
        result = name.replace("/", "_")
        output = args.output / f"{result}{ENDINGS.get(style, '.json')}"
        video = args.video / f"{Path(result).stem}.mp4" if args.video is not None else None
        options = Options(style, output, args.tolerance)
        rescale = args.on_resize == "rescale"
        found[name] = Task(str(folder / name), tuple(of_file), config, options, video, args.audio, rescale, args.fps)
    failures += [f"{name}: {args.boxes} has no box for it" for name in sorted(videos)]
    return dict(sorted(found.items(), key=lambda item: natural_key(Path(item[0])))), failures


class _Finished:
    """The names of what is finished, on disk after each."""

    def __init__(self, path: Path) -> None:
        self._path = path
        try:
            self._digests: dict[str, str] = json.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError):
            self._digests = {}

    def has(self, name: str, task: Task) -> bool:
        """Return True if it was made from the same file, boxes and options, and is still there."""
        assert task.options.output is not None
        there = task.options.output.exists() and (task.video is None or task.video.exists())
        return there and self._digests.get(name) == _digest(task)

    def add(self, name: str, task: Task) -> None:
        """Note that it is finished. Raises MFCMTError."""
        self._digests[name] = _digest(task)
        try:
            with replaced(self._path) as partial:
                partial.write_text(json.dumps(self._digests, indent=1), encoding="utf-8")
        except OSError as failed:
            raise MFCMTError(f"cannot write {self._path}: {failed.strerror}") from failed


def _digest(task: Task) -> str:
    state = Path(task.source).stat()
    about = json.dumps([asdict(task), state.st_size, state.st_mtime_ns], default=str, sort_keys=True)
    return hashlib.sha256(about.encode()).hexdigest()


@dataclass
class _End:
    """How a task ended: numbers of results by status, or what was wrong."""

    counts: Counter[str]
    error: str | None = None


def _in_processes(tasks: dict[str, Task], jobs: int, ending: Ending) -> Iterator[tuple[str, _End]]:
    """Do the tasks and yield each that has ended. A signal ends those that run, and what they have is kept."""
    waiting = list(tasks)
    running: dict[Connection, tuple[str, SpawnProcess]] = {}
    far: dict[str, str] = {}
    context = get_context("spawn")
    try:
        with Progress(len(tasks), unit="videos") as bar:
            while waiting or running:
                while waiting and len(running) < jobs:
                    name = waiting.pop(0)
                    near, end = context.Pipe(duplex=False)
                    process = context.Process(target=_work, args=(tasks[name], end), daemon=True)
                    with ending.held():
                        process.start()
                        running[near] = (name, process)
                    end.close()
                for pipe in connection.wait(list(running)):
                    assert isinstance(pipe, Connection)
                    name, process = running[pipe]
                    try:
                        said = pipe.recv()
                    except (EOFError, ConnectionError):
                        process.join()
                        said = _End(Counter(), f"its process died ({process.exitcode})")
                    if isinstance(said, str):
                        far[name] = said
                        bar.step("  ".join(f"{n} {at}" for n, at in far.items()), 0)
                        continue
                    process.join()
                    del running[pipe]
                    far.pop(name, None)
                    bar.step("  ".join(f"{n} {at}" for n, at in far.items()))
                    yield name, said
    finally:
        for _, process in running.values():
            process.terminate()
        for _, process in running.values():
            process.join()


EVERY_FRAMES = 50


def _work(task: Task, pipe: Connection) -> None:
    """Do a task in a process of its own, and tell the other end how far it is and how it ended."""
    cv2.setNumThreads(1)

    def step(done: int, length: int | None, _: str) -> None:
        if done % EVERY_FRAMES == 0:
            pipe.send(f"{done}/{length}" if length else str(done))

    end = _End(Counter())
    try:
        with Ending() as ending:
            source, first = open_task(task)
            end.counts = follow(task, ending, step, source, first)
    except Ended:
        return  # the parent ends, too
    except (MFCMTError, UsageError) as failed:
        end.error = str(failed)
    except OSError as failed:
        end.error = f"{failed.filename or task.source}: {failed.strerror}"
    pipe.send(end)
