"""A tracker to bytes and back: every later result bit-equal, and what does not fit is refused."""

from __future__ import annotations

import struct

import msgpack
import numpy as np
import pytest

from mfcmt_core import MFCMT, BadSnapshot, MFCMTConfig, synthetic
from mfcmt_core.snapshot import FORMAT, MAX_BYTES, VERSION

from .helpers import ALERT, PRESETS, assert_sane

DEFAULT = MFCMTConfig.default()


# --- back again ---


@pytest.mark.parametrize(
    "config",
    [
        *PRESETS.values(),
        DEFAULT.replace(num_scales=1),
        DEFAULT.replace(color_histogram=False),
        DEFAULT.replace(features=()),
        DEFAULT.replace(joint_filter=False, average="filter", background_interval=0),
        DEFAULT.replace(patch_size=148, window="square"),
    ],
)
def test_every_later_result_of_a_restored_tracker_is_bit_equal(config, frames, clip):
    tracker = MFCMT(config)
    tracker.init(frames[0], clip.boxes[0])
    restored = MFCMT.from_bytes(tracker.to_bytes())
    assert restored.config == config
    for index, frame in enumerate(frames[1:16]):
        assert restored.update(frame) == tracker.update(frame)
        assert restored.needed_region() == tracker.needed_region()
        assert restored.to_bytes() == tracker.to_bytes()
        if index % 4 == 0:
            restored = MFCMT.from_bytes(restored.to_bytes())


@pytest.mark.parametrize("gray", [False, True])
def test_a_snapshot_works_through_lost_and_back(gray):
    sequence = synthetic.clip("leaves", gray=gray)
    tracker, relayed = MFCMT(ALERT), MFCMT(ALERT)
    seen = []
    for index, frame in enumerate(sequence.frames):
        if index == 0:
            for each in (tracker, relayed):
                each.init(frame, sequence.boxes[0])
            continue
        result = tracker.update(frame)
        assert relayed.update(frame) == result
        seen.append(result.status)
        if index % 3 == 0:  # handed on again and again
            relayed = MFCMT.from_bytes(relayed.to_bytes())
            assert relayed.to_bytes() == tracker.to_bytes()
    assert {"tracking", "uncertain", "lost"} == set(seen)
    assert seen[-1] == "tracking"


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize("box", [(132, 98, 56, 44), (160, 20, 4, 200), (10, 120, 300, 4), (50, 50, 1, 100)])
def test_a_default_snapshot_is_below_one_megabyte(box, preset, frames):
    tracker = MFCMT(PRESETS[preset])
    tracker.init(frames[0], box)
    tracker.update(frames[1])
    assert len(tracker.to_bytes()) < 1_000_000


@pytest.mark.parametrize("kind", [bytes, bytearray, memoryview])
def test_any_bytes_are_refused_without_another_error(kind, data):
    assert MFCMT.from_bytes(kind(data)).to_bytes() == data


def test_a_snapshot_has_its_format_and_version(data):
    """It is MessagePack with raw little-endian arrays, and shares no memory with the tracker."""
    document = msgpack.unpackb(data)
    assert document["format"] == FORMAT == "mfcmt-tracker"
    assert document["version"] == VERSION
    assert MFCMTConfig.from_dict(document["config"]) == DEFAULT
    for packed in document["arrays"].values():
        assert packed["dtype"] in {"<f4", "<c8"}
        assert len(packed["data"]) == np.prod(packed["shape"]) * np.dtype(packed["dtype"]).itemsize
    mutable = bytearray(data)
    tracker = MFCMT.from_bytes(mutable)
    mutable[:] = bytes(len(mutable))
    assert tracker.to_bytes() == data


# --- what is not a snapshot ---


def changed(data, *path_and_value):
    document = msgpack.unpackb(data)
    *path, last, value = path_and_value
    part = document
    for key in path:
        part = part[key]
    part[last] = value
    return msgpack.packb(document)


def array(shape, value, dtype="<f4"):
    return {"dtype": dtype, "shape": list(shape), "data": np.full(shape, value, dtype).tobytes()}


BIG = [2**31, 2**31]
CHANGES = [
    ("format", "pickle"),
    ("format", None),
    ("version", 0),
    ("version", VERSION + 1),
    ("version", "1"),
    ("config", None),
    ("config", []),
    ("config", {"zoom": 1}),
    ("config", {1: 2, b"x": 3}),
    ("config", "color_name_table", "/no/such/file.npy"),
    ("config", "color_name_table", "/dev/zero"),
    ("config", "patch_size", 148),
    ("config", "patch_size", 2**40),
    ("config", "num_scales", 1),
    ("config", "scale_samples", 33),
    ("config", "scale_samples", 14),
    ("config", "scale_interval", 0),
    ("config", "learn_within", -1.0),
    ("config", "scale_max_area", 512.0),
    ("config", "background_interval", 0),
    ("config", "features", ["gray"]),
    ("config", "scale_step", 1.5),
    ("frame_size", [0, 10]),
    ("frame_size", [320]),
    ("frame_size", [320, 240, 3]),
    ("frame_size", [2**40, 2**40]),
    ("frame_size", [100, 100]),
    ("frame_size", "ab"),
    ("base_size", [0, 10]),
    ("base_size", [-3.0, 10.0]),
    ("base_size", [float("nan"), 10.0]),
    ("base_size", [1e-3, 4e6]),
    ("base_size", [1e300, 1e300]),
    ("grey", True),
    ("grey", 1),
    ("center", [-1.0, 5.0]),
    ("center", [1e5, 5.0]),
    ("center", [float("inf"), 5.0]),
    ("center", None),
    ("anchor", [-1.0, 5.0]),
    ("anchor", [5.0, float("nan")]),
    ("anchor", [5.0]),
    ("anchor", None),
    ("rival", [-1.0, 5.0]),
    ("rival", [5.0, float("nan")]),
    ("rival", 5.0),
    ("waited", -1),
    ("waited", None),
    ("waited", 0.5),
    ("scale", 0),
    ("scale", -1.0),
    ("scale", float("nan")),
    ("scale", "1"),
    ("reliability", {}),
    ("reliability", "lost", 1),
    ("reliability", "usual", float("inf")),
    ("reliability", "learned", -1),
    ("reliability", "history", None),
    ("reliability", "history", [[0.1, 0.2]]),
    ("reliability", "history", [[0.1, 0.2, float("nan")]]),
    ("reliability", "history", [[0.1, 0.2, 0.3]] * 11),
    ("reliability", "history", [[1e300, 0.2, 0.3]]),
    ("arrays", {}),
    ("arrays", []),
    ("arrays", [[1, 2], ["a", 3]]),
    ("arrays", b"x", 1),
    ("arrays", "more", array((3,), 0)),
    ("arrays", "scale_sums", array((3,), 0)),  # a name of the version before
    ("arrays", "histograms", None),
    ("arrays", "histograms", b"1234"),
    ("arrays", "histograms", {"dtype": "<f4", "shape": [32768, 2], "data": b"123"}),
    ("arrays", "histograms", {"dtype": "<f4", "shape": BIG, "data": b""}),
    ("arrays", "histograms", {"dtype": "|O", "shape": [32768, 2], "data": bytes(65536 * 8)}),
    ("arrays", "histograms", {"dtype": ">f4", "shape": [32768, 2], "data": bytes(65536 * 4)}),
    ("arrays", "histograms", {"dtype": "<f4", "shape": [32768, 2], "data": "x" * 65536 * 4}),
    ("arrays", "histograms", array((32768, 2), np.nan)),
    ("arrays", "histograms", array((32768, 2), np.inf)),
    ("arrays", "histograms", array((32768, 2), -1)),
    ("arrays", "histograms", array((32768, 2), 1e30)),
    ("arrays", "histograms", array((2, 32768), 0)),
    ("arrays", "histogram_gain", array((1,), 0)),
    ("arrays", "histogram_gain", array((1,), -1)),
    ("arrays", "histogram_gain", array((1,), np.nan)),
    ("arrays", "histogram_gain", array((2,), 1)),
    ("arrays", "scale_sums", array((1953,), 0)),  # another one of those
    ("arrays", "scale_energy", array((9,), 1)),
    ("arrays", "scale_mean", array((63, 31, 8), 1)),
    ("arrays", "scale_mean", array((1953, 8), 1, "<c8")),
]


@pytest.mark.parametrize("change", CHANGES, ids=lambda change: repr(change)[:60])
def test_invalid_fields_are_refused(change, data):
    with pytest.raises(BadSnapshot):
        MFCMT.from_bytes(changed(data, *change))


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("mean", 1e30j),
        ("denominator", -1),
        ("histograms", -1),
        ("scale_mean", 1e30j),
        ("scale_mean", complex(0, np.nan)),
        ("scale_energy", -1),
        ("scale_energy", np.nan),
    ],
)
def test_arrays_with_values_that_no_tracker_has_are_refused(name, value, data):
    packed = msgpack.unpackb(data)["arrays"][name]
    with pytest.raises(BadSnapshot, match=f"{name}.*values"):
        MFCMT.from_bytes(changed(data, "arrays", name, array(packed["shape"], value, packed["dtype"])))


@pytest.mark.parametrize(
    "name", ["format", "version", "config", "frame_size", "base_size", "grey", "center", "anchor", "scale"]
)
def test_missing_fields_are_refused(name, data):
    document = msgpack.unpackb(data)
    del document[name]
    with pytest.raises(BadSnapshot):
        MFCMT.from_bytes(msgpack.packb(document))


@pytest.mark.parametrize(
    "value",
    [
        None,
        7,
        "text",
        [1, 2],
        b"",
        b"\xc1",
        b"\x93NUMPY",
        msgpack.packb(None),
        msgpack.packb([1, 2, 3]),
        msgpack.packb({1: 2}),
        msgpack.packb({"format": FORMAT}),
        b"\x91" * 100_000,  # lists in lists
        b"\xdd\xff\xff\xff\xff",  # a list of four thousand million
        b"\xdf\xff\xff\xff\xff\xa1a",
        b"\xc6\xff\xff\xff\xff1234",
        b"\xd6\xff" + bytes(4),  # a time
        bytes(MAX_BYTES + 1),
    ],
    ids=lambda value: repr(value)[:40],
)
def test_other_documents_are_refused(value):
    with pytest.raises(BadSnapshot):
        MFCMT.from_bytes(value)


def test_trailing_bytes_are_refused(data):
    with pytest.raises(BadSnapshot):
        MFCMT.from_bytes(data + b"\x00")


def test_scores_stay_finite_after_a_flat_history(data, frames):
    tiny = 5e-324
    result = MFCMT.from_bytes(changed(data, "reliability", "history", [[tiny, tiny, tiny]])).update(frames[13])
    assert_sane(result, (320, 240))


def test_floats_are_kept_to_the_last_bit(frames):
    tracker = MFCMT(DEFAULT)
    tracker.init(frames[0], (132.1, 98.7, 56.3, 44.9))
    document = msgpack.unpackb(tracker.to_bytes())
    assert struct.pack("<2d", *document["base_size"]) == struct.pack("<2d", 56.3, 44.9)
