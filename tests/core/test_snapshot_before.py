"""Snapshots of the two versions before are read, and no older ones."""

from __future__ import annotations

import dataclasses

import msgpack
import numpy as np
import pytest

from mfcmt_core import MFCMT, BadSnapshot, MFCMTConfig, synthetic
from mfcmt_core.snapshot import MISSING_CONFIG, VERSION

AS_BEFORE = MFCMTConfig.default().replace(**MISSING_CONFIG[3])
LANES = 8
"""It padded the scales to each side to a multiple of this many."""


def packed(values):
    little = np.ascontiguousarray(values, values.dtype.newbyteorder("<"))
    return {"dtype": little.dtype.str, "shape": list(little.shape), "data": little.tobytes()}


def as_version_4(tracker):
    """Return the document as version 4 wrote it: no look, no confidence and no parameters of it."""
    document = msgpack.unpackb(tracker.to_bytes())
    document["version"] = 4
    del document["confidence"], document["looks"]
    del document["reliability"]["tracking"], document["reliability"]["low_run"]
    for name in ("first_look", "search_look_first", "search_look_latest"):
        del document["arrays"][name]
    for name in MISSING_CONFIG[4]:
        del document["config"][name]
    return document


def as_version_3(tracker):
    """Return the document as version 3 wrote it: the scale filter as real waves; no anchor, rival or waited."""
    document, target = as_version_4(tracker), tracker._target
    document["version"] = 3
    for name in ("anchor", "rival", "waited"):
        del document[name]
    for name in MISSING_CONFIG[3].keys() - MISSING_CONFIG[4].keys():
        del document["config"][name]
    if target.scale_model:
        del document["arrays"]["scale_mean"]
        document["arrays"] |= scales_as_waves(target.scale_model)
    return document


def scales_as_waves(scale_model):
    """Return cosine and sine sums side by side, frequency 0 apart, and the energy with frequency 0 last."""
    numerator = scale_model.numerator.reshape(-1, scale_model.numerator.shape[-1])
    waves, constant = numerator[:, 1:], numerator[:, 0].real
    padding = -waves.shape[1] % LANES
    sums = [np.pad(part, ((0, 0), (0, padding))) for part in (waves.real, -waves.imag)]
    energy = np.append(np.pad(scale_model.energy[1:], (0, padding)), scale_model.energy[0])
    arrays = {"scale_waves": np.concatenate(sums, axis=1), "scale_sums": constant, "scale_energy": energy}
    return {name: packed(values) for name, values in arrays.items()}


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"scale_samples": 33},
        {"num_scales": 17, "scale_samples": 17},
        {"num_scales": 21, "scale_samples": 21},
        {"num_scales": 1},
        {"background_interval": 0, "average": "filter", "joint_filter": False},
        {"color_histogram": False},
        {"features": ()},
    ],
    ids=repr,
)
@pytest.mark.parametrize("gray", [False, True])
@pytest.mark.parametrize("as_before", [as_version_4, as_version_3])
def test_a_snapshot_of_a_previous_version_is_read(as_before, changes, gray):
    config, sequence = AS_BEFORE.replace(**changes), synthetic.clip("motion", gray=gray)
    tracker = MFCMT(config)
    for _ in tracker.track(sequence.frames[:13], sequence.boxes[0]):
        pass
    document = as_before(tracker)
    restored = MFCMT.from_bytes(msgpack.packb(document))
    assert restored.config == config
    again = msgpack.unpackb(restored.to_bytes())
    assert again["version"] == VERSION
    assert set(again["arrays"]) == set(msgpack.unpackb(tracker.to_bytes())["arrays"])
    if config.num_scales > 1:  # nothing is lost of these
        assert np.array_equal(restored._target.scale_model.numerator, tracker._target.scale_model.numerator)
        assert np.array_equal(restored._target.scale_model.energy, tracker._target.scale_model.energy)
    for frame in sequence.frames[13:20]:
        result, expected = restored.update(frame), tracker.update(frame)
        assert dataclasses.replace(result, confidence=expected.confidence) == expected
    assert MFCMT.from_bytes(restored.to_bytes()).to_bytes() == restored.to_bytes()


@pytest.mark.parametrize("seen", [13, 14])
def test_the_first_snapshots_of_version_4_are_read(seen):
    """They had no rival and no waited; the scale was searched in every second learned frame."""
    sequence = synthetic.clip("motion")
    tracker = MFCMT()
    for result in tracker.track(sequence.frames[:seen], sequence.boxes[0]):
        assert result.updated
    document = as_version_4(tracker)
    expected = MFCMT.from_bytes(msgpack.packb(document)).to_bytes()
    assert (document.pop("rival"), document.pop("waited")) == (None, (seen - 1) % 2)
    assert MFCMT.from_bytes(msgpack.packb(document)).to_bytes() == expected


@pytest.mark.parametrize("version", [0, 1, 2, VERSION + 1])
def test_any_other_version_is_refused(version, frames, clip):
    tracker = MFCMT(AS_BEFORE)
    tracker.init(frames[0], clip.boxes[0])
    for document in (as_version_3(tracker), msgpack.unpackb(tracker.to_bytes())):
        document["version"] = version
        with pytest.raises(BadSnapshot, match=f"version {version} is not one of 5, 4, 3"):
            MFCMT.from_bytes(msgpack.packb(document))


def test_the_first_frame_after_an_older_snapshot_gives_the_first_look(frames, clip):
    tracker = MFCMT(AS_BEFORE)
    tracker.init(frames[0], clip.boxes[0])
    restored = MFCMT.from_bytes(msgpack.packb(as_version_4(tracker)))
    assert not restored._target.confidence.known
    assert restored.update(frames[1]).confidence > 0.5
    assert restored._target.confidence.known


def test_the_arrays_of_one_version_are_refused_under_another(frames, clip):
    """The version number says which arrays are expected."""
    tracker = MFCMT(AS_BEFORE)
    tracker.init(frames[0], clip.boxes[0])
    for document, version in ((as_version_3(tracker), VERSION), (msgpack.unpackb(tracker.to_bytes()), 3)):
        document |= {"version": version, "anchor": document["center"]}
        with pytest.raises(BadSnapshot, match=r"arrays are not|a field is missing"):
            MFCMT.from_bytes(msgpack.packb(document))
