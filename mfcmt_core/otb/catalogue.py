"""Trackers by name: presets, ablations, the paper's rivals as configurations of our engine, peers, files."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Any

from ..config import PRESETS, MFCMTConfig
from ..errors import BadConfig, DataError
from .peers import PEERS, Peer
from .protocol import PROTOCOLS
from .trackers import Engine, Entry, ResultFolder

ALWAYS_UPDATE: dict[str, Any] = {
    "fused_threshold": 0.0,
    "template_threshold": 0.0,
    "statistical_threshold": 0.0,
    "usual_threshold": 0.0,
    "lost_after": 0,
}
ONE_FILTER: dict[str, Any] = {"background_interval": 0, "statistical_weight": 1.5}
"""Only the ridge filter; the statistical map keeps its part of the sum."""
FIXED_MERGE: dict[str, Any] = {"probability": "raw", "sharpness": 1, "statistical_weight": 0.3 / 0.7}
"""Staple's: 0.7 template + 0.3 histogram, of the responses as they are. For one template map."""

ABLATIONS: dict[str, dict[str, Any]] = {
    "gray": {"features": ("gray",), "color_histogram": False},
    "fhog": {"features": ("fhog",), "color_histogram": False},
    "color-names": {"features": ("gray", "color_names"), "color_histogram": False},
    "histogram": {"features": (), "color_histogram": True},
    "no-histogram": {"color_histogram": False},
    "fixed-merge": FIXED_MERGE,
    "always-update": ALWAYS_UPDATE,
    "always-scale": {"scale_when_reliable": False},
    "no-scale": {"num_scales": 1},
}
"""``<preset>-<ablation>``: a preset with one thing taken away or one thing left. Color names keep the raw
pixels, since gray sequences have nothing else."""

CHOICES: dict[str, dict[str, Any]] = {
    "target-window": {"window": "target", "search_area_scale": 2.0},
    "patch-150": {"patch_size": 150},
    "separate-filters": {"joint_filter": False, "statistical_weight": 6.0},
    "one-filter": ONE_FILTER,
    "average-filter": {**ONE_FILTER, "average": "filter"},
    "one-look": {"doubt_threshold": 0.0},
    "rate-0.02": {"template_learning_rate": 0.02},
    "clipped": {"probability": "clip"},
    "box-alone": {"surroundings_weight": 0.0},
    "equal-weights": {"statistical_weight": 1.0},
    "raw-fhog": {"hog_epsilon": 1e-4},
    "never-lost": {"lost_after": 0},
    "always-anew": {"learn_within": 0.0},
    "all-scales": {"scale_samples": 33},
    "small-scale-samples": {"scale_max_area": 512.0},
    "scale-in-each": {"scale_interval": 1},
    "search-when-lost": {"search_after": 0},
}
"""``default-<choice>``: a choice in which default() differs from paper(), taken back alone. Filters themselves can
be averaged only without the background-aware one: ``average-filter`` compares with ``one-filter``."""

_AS_PUBLISHED: dict[str, Any] = {
    **ALWAYS_UPDATE,
    "search_after": 0,
    "background_interval": 0,
    "doubt_threshold": 0.0,
    "learn_within": 0.0,
    "surroundings_weight": 0.0,
    "scale_samples": 33,
    "scale_interval": 1,
    "scale_max_area": 512.0,
}

_TEMPLATE_ONLY: dict[str, Any] = {
    **_AS_PUBLISHED,
    "probability": "raw",
    "sharpness": 1,
    "joint_filter": True,
    "color_histogram": False,
    "window": "target",
    "patch_size": 150,
}

SYSTEMS: dict[str, dict[str, Any]] = {
    # Bertinetto et al., 2016: HOG and color histogram, fixed merge, every frame learned
    "staple": {
        **_AS_PUBLISHED,
        **FIXED_MERGE,
        "features": ("fhog",),
        "joint_filter": True,
        "color_histogram": True,
        "window": "context",
        "search_area_scale": 2.0,
        "patch_size": 150,
        "template_learning_rate": 0.01,
        "histogram_learning_rate": 0.04,
        "foreground_fraction": 0.8,
        "num_scales": 33,
    },
    # Li and Zhu, 2014: raw pixels, HOG and color names in one filter
    "samf": {
        **_TEMPLATE_ONLY,
        "features": ("gray", "fhog", "color_names"),
        "search_area_scale": 2.5,
        "output_sigma_factor": 0.1,
        "template_learning_rate": 0.01,
        "num_scales": 33,
    },
    # Danelljan et al., 2014: HOG and the scale filter
    "dsst": {
        **_TEMPLATE_ONLY,
        "features": ("fhog",),
        "search_area_scale": 2.0,
        "regularization": 1e-2,
        "template_learning_rate": 0.025,
        "num_scales": 33,
    },
    # Henriques et al., 2015, with the linear kernel, which makes KCF and DCF one
    "kcf": {
        **_TEMPLATE_ONLY,
        "features": ("fhog",),
        "search_area_scale": 2.5,
        "regularization": 1e-4,
        "output_sigma_factor": 0.1,
        "template_learning_rate": 0.02,
        "average": "filter",
        "num_scales": 1,
    },
    # Danelljan et al., 2014: color names beside the raw pixels
    "cn": {
        **_TEMPLATE_ONLY,
        "features": ("gray", "color_names"),
        "search_area_scale": 2.0,
        "regularization": 1e-2,
        "template_learning_rate": 0.075,
        "num_scales": 1,
    },
    # Henriques et al., 2012: raw pixels
    "csk": {
        **_TEMPLATE_ONLY,
        "features": ("gray",),
        "search_area_scale": 2.0,
        "regularization": 1e-2,
        "template_learning_rate": 0.075,
        "average": "filter",
        "num_scales": 1,
    },
    # Bolme et al., 2010: raw pixels, numerator and denominator averaged at a high rate
    "mosse": {
        **_TEMPLATE_ONLY,
        "features": ("gray",),
        "search_area_scale": 2.0,
        "template_learning_rate": 0.125,
        "average": "spectra",
        "num_scales": 1,
    },
    # Possegger et al., 2015: the color histogram alone
    "dat": {
        **_AS_PUBLISHED,
        "features": (),
        "color_histogram": True,
        "probability": "raw",
        "sharpness": 1,
        "window": "context",
        "search_area_scale": 2.0,
        "patch_size": 150,
        "num_scales": 1,
    },
}
"""What the paper compares with or builds on, out of our own parts: not the authors' trackers."""
SYSTEMS["dcf"] = SYSTEMS["kcf"]


def named_config(name: str) -> MFCMTConfig | None:
    """Return the configuration of a preset, of a preset with a change, or of a system; None for another name."""
    if name in PRESETS:
        return MFCMTConfig.preset(name)
    if name in SYSTEMS:
        return MFCMTConfig.default().replace(**SYSTEMS[name])
    preset, _, ablation = name.partition("-")
    changes = ABLATIONS.get(ablation) or CHOICES.get(ablation)
    if preset in PRESETS and changes:
        config = MFCMTConfig.preset(preset).replace(**changes)
        if ablation == "fixed-merge":  # all template maps share the 0.7
            maps = (1 if config.joint_filter else len(config.features)) + bool(config.background_interval)
            config = config.replace(statistical_weight=config.statistical_weight * maps)
        return config
    return None


def resolve(text: str, results: Path | None = None) -> Entry | ResultFolder:
    """Return the tracker that ``text`` names: ``NAME``, ``PATH``, ``LABEL=NAME`` or ``LABEL=PATH``.

    A peer whose library is not installed takes part with the files that another environment left in ``results``.
    Raises DataError for an unknown name and for a configuration that is not valid.
    """
    label, _, what = text.rpartition("=")
    if (config := named_config(what)) is not None:
        return Engine(label or what, config)
    if what in PEERS:
        peer = Peer(label or what, what)
        if peer.lacks:
            if results is not None and any((results / p / peer.name).is_dir() for p in PROTOCOLS):
                return ResultFolder(peer.name, results / "{protocol}" / peer.name)
            raise DataError(f"{what}: needs {peer.lacks} (make bench-peers sets up an environment with it)")
        return peer
    path = Path(what)
    if path.is_dir() or "{protocol}" in what:
        return ResultFolder(label or path.resolve().name, path)
    if path.is_file():
        return Engine(label or path.stem, read_config(path))
    names = [*PRESETS, *SYSTEMS, *PEERS]
    raise DataError(f"no tracker {what!r}: neither a file, nor a folder, nor one of {', '.join(names)}")


def read_config(path: Path) -> MFCMTConfig:
    """Read a configuration in TOML or JSON: fields of MFCMTConfig and ``base``, the name to start from.

    Raises DataError if the file cannot be read, or is not a valid configuration.
    """
    try:
        text = path.read_text(encoding="utf-8")
        given: Any = json.loads(text) if path.suffix == ".json" else tomllib.loads(text)
    except (OSError, ValueError) as failed:
        raise DataError(f"{path}: {failed}") from None
    if not isinstance(given, dict):
        raise DataError(f"{path}: not fields with values")
    base = named_config(str(given.pop("base", "default")))
    if base is None:
        raise DataError(f"{path}: base is not a name of a configuration")
    try:
        return MFCMTConfig.from_dict(base.to_dict() | given)
    except BadConfig as bad:
        raise DataError(f"{path}: {bad}") from None
