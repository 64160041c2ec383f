"""Measurements as text."""

from __future__ import annotations

from collections.abc import Iterable

from .clips import Clip
from .regions import Saving
from .report import Goal, Report
from .run import Outcome
from .usage import MB, Usage
from .work import Work


def of_run(run: Outcome) -> str:
    """Return the text of one run."""
    lines = [*_run(run)]
    if run.before and run.after:
        lines += _memory(run.before, run.after)
    return "\n".join(lines)


def of_report(report: Report, clip: Clip) -> str:
    """Return the text of all measurements, with the targets last."""
    mean_kb = sum(map(len, clip.frames)) / len(clip.frames) / 1e3
    lines = [
        f"{clip.name}, {clip.size[0]}x{clip.size[1]}, {mean_kb:.0f} kB a frame",
        *map(_work, report.work),
    ]
    for name, outcome in report.runs.items():
        lines += ["", f"[{name}]", *_run(outcome)]
    lines += ["", *_memory(report.at_rest, report.after_load), ""]
    for lanes, rates in report.lane_rates.items():
        lines.append(f"{lanes} lane(s) alone: {' + '.join(f'{rate:.0f}' for rate in rates)} frames/s")
    lines += ["", f"{'bytes of the region over bytes of the frame':<44}   p10   p50   p90  mean"]
    lines += map(_saving, report.savings)
    lines += ["", f"{'target':<50}{'measured':>10}"]
    lines += map(_target, report.targets)
    return "\n".join(lines)


def _run(run: Outcome) -> Iterable[str]:
    yield (
        f"sent        {run.sent} frames in {run.seconds:.1f} s by {run.sessions} session(s), "
        f"{run.mbit_per_s:.1f} Mbit/s"
    )
    refused = "".join(f", {count} {code}" for code, count in run.refused.items())
    yield f"answered    {run.answered} ({run.fps:.1f} frames/s), {run.dropped} dropped{refused}"
    yield f"round trip  p50 {run.p50_ms:.2f}  p95 {run.p95_ms:.2f}  p99 {run.p99_ms:.2f} ms"
    yield (
        f"of which    queue {run.queue_p50_ms:.2f}  decode {run.decode_p50_ms:.2f}  "
        f"track {run.track_p50_ms:.2f} ms (p50)"
    )
    if run.front_cpu_ms is not None and run.lanes_cpu_ms is not None:
        yield f"CPU a frame {run.front_cpu_ms:.2f} ms front, {run.lanes_cpu_ms:.2f} ms lanes"


def _memory(before: dict[str, Usage], after: dict[str, Usage]) -> Iterable[str]:
    yield "memory      MB resident (private), at rest and after"
    for role, now in after.items():
        was = before.get(role, now)
        yield (
            f"  {role:<12}{was.rss_bytes / MB:6.0f} ({was.private_bytes / MB:.0f})"
            f"  {now.rss_bytes / MB:6.0f} ({now.private_bytes / MB:.0f})"
        )


def _work(work: Work) -> str:
    return (
        f"in-process  {work.wall_ms:.2f} ms a frame ({work.decode_ms:.2f} to decode), "
        f"{work.cpu_ms:.2f} ms of CPU, {work.frames} frames"
    )


def _saving(saving: Saving) -> str:
    target = f"{saving.target_px:.0f} px at {saving.size[0]}x{saving.size[1]}"
    numbers = "".join(f"{value:6.2f}" for value in (saving.p10, saving.p50, saving.p90, saving.mean))
    return f"  {saving.name:<18}{target:<24}{numbers}"


def _target(target: Goal) -> str:
    sign, mark = ">=" if target.at_least else "<=", "met" if target.met else "MISSED"
    return f"  {target.name:<48}{target.measured:10.2f} {target.unit:<3}{sign} {target.limit:<5g} {mark}"
