"""Snapshots of the version before are read, and no older ones."""

from __future__ import annotations

import msgpack
import numpy as np
import pytest

from mfcmt_core import MFCMT, BadSnapshot, MFCMTConfig, synthetic
from mfcmt_core.snapshot import SINCE, VERSION

from .helpers import filters_of

AS_BEFORE = MFCMTConfig.default().replace(learn_within=0.0, scale_samples=101, scale_interval=1)
LANES = 8
"""It padded the scales to each side to a multiple of this many."""


def packed(values):
    little = np.ascontiguousarray(values, values.dtype.newbyteorder("<"))
    return {"dtype": little.dtype.str, "shape": list(little.shape), "data": little.tobytes()}


def as_version_2(tracker):
    """The document that it would have been: filters beside what they follow from, histograms apart, scales as waves."""
    document, target = msgpack.unpackb(tracker.to_bytes()), tracker._target
    document["version"] = 2
    del document["anchor"]
    for name in SINCE:
        del document["config"][name]
    arrays = document["arrays"]
    if target.template and target.template.average == "filter":
        arrays["filters"] = arrays.pop("mean")
    elif target.template:
        arrays["filters"] = packed(filters_of(target.template).astype("<c8"))
        arrays.pop("background_unmasked", None)
    if target.color:
        histograms = target.color.histograms / target.color.gain
        arrays |= {"foreground": packed(histograms[:, 0]), "background": packed(histograms[:, 1])}
        del arrays["histograms"], arrays["histogram_gain"]
    if target.sizes:
        del arrays["scale_mean"]
        arrays |= scales_as_waves(target.sizes)
    return document


def scales_as_waves(sizes):
    """Cosine and sine sums beside each other and frequency 0 apart; of the energy, that one last."""
    mean = sizes.mean.reshape(-1, sizes.mean.shape[-1])
    waves, constant = mean[:, 1:], mean[:, 0].real
    padding = -waves.shape[1] % LANES
    sums = [np.pad(part, ((0, 0), (0, padding))) for part in (waves.real, -waves.imag)]
    energy = np.append(np.pad(sizes.energy[1:], (0, padding)), sizes.energy[0])
    arrays = {"scale_waves": np.concatenate(sums, axis=1), "scale_sums": constant, "scale_energy": energy}
    return {name: packed(values) for name, values in arrays.items()}


@pytest.mark.parametrize(
    ("changes", "tolerance"),
    [
        ({"background_interval": 0}, 1e-3),
        ({"background_interval": 0, "num_scales": 17}, 1e-3),
        ({"background_interval": 0, "num_scales": 21}, 1e-3),
        ({"background_interval": 0, "num_scales": 1}, 1e-3),
        ({"background_interval": 0, "average": "filter", "joint_filter": False}, 1e-3),
        ({"background_interval": 0, "color_histogram": False}, 1e-3),
        ({"background_interval": 0, "features": ()}, 1e-3),
        ({}, 2e-2),  # ADMM's multiplier was not held: the next training takes a step of its own
    ],
    ids=repr,
)
@pytest.mark.parametrize("grey", [False, True])
def test_the_version_before_is_read(changes, tolerance, grey):
    config, sequence = AS_BEFORE.replace(**changes), synthetic.clip("motion", grey=grey)
    tracker = MFCMT(config)
    for _ in tracker.track(sequence.frames[:13], sequence.boxes[0]):
        pass
    document = as_version_2(tracker)
    restored = MFCMT.from_bytes(msgpack.packb(document))
    assert restored.config == config
    again = msgpack.unpackb(restored.to_bytes())
    assert again["version"] == VERSION
    assert set(again["arrays"]) == set(msgpack.unpackb(tracker.to_bytes())["arrays"])
    if config.num_scales > 1:  # nothing is lost of these
        assert np.array_equal(restored._target.sizes.mean, tracker._target.sizes.mean)
        assert np.array_equal(restored._target.sizes.energy, tracker._target.sizes.energy)
    for frame in sequence.frames[13:20]:
        expected, result = tracker.update(frame), restored.update(frame)
        assert result.status == expected.status
        assert result.scale == pytest.approx(expected.scale)
        assert result.box == pytest.approx(expected.box, abs=tolerance)
    assert MFCMT.from_bytes(restored.to_bytes()).to_bytes() == restored.to_bytes()


def test_of_the_version_before_the_filters_are_not_believed(frames, clip):
    """They follow from the means."""
    tracker = MFCMT(AS_BEFORE)
    tracker.init(frames[0], clip.boxes[0])
    document = as_version_2(tracker)
    expected = MFCMT.from_bytes(msgpack.packb(document)).update(frames[1])
    shape = document["arrays"]["filters"]["shape"]
    document["arrays"]["filters"] = packed(np.full(shape, 3, np.complex64))
    assert MFCMT.from_bytes(msgpack.packb(document)).update(frames[1]) == expected
    document["arrays"]["filters"] = packed(np.full(shape, np.nan, np.complex64))
    with pytest.raises(BadSnapshot, match="filters"):
        MFCMT.from_bytes(msgpack.packb(document))


@pytest.mark.parametrize("version", [0, 1, VERSION + 1])
def test_any_other_version_is_refused(version, frames, clip):
    tracker = MFCMT(AS_BEFORE)
    tracker.init(frames[0], clip.boxes[0])
    for document in (as_version_2(tracker), msgpack.unpackb(tracker.to_bytes())):
        document["version"] = version
        with pytest.raises(BadSnapshot, match=f"version {version} is not 3 or 2"):
            MFCMT.from_bytes(msgpack.packb(document))


def test_versions_do_not_mix(frames, clip):
    """The arrays of one under the number of the other."""
    tracker = MFCMT(AS_BEFORE)
    tracker.init(frames[0], clip.boxes[0])
    for document, version in ((as_version_2(tracker), VERSION), (msgpack.unpackb(tracker.to_bytes()), 2)):
        document |= {"version": version, "anchor": document["center"]}
        with pytest.raises(BadSnapshot, match="arrays are not"):
            MFCMT.from_bytes(msgpack.packb(document))
