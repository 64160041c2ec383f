"""Track in many videos at once: a batch that goes on where it stopped, in processes here or on a cluster."""

from __future__ import annotations

import argparse
import hashlib
import json
import platform
import shutil
import sys
import tempfile
from collections import Counter
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

from ..config import MFCMTConfig
from ..errors import MFCMTError
from ..exports import Options
from ..files import replaced
from ..images.files import list_images, natural_key
from ..otb.batch import Lost, run_batch
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
    folder = Path(args.source).absolute()  # as the other machines of a cluster name it
    args.output = args.output.absolute()
    args.output.mkdir(parents=True, exist_ok=True)
    if args.video is not None:
        args.video = args.video.absolute()
        args.video.mkdir(parents=True, exist_ok=True)
    tasks, failures = _tasks(args, folder, starts, config)
    done = _Finished(args.output / DONE)
    todo = {name: task for name, task in tasks.items() if not done.has(name, task)}
    if len(todo) < len(tasks):
        print(f"{len(tasks) - len(todo)} of {len(tasks)} are finished already", file=sys.stderr)
    try:
        failures += _track(todo, done, args)
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
            failures.append(f"{file}: " + ("several videos have this name" if by_stem else f"not in {args.source}"))
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


EVERY_FRAMES = 50
"""Between two looks whether the batch still goes on, and two reports how far a video is."""


@dataclass(frozen=True)
class _Film:
    """A video of a batch. While the batch goes on there is the folder ``running``, where each says how far it is."""

    name: str
    task: Task
    running: Path

    def step(self, done: int, length: int | None, _: str) -> None:
        """Tell how far it is. Raises MFCMTError when the batch is at its end."""
        if done % EVERY_FRAMES == 0:
            try:
                (self.running / self.name.replace("/", "_")).write_text(f"{done}/{length}" if length else str(done))
            except OSError as gone:
                raise MFCMTError(f"{platform.node()} does not see {self.running.parent}, where results go") from gone


def _follow(film: _Film) -> Counter[str]:
    """Track in one video, and return the number of results by status. What it has at its end is kept."""
    film.step(0, None, "")
    try:
        return follow(film.task, Ending(), film.step, *open_task(film.task))
    except UsageError as bad:
        raise MFCMTError(str(bad)) from bad
    finally:
        (film.running / film.name.replace("/", "_")).unlink(missing_ok=True)


def _track(tasks: dict[str, Task], done: _Finished, args: argparse.Namespace) -> list[str]:
    """Do the tasks, and return what failed. Raises Ended after a signal, when all that runs has kept what it has."""
    failures = []
    running = Path(tempfile.mkdtemp(prefix=".running-", dir=args.output))
    films = [_Film(name, task, running) for name, task in tasks.items()]
    end = partial(shutil.rmtree, running, ignore_errors=True)
    try:
        with Ending() as ending, _Bar(len(films), running) as bar, ending.held(then=end):
            for film, found in run_batch(_follow, films, args.jobs, args.backend):
                bar.step()
                if not isinstance(found, Lost):
                    done.add(film.name, film.task)
                    statuses = ", ".join(f"{n} {status}" for status, n in found.items())
                    print(f"{film.name}: {statuses}", file=sys.stderr)
                else:
                    failures.append(f"{film.name}: {found.reason}")
    finally:
        end()
    return failures


class _Bar(Progress):
    """Progress in videos, with the frames of those that are under way."""

    def __init__(self, total: int, running: Path) -> None:
        super().__init__(total, unit="videos")
        self._running = running

    def _draw(self, now: float, *, over: bool = False) -> None:
        with suppress(OSError):  # one is over just now
            self._note = "  ".join(f"{path.name} {path.read_text()}" for path in sorted(self._running.glob("*")))
        super()._draw(now, over=over)
