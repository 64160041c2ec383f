"""Every parameter of the tracker, with its meaning and its place in the paper."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace
from typing import Any, Literal

from .errors import BadConfig

WindowShape = Literal["target", "context", "square"]


@dataclass(frozen=True, slots=True)
class MFCMTConfig:
    """Parameters, the same for every sequence. Lengths are pixels, rates a frame.

    The field defaults are those of :meth:`default`; :meth:`paper` follows the paper to the letter.
    Raises BadConfig for a value out of its range.
    """

    # Search window (section IV-A: "twice the last object size", resized to 150×150)
    window: WindowShape = "context"
    """Shape: ``target`` k·(w, h); ``context`` (w, h) + (k - 1)·(w + h) / 2; ``square`` k·√(wh)."""
    search_area_scale: float = 2.5
    """k, the factor of the window over the target."""
    patch_size: int = 100
    """Side of the square patch that the window is resized to; cells are 4×4 of its pixels."""

    # Template models (section III-A, equations 1–3)
    features: tuple[str, ...] = ("gray", "fhog", "color_names")
    """Cues of the template models, in the order of their planes; empty for none."""
    joint_filter: bool = True
    """One regression over all cues; otherwise one a cue."""
    hog_epsilon: float = 10.0
    """Energy added to each block of fHOG before it is normalised, in squared grey levels: noise stays small."""
    color_name_table: str | None = None
    """A ``.npy`` of shape (32768, L) to use instead of the computed colour-name table."""
    regularization: float = 1e-3
    """λ of equation 1, for normalised transforms."""
    output_sigma_factor: float = 1 / 16
    """Standard deviation of the label over √(wh) of the target."""
    template_learning_rate: float = 0.015
    """η_t of equation 11."""
    average: Literal["filter", "spectra"] = "spectra"
    """What equation 11 averages: W itself, or its numerator and denominator."""
    background_interval: int = 4
    """Learned frames from one training of the background-aware filter to the next; 0: there is no such filter."""
    learn_within: float = 1.0
    """Cells from the middle of a searched window within which, and within a step of scale, the models learn from it,
    moved to the target's exact place. 0: they learn from a window cut anew, at the next whole pixel."""

    # Statistical model (equations 4–7)
    color_histogram: bool = True
    """Whether there is a statistical model."""
    foreground_fraction: float = 0.85
    """Part of the target's sides that counts as foreground."""
    histogram_learning_rate: float = 0.04
    """η_s of equation 11."""
    unseen_likelihood: float = 0.0
    """Equation 6 for colours that neither region has shown."""
    surroundings_weight: float = 0.5
    """Of the mean likelihood in a band around a box, what is taken from the box's own; 0: equation 7 alone."""

    # Fusion (section III-B, equations 8–10)
    probability: Literal["clip", "minimum", "raw"] = "minimum"
    """How a response becomes a probability map: negatives clipped, minimum subtracted, or not at all."""
    sharpness: int = 1
    """Power, 1 or 2, that a map is raised to before it is normalised."""
    statistical_weight: float = 3.0
    """Weight of the statistical map in the weighted equation 9; each template map has 1."""

    # Reliability and update (section III-C)
    fused_threshold: float = 0.5
    """γ_q: of the fused peak over its ten-frame mean."""
    template_threshold: float = 0.7
    """γ_t: of the template peak over its ten-frame mean."""
    statistical_threshold: float = 0.5
    """γ_s: of the statistical peak over its ten-frame mean."""
    usual_threshold: float = 0.25
    """Template and statistical peak must also exceed this part of their slow means over learned frames; 0: no test."""
    usual_frames: int = 100
    """Length of those slow means."""
    lost_after: int = 30
    """Frames in a row that fail before the target counts as lost; 0 for never."""
    found_threshold: float = 0.6
    """A lost target is found again where both peaks exceed this part of their slow means."""
    doubt_threshold: float = 0.6
    """A template peak below this part of its slow mean has the tracker look at other places, too; 0: never."""
    doubt_margin: float = 2.0
    """How many times the template peak of another place must be to move there."""

    # Scale (Algorithm 1, line 8; DSST)
    num_scales: int = 33
    """Scales searched, odd; 1 for a fixed size."""
    scale_samples: int = 15
    """Of these so many are sampled, odd; between them the response is interpolated (fDSST)."""
    scale_step: float = 1.02
    """Ratio of neighbouring scales."""
    scale_interval: int = 2
    """Searched and learned in every so many-th learned frame, later where that one looks at other places, too."""
    scale_learning_rate: float = 0.025
    scale_regularization: float = 1e-2
    scale_sigma_factor: float = 0.25
    """Standard deviation of the scale label over √num_scales."""
    scale_max_area: float = 1024.0
    """Pixels of a scale sample, at most."""
    scale_when_reliable: bool = True
    """Search the scale on reliable frames only."""

    @classmethod
    def default(cls) -> MFCMTConfig:
        """The choices that track best over many sequences; docs/tracker.md has the measured differences."""
        return cls()

    @classmethod
    def paper(cls) -> MFCMTConfig:
        """The paper wherever it speaks; docs/tracker.md lists the decisions that fill its gaps."""
        return cls(
            window="target",
            search_area_scale=2.0,
            patch_size=150,
            joint_filter=False,
            hog_epsilon=1e-4,
            template_learning_rate=0.02,
            average="filter",
            background_interval=0,
            surroundings_weight=0.0,
            probability="clip",
            sharpness=1,
            statistical_weight=1.0,
            usual_threshold=0.0,
            lost_after=0,
            doubt_threshold=0.0,
            learn_within=0.0,
            scale_samples=33,
            scale_interval=1,
            scale_max_area=512.0,
        )

    @classmethod
    def preset(cls, name: str) -> MFCMTConfig:
        """``"default"`` or ``"paper"``. Raises BadConfig for another name."""
        if name not in PRESETS:
            raise BadConfig(f"preset {name!r} is not one of {', '.join(PRESETS)}")
        return getattr(cls, name)()  # type: ignore[no-any-return]

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> MFCMTConfig:
        """The inverse of :meth:`to_dict`; missing fields take the default. Raises BadConfig."""
        unknown = set(values) - {f.name for f in fields(cls)}
        if unknown:
            raise BadConfig(f"no parameter is called {', '.join(sorted(map(repr, unknown)))}")
        try:
            return cls(**values)
        except TypeError as error:
            raise BadConfig(str(error)) from error

    def to_dict(self) -> dict[str, Any]:
        """Plain values, ready for JSON or MessagePack."""
        return asdict(self) | {"features": list(self.features)}

    def replace(self, **changes: Any) -> MFCMTConfig:
        """A copy with some parameters changed. Raises BadConfig."""
        return replace(self, **changes)

    def __post_init__(self) -> None:
        object.__setattr__(self, "features", tuple(self.features))
        for name, allowed in _CHOICES.items():
            if getattr(self, name) not in allowed:
                raise BadConfig(f"{name}={getattr(self, name)!r} is not one of {allowed}")
        for name, (kind, low, high) in _RANGES.items():
            value = getattr(self, name)
            number = isinstance(value, int | float if kind is float else int) and not isinstance(value, bool)
            if not number or not low <= value <= high:
                raise BadConfig(f"{name}={value!r} is not {kind.__name__} in [{low}, {high}]")
        for name in ("joint_filter", "color_histogram", "scale_when_reliable"):
            if not isinstance(getattr(self, name), bool):
                raise BadConfig(f"{name}={getattr(self, name)!r} is not a boolean")
        cues = ("gray", "fhog", "color_names")
        if not set(self.features) <= set(cues) or len(set(self.features)) != len(self.features):
            raise BadConfig(f"features={self.features!r} are not distinct ones of {cues}")
        if not (self.color_histogram or set(self.features) & {"gray", "fhog"}):
            raise BadConfig("without colour histogram, gray or fhog nothing is left to track a grey target by")
        if self.background_interval and self.average != "spectra":
            raise BadConfig("the background-aware filter learns from the mean of spectra: average='spectra'")
        for name in ("num_scales", "scale_samples"):
            if getattr(self, name) % 2 == 0:
                raise BadConfig(f"{name}={getattr(self, name)} is not odd")
        if self.scale_step ** (self.num_scales // 2) > MAX_ZOOM:
            raise BadConfig(f"{self.num_scales} scales of step {self.scale_step} go beyond a factor of {MAX_ZOOM}")
        if self.color_name_table is not None and not isinstance(self.color_name_table, str):
            raise BadConfig(f"color_name_table={self.color_name_table!r} is not a file name")


PRESETS = ("default", "paper")
MAX_ZOOM = 8.0
"""Largest scale of one search: its samples are cut from so many times the target's sides."""

_CHOICES: dict[str, tuple[Any, ...]] = {
    "window": ("target", "context", "square"),
    "average": ("filter", "spectra"),
    "probability": ("clip", "minimum", "raw"),
}
_RANGES: dict[str, tuple[type, float, float]] = {
    "search_area_scale": (float, 1.2, 10),
    "patch_size": (int, 32, 512),
    "hog_epsilon": (float, 1e-6, 1e6),
    "regularization": (float, 1e-8, 1e3),
    "output_sigma_factor": (float, 1e-3, 1),
    "template_learning_rate": (float, 0, 1),
    "foreground_fraction": (float, 0.05, 1),
    "background_interval": (int, 0, 1_000_000),
    "histogram_learning_rate": (float, 0, 1),
    "unseen_likelihood": (float, 0, 1),
    "surroundings_weight": (float, 0, 1),
    "sharpness": (int, 1, 2),
    "statistical_weight": (float, 0, 1e3),
    "fused_threshold": (float, 0, 10),
    "template_threshold": (float, 0, 10),
    "statistical_threshold": (float, 0, 10),
    "usual_threshold": (float, 0, 1),
    "usual_frames": (int, 1, 1_000_000),
    "lost_after": (int, 0, 1_000_000),
    "found_threshold": (float, 0, 10),
    "doubt_threshold": (float, 0, 1),
    "doubt_margin": (float, 1, 1e3),
    "learn_within": (float, 0, 10),
    "num_scales": (int, 1, 101),
    "scale_samples": (int, 3, 101),
    "scale_interval": (int, 1, 1_000_000),
    "scale_step": (float, 1.001, 1.5),
    "scale_learning_rate": (float, 0, 1),
    "scale_regularization": (float, 1e-8, 1e3),
    "scale_sigma_factor": (float, 0.01, 10),
    "scale_max_area": (float, 64, 4096),
}
