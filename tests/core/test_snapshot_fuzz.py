"""Whatever the bytes of a snapshot are: BadSnapshot, or a tracker that works like any other."""

from __future__ import annotations

import copy
from contextlib import suppress

import msgpack
import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from mfcmt_core import MFCMT, BadSnapshot

from .helpers import assert_sane

FUZZ = settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])


def check(blob, frames):
    """Assert that the bytes are refused with BadSnapshot or give a working tracker."""
    try:
        tracker = MFCMT.from_bytes(blob)
    except BadSnapshot:
        return
    x, y, w, h = tracker.needed_region()
    width, height = frame_size = msgpack.unpackb(blob)["frame_size"]
    if [width, height] == [320, 240]:
        cuts = [{"image": frame} for frame in frames[13:16]]
    elif w * h <= 1 << 20:
        noise = np.random.default_rng(0).integers(0, 256, (h, w, 3), np.uint8)
        cuts = [{"image": noise, "offset": (x, y), "frame_size": frame_size}]
    else:
        return
    for arguments in cuts:
        assert_sane(tracker.update(**arguments), (width, height))
    with suppress(BadSnapshot):  # numbers that were just inside what is taken may have grown out of it
        assert MFCMT.from_bytes(tracker.to_bytes()).to_bytes() == tracker.to_bytes()


@FUZZ
@given(st.lists(st.tuples(st.integers(0, 2**30), st.integers(1, 255)), min_size=1, max_size=20), st.booleans())
def test_a_snapshot_with_flipped_bytes_is_refused_or_tracks(data, frames, flips, at_the_front):
    """The bytes lie anywhere, or in the first kilobyte, which holds everything but the arrays."""
    blob = bytearray(data)
    for place, mask in flips:
        blob[place % (1000 if at_the_front else len(blob))] ^= mask
    check(bytes(blob), frames)


@FUZZ
@given(st.integers(0, 2**30), st.integers(0, 2**30), st.binary(max_size=40))
def test_cut_and_spliced_snapshots_are_refused_or_track(data, frames, start, stop, between):
    start, stop = sorted((start % (len(data) + 1), stop % (len(data) + 1)))
    check(data[:start] + between + data[stop:], frames)
    if start < len(data):
        with pytest.raises(BadSnapshot):
            MFCMT.from_bytes(data[:start])


PLAIN = st.recursive(
    st.one_of(
        st.none(),
        st.booleans(),
        st.integers(-(2**63), 2**64 - 1),
        st.floats(),
        st.text(max_size=8),
        st.binary(max_size=16),
        st.sampled_from([0, 1, -1, 1e-3, 320, 240, 1e6, "gray", "<f4", 2**20, "default"]),
    ),
    lambda children: st.lists(children, max_size=4) | st.dictionaries(st.text(max_size=4), children, max_size=3),
    max_leaves=6,
)


def paths(value, prefix=()):
    """Yield every place in the document that holds a value."""
    if prefix:
        yield prefix
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, part in items:
        yield from paths(part, (*prefix, key))


@FUZZ
@given(st.data())
def test_a_snapshot_with_any_value_in_any_field_is_refused_or_tracks(data, frames, draw):
    document = msgpack.unpackb(data)
    for _ in range(draw.draw(st.integers(1, 3))):
        *path, last = draw.draw(st.sampled_from(sorted(paths(document), key=repr)))
        part = document
        for key in path:
            part = part[key]
        part[last] = draw.draw(PLAIN)
    check(msgpack.packb(document), frames)


NUMBERS = [
    "mean",
    "denominator",
    "background_filters",
    "background_unmasked",
    "histograms",
    "histogram_gain",
    "scale_mean",
    "scale_energy",
]


@FUZZ
@given(st.sampled_from(NUMBERS), st.floats(width=32), st.booleans())
@example("mean", 1e12, True)
@example("mean", -1e12, True)
@example("denominator", 0.0, True)
@example("denominator", 1e12, True)
@example("background_filters", 1e12, True)
@example("background_filters", -1e12, False)
@example("background_unmasked", 1e12, True)
@example("background_unmasked", -1e12, True)
@example("histograms", 0.0, True)
@example("histograms", 1e-45, True)
@example("histograms", 1e12, True)
@example("histogram_gain", 1e-45, True)
@example("histogram_gain", 1e12, True)
@example("scale_mean", 7e11, True)  # of real and imaginary part: the most that is taken
@example("scale_mean", -7e11, True)
@example("scale_mean", 7e11, False)
@example("scale_energy", 0.0, True)
@example("scale_energy", 1e12, True)
def test_a_snapshot_with_any_numbers_is_refused_or_tracks(data, frames, name, value, everywhere):  # fmt: skip
    document = copy.deepcopy(msgpack.unpackb(data))
    packed = document["arrays"][name]
    numbers = np.frombuffer(packed["data"], "<f4").copy()
    few = slice(100, 110) if len(numbers) > 110 else slice(0, 1)
    numbers[slice(None) if everywhere else few] = value
    packed["data"] = numbers.tobytes()
    check(msgpack.packb(document), frames)
