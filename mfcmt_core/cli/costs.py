"""Measure special cases: large frames, a lost target, several targets, two cores."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from multiprocessing import get_context
from statistics import median
from typing import Any

import cv2

from .. import synthetic
from ..config import MFCMTConfig
from ..geometry import Image
from ..result import Box
from ..tracker import MFCMT
from .progress import Progress

VGA, FULL_HD = (640, 480), (1920, 1080)
TARGETS = 10
TRACKERS = 8
PASSES = 3
REST = 2
"""Steps after those of the blocks: targets and cores."""
BLOCK = 20
"""Number of frames that a run does before the next run takes its turn, so that all see the same machine."""
NEVER_FOUND: dict[str, Any] = dict.fromkeys(("fused_threshold", "template_threshold", "statistical_threshold"), 10.0)


def measure(config: MFCMTConfig, frames: int | None) -> dict[str, Any]:
    """Return the report: medians in milliseconds of the thread's processor time, and throughput in wall time."""
    clip = synthetic.clip("sample", size=VGA)
    images = clip.frames[: frames or len(clip)]
    x, y, w, h = (float(v) for v in clip.boxes[0])
    box = (x, y, w, h)
    dx, dy = (FULL_HD[0] - VGA[0]) // 2, (FULL_HD[1] - VGA[1]) // 2
    large: list[Image] = [cv2.copyMakeBorder(i, dy, dy, dx, dx, cv2.BORDER_REFLECT) for i in images]  # type: ignore[misc]
    large_box = (x + dx, y + dy, w, h)
    lost = config.replace(**NEVER_FOUND, lost_after=1)
    runs = {
        "vga": Stepper(config, images, box),
        "full_hd": Stepper(config, large, large_box),
        "lost_vga": Stepper(lost, images, box),
        "lost_full_hd": Stepper(lost, large, large_box),
    }
    blocks = len(range(0, len(images), BLOCK))
    with Progress(PASSES * blocks * len(runs) + REST, "steps") as bar:
        for _ in range(PASSES):
            for run in runs.values():
                run.restart()
            for _ in range(blocks):
                for name, run in runs.items():
                    run.go(BLOCK)
                    bar.step(name)
        bar.begin("targets")
        targets = _targets(config, images, box)
        bar.begin("cores")
        cores = _cores(config, len(images), box)
    ms = {name: median(run.seconds) * 1e3 for name, run in runs.items()}
    return {
        "clip": {"frames": len(images), "target": [w, h]},
        "update_ms": ms,
        "full_hd_over_vga": ms["full_hd"] / ms["vga"],
        "lost_over_found": {"vga": ms["lost_vga"] / ms["vga"], "full_hd": ms["lost_full_hd"] / ms["full_hd"]},
        "targets": targets,
        "cores": cores,
    }


class Stepper:
    """Runs a tracker through a clip, a few frames at a time. ``seconds`` has the processor time of each update."""

    def __init__(self, config: MFCMTConfig, images: list[Image], box: Box) -> None:
        self._config, self._images, self._box = config, images, box
        self.seconds: list[float] = []
        self.restart()

    def restart(self) -> None:
        """Start from the first frame again."""
        self._tracker = MFCMT(self._config)
        self._tracker.init(self._images[0], self._box)
        self._rest = iter(self._images[1:])

    def go(self, count: int) -> None:
        """Track the next ``count`` frames, or as many as there are."""
        for image, _ in zip(self._rest, range(count), strict=False):
            start = time.thread_time()
            self._tracker.update(image)
            self.seconds.append(time.thread_time() - start)


def _targets(config: MFCMTConfig, images: list[Image], box: Box) -> dict[str, Any]:
    """Return milliseconds per frame for one and for ten trackers that share only the decoded JPEG."""
    files = [cv2.imencode(".jpg", image)[1] for image in images]
    x, y, w, h = box
    boxes = [(x + 3 * k - 15, y + 2 * k - 10, w, h) for k in range(TARGETS)]
    return {str(count): median(_frame_seconds(config, files, boxes[:count])) * 1e3 for count in (1, TARGETS)} | {
        "decode_ms": median(_frame_seconds(config, files, [])) * 1e3
    }


def _frame_seconds(config: MFCMTConfig, files: list[Any], boxes: list[Box]) -> Iterator[float]:
    trackers = [MFCMT(config) for _ in boxes]
    for index, data in enumerate(files):
        start = time.thread_time()
        image: Image = cv2.imdecode(data, cv2.IMREAD_COLOR)  # type: ignore[assignment]
        for tracker, box in zip(trackers, boxes, strict=True):
            if index:
                tracker.update(image)
            else:
                tracker.init(image, box)
        if index:
            yield time.thread_time() - start


def _cores(config: MFCMTConfig, count: int, box: Box) -> dict[str, Any] | None:
    """Return updates per second of eight trackers: in one process on one core, and in two processes on two cores."""
    cores = sorted(_allowed())
    if len(cores) < 2:
        return None
    one = _throughput(config, count, box, cores[:1], TRACKERS)
    two = _throughput(config, count, box, cores[:2], TRACKERS // 2)
    return {"one": one, "two": two, "gain": two / one}


def _allowed() -> set[int]:
    """Return the cores that this process may use, ignoring what :func:`pin` has set."""
    if not hasattr(os, "sched_setaffinity"):
        return set()
    now = os.sched_getaffinity(0)
    try:
        os.sched_setaffinity(0, range(os.cpu_count() or 1))
        return os.sched_getaffinity(0)
    finally:
        os.sched_setaffinity(0, now)


def _throughput(config: MFCMTConfig, count: int, box: Box, cores: list[int], each: int) -> float:
    """Return updates per second of ``each`` trackers per core, all at the same time."""
    context = get_context("spawn")
    start = context.Barrier(len(cores))
    pipes = [context.Pipe(duplex=False) for _ in cores]
    workers = [
        context.Process(target=_work, args=(config, count, box, core, each, start, out), daemon=True)
        for core, (_, out) in zip(cores, pipes, strict=True)
    ]
    for worker in workers:
        worker.start()
    for _, out in pipes:
        out.close()  # so that the end of a worker is noticed
    seconds: list[float] = [pipe.recv() for pipe, _ in pipes]
    for worker in workers:
        worker.join()
    return len(cores) * each * (count - 1) / max(seconds)


def _work(config: MFCMTConfig, count: int, box: Box, core: int, each: int, start: Any, out: Any) -> None:
    os.sched_setaffinity(0, {core})
    cv2.setNumThreads(1)
    images = synthetic.clip("sample", size=VGA).frames[:count]
    trackers = [MFCMT(config) for _ in range(each)]
    for tracker in trackers:
        tracker.init(images[0], box)
        tracker.update(images[0])
    start.wait()
    began = time.perf_counter()
    for image in images[1:]:
        for tracker in trackers:
            tracker.update(image)
    out.send(time.perf_counter() - began)


def table(report: dict[str, Any]) -> str:
    """Return the report as text."""
    ms, targets, cores = report["update_ms"], report["targets"], report["cores"]
    w, h = report["clip"]["target"]
    lines = [
        f"target {w:.0f}×{h:.0f}, {report['clip']['frames']} frames; milliseconds of processor time",
        "",
        f"update, 640×480                   {ms['vga']:8.3f}",
        f"update, 1920×1080                 {ms['full_hd']:8.3f}   × {report['full_hd_over_vga']:.2f}",
        f"lost, 640×480                     {ms['lost_vga']:8.3f}   × {report['lost_over_found']['vga']:.2f}",
        f"lost, 1920×1080                   {ms['lost_full_hd']:8.3f}   × {report['lost_over_found']['full_hd']:.2f}",
        f"JPEG of 640×480 decoded           {targets['decode_ms']:8.3f}",
        f"the same and 1 target             {targets['1']:8.3f}",
        f"the same and {TARGETS} targets           {targets[str(TARGETS)]:8.3f}",
    ]
    if cores:
        gain = f"{cores['two']:8.0f}   × {cores['gain']:.2f}"
        lines += [
            f"{TRACKERS} trackers on one core, updates/s {cores['one']:8.0f}",
            f"{TRACKERS} trackers on two cores          {gain}",
        ]
    else:
        lines.append("two cores: this process may use one only")
    return "\n".join(lines)
