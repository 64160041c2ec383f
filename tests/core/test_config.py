"""Parameters: checked, plain, and those of the paper where it gives them."""

from __future__ import annotations

import dataclasses
import json

import pytest

from mfcmt_core import BadConfig, MFCMTConfig


def test_the_paper_preset_has_the_parameters_of_the_paper():
    c = MFCMTConfig.paper()
    assert set(c.features) == {"gray", "fhog", "color_names"}
    assert not c.joint_filter
    assert c.regularization == 0.001
    assert c.output_sigma_factor == 1 / 16
    assert (c.template_learning_rate, c.histogram_learning_rate) == (0.02, 0.04)
    assert c.average == "filter"
    assert (c.window, c.search_area_scale, c.patch_size) == ("target", 2, 150)
    assert c.foreground_fraction == 0.85
    assert c.unseen_likelihood == 0
    assert (c.probability, c.sharpness, c.statistical_weight) == ("clip", 1, 1)
    assert (c.fused_threshold, c.template_threshold, c.statistical_threshold) == (0.5, 0.7, 0.5)
    assert c.usual_threshold == 0
    assert (c.num_scales, c.scale_step) == (33, 1.02)
    assert c.scale_when_reliable
    # every model learns a window of its own, every scale is sampled in every frame, as DSST has it
    assert (c.learn_within, c.scale_samples, c.scale_interval, c.scale_max_area) == (0, 33, 1, 512)


def test_default_preset_shares_windows_and_interpolates_scales():
    c = MFCMTConfig.default()
    assert (c.learn_within, c.num_scales, c.scale_samples, c.scale_max_area) == (1, 33, 15, 1024)
    assert c.scale_interval == 2


@pytest.mark.parametrize(("num_scales", "scale_samples"), [(1, 3), (3, 101), (33, 33), (33, 15), (101, 3)])
def test_there_may_be_more_or_fewer_samples_than_scales(num_scales, scale_samples):
    config = MFCMTConfig.default().replace(num_scales=num_scales, scale_samples=scale_samples, scale_step=1.01)
    assert (config.num_scales, config.scale_samples) == (num_scales, scale_samples)


@pytest.mark.parametrize("name", ["default", "paper"])
def test_presets_survive_a_round_trip_through_plain_values(name):
    config = MFCMTConfig.preset(name)
    values = json.loads(json.dumps(config.to_dict()))
    assert MFCMTConfig.from_dict(values) == config
    assert MFCMTConfig.from_dict({}) == MFCMTConfig.default()
    assert hash(config) == hash(MFCMTConfig.preset(name))
    with pytest.raises(dataclasses.FrozenInstanceError):
        config.patch_size = 3


BAD = [
    ("window", "round"),
    ("window", ["target"]),
    ("search_area_scale", 1.0),
    ("search_area_scale", float("nan")),
    ("search_area_scale", "2"),
    ("patch_size", 31),
    ("patch_size", 100.0),
    ("patch_size", True),
    ("patch_size", 10**9),
    ("features", ("gray", "gray")),
    ("features", ("color_names",)),
    ("features", ("sift",)),
    ("features", "gray"),
    ("features", 3),
    ("features", None),
    ("features", [["gray"]]),
    ("joint_filter", 1),
    ("color_name_table", 3),
    ("regularization", 0),
    ("regularization", -1e-3),
    ("regularization", float("inf")),
    ("output_sigma_factor", 0),
    ("template_learning_rate", 1.01),
    ("average", "mean"),
    ("probability", "softmax"),
    ("sharpness", 3),
    ("sharpness", 1.0),
    ("num_scales", 32),
    ("num_scales", 0),
    ("num_scales", -1),
    ("scale_samples", 14),
    ("scale_samples", 1),
    ("scale_samples", -15),
    ("scale_samples", 103),
    ("scale_samples", 15.0),
    ("scale_interval", 0),
    ("scale_interval", -2),
    ("scale_interval", 10**7),
    ("scale_interval", 2.0),
    ("scale_interval", True),
    ("scale_interval", None),
    ("learn_within", -0.1),
    ("learn_within", 10.5),
    ("learn_within", float("nan")),
    ("learn_within", "1"),
    ("learn_within", None),
    ("scale_step", 1.0),
    ("scale_step", 1.5),  # 1.5 to the 16th
    ("lost_after", -1),
    ("lost_after", 2.5),
    ("usual_frames", 0),
]


@pytest.mark.parametrize(("name", "value"), BAD)
def test_bad_values_are_refused_by_name(name, value):
    changes = {name: value} | ({"color_histogram": False} if value == ("color_names",) else {})
    with pytest.raises(BadConfig):
        MFCMTConfig.from_dict(changes)
    if name != "features" and value != 1.5:
        with pytest.raises(BadConfig, match=name):
            MFCMTConfig.default().replace(**changes)


def test_unknown_names_are_refused():
    with pytest.raises(BadConfig, match="'sigma', 'zoom'"):
        MFCMTConfig.from_dict({"zoom": 1, "sigma": 2})
    with pytest.raises(BadConfig):
        MFCMTConfig.from_dict({"zoom": 1, 3: 2})
    with pytest.raises(BadConfig, match="fast"):
        MFCMTConfig.preset("fast")
    with pytest.raises(BadConfig, match="fast"):
        MFCMTConfig.preset("to_dict; fast")


def test_a_configuration_needs_a_cue_that_works_on_gray_targets():
    with pytest.raises(BadConfig, match="a gray target needs"):
        MFCMTConfig.default().replace(color_histogram=False, features=())
    assert MFCMTConfig.default().replace(features=()).features == ()


def test_every_field_is_checked_and_explained():
    """An object is refused as the value of each field, and each field has a docstring."""
    for field in dataclasses.fields(MFCMTConfig):
        with pytest.raises(BadConfig):
            MFCMTConfig.from_dict({field.name: object()})
