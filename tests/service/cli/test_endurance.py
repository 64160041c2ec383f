"""The commands that measure what lasts: bad inputs, and memory over long work; their short forms."""

from __future__ import annotations

import json
import random

import pytest

from mfcmt_core.cli import main
from tests.service.frames import images
from tests.tools.fuzz.mutate import Mutator
from tests.tools.soak.slope import STEP_BYTES, STEP_SLOPE, slope


def test_bad_inputs(capsys: pytest.CaptureFixture[str]) -> None:
    """Also prints the figures into the log of the tests."""
    assert main(["fuzz", "--count", "60", "--seed", "20"]) == 0
    printed = capsys.readouterr().out
    assert printed.splitlines()[-1] == "bad inputs tried: 300; wrong answers: 0 of 300"
    with capsys.disabled():
        print(f"\n{printed.splitlines()[-1]}")


# What the short form can tell from an allocator that is still settling.
SEEN_BYTES = {"session": 1000.0, "frame": 200.0}


def test_memory_stays_flat(capsys: pytest.CaptureFixture[str]) -> None:
    """The long form is ``mfcmt soak``; what grows by a kilobyte a session shows in this one."""
    assert main(["soak", "--short", "--json", "--lanes", "1"]) in (0, 1)
    phases = json.loads(capsys.readouterr().out)
    assert [(phase["unit"], phase["failed"]) for phase in phases] == [("session", 0), ("frame", 0)]
    for phase in phases:
        for role, one in phase["slopes"].items():
            assert one["per_unit"] <= max(one["noise"], SEEN_BYTES[phase["unit"]]), (role, phase)


@pytest.mark.parametrize("bad", [["soak", "--sessions", "5"], ["soak", "--streams", "0"], ["fuzz", "--count", "0"]])
def test_arguments_that_do_not_fit(bad: list[str]) -> None:
    assert main(bad) == 2


def test_a_slope_is_told_from_noise() -> None:
    """A leak of 100 bytes a unit is seen through noise of a megabyte; noise, a step and a rise in warm-up are not."""
    chance = random.Random(3)
    done = [1000.0 * n for n in range(1, 81)]
    noise = [chance.gauss(0, 3e5) for _ in done]
    flat = slope(done, [50e6 + e for e in noise])
    leak = slope(done, [50e6 + 100 * x + e for x, e in zip(done, noise, strict=True)])
    early = slope(done, [50e6 + 1000 * min(x, 20_000) + e for x, e in zip(done, noise, strict=True)])
    assert flat.flat
    assert early.flat
    assert not leak.flat
    assert leak.per_unit == pytest.approx(100, abs=leak.noise)
    constant = slope(done, [50e6] * 80)
    assert (constant.per_unit, constant.flat) == (0.0, True)
    assert constant.noise == pytest.approx(STEP_SLOPE * STEP_BYTES / 56_000, rel=0.02)
    with pytest.raises(ValueError, match="too few"):
        slope(done[:5], noise[:5])


def test_one_arena_more_is_no_growth_and_many_are() -> None:
    """A leak into arenas is a staircase; a single step is what any run may show, wherever it lies."""
    done = [1000.0 * n for n in range(1, 81)]
    for at in range(25_000, 80_000, 1000):
        assert slope(done, [50e6 + STEP_BYTES * (x > at) for x in done]).flat, at
    stairs = slope(done, [50e6 + STEP_BYTES * (100 * x // STEP_BYTES) for x in done])
    assert not stairs.flat
    assert stairs.per_unit == pytest.approx(100, abs=20)


def test_noise_that_hangs_together_is_wider() -> None:
    """A random walk has slopes that mean nothing."""
    chance, grown = random.Random(4), 0
    for _ in range(50):
        walk = [0.0]
        for _ in range(80):
            walk.append(walk[-1] + chance.gauss(0, 1e6))
        grown += not slope([1000.0 * n for n in range(81)], walk).flat
    assert grown < 25


def test_bad_inputs_follow_from_their_seed() -> None:
    jpeg = images.jpeg()
    one, two, other = Mutator(1, jpeg), Mutator(1, jpeg), Mutator(2, jpeg)
    first = [one.frame() for _ in range(50)]
    assert first == [two.frame() for _ in range(50)]
    assert first != [other.frame() for _ in range(50)]
    assert sum(frame in one.images for frame in first) < 10
