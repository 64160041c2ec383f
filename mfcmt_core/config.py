"""The parameters of the tracker: what each means, and where the paper has it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace
from typing import Any, Literal

from .errors import BadConfig

WindowShape = Literal["target", "context", "square"]

CUES = ("gray", "fhog", "color_names")
"""The cues of the template models."""


@dataclass(frozen=True, slots=True)
class MFCMTConfig:
    """The parameters of a tracker, the same for every sequence.

    The defaults of the fields are those of :meth:`default`; :meth:`paper` follows the paper to the letter. Lengths are
    in pixels, learning rates per learned frame. The description of each field stands below it, and docs/tracker.md
    says why the two presets differ.

    Raises
    ------
    BadConfig
        If a value is outside its range, or the values do not go together.

    Examples
    --------
    >>> from mfcmt_core import MFCMTConfig
    >>> config = MFCMTConfig.default().replace(num_scales=1)
    >>> config.num_scales, MFCMTConfig.from_dict(config.to_dict()) == config
    (1, True)
    """

    # Search window (section IV-A: "twice the last object size", resized to 150×150)
    window: WindowShape = "context"
    """Shape of the search window: ``target`` k·(w, h), ``context`` (w, h) + (k - 1)·(w + h) / 2, ``square`` k·√(wh)."""
    search_area_scale: float = 2.5
    """k, the size of the window as a multiple of the target's."""
    patch_size: int = 100
    """Side of the square patch that the window is resized to. A cell is 4×4 pixels of it."""

    # Template models (section III-A, equations 1–3)
    features: tuple[str, ...] = ("gray", "fhog", "color_names")
    """Cues of the template models, in the order of their feature planes. Empty: no template model."""
    joint_filter: bool = True
    """Solve one regression over all cues. False: one per cue."""
    hog_epsilon: float = 10.0
    """Energy added to each fHOG block before normalization, in squared gray levels: it damps noise in flat regions."""
    color_name_table: str | None = None
    """Path of a ``.npy`` file of shape (32768, L) to use instead of the computed color-name table."""
    regularization: float = 1e-3
    """λ of equation 1, for normalized transforms."""
    output_sigma_factor: float = 1 / 16
    """Standard deviation of the Gaussian label, as a fraction of √(wh) of the target."""
    template_learning_rate: float = 0.015
    """η_t of equation 11: learning rate of the template models."""
    average: Literal["filter", "spectra"] = "spectra"
    """What equation 11 averages over time: the filter W itself, or its numerator and denominator."""
    background_interval: int = 4
    """Train the background-aware filter on every N-th learned frame. 0: no such filter."""
    learn_within: float = 1.0
    """Learn from the searched window, shifted to the target's exact place, if the target is at most this many cells
    from its middle and at most one scale step from its size. 0: learn from a new window at the nearest whole pixel."""

    # Statistical model (equations 4–7)
    color_histogram: bool = True
    """Use the statistical model."""
    foreground_fraction: float = 0.85
    """Fraction of each of the target's sides that counts as foreground."""
    histogram_learning_rate: float = 0.04
    """η_s of equation 11: learning rate of the color histograms."""
    unseen_likelihood: float = 0.0
    """Likelihood (equation 6) of colors that neither region has shown."""
    surroundings_weight: float = 0.5
    """Fraction of the mean likelihood around a box that is subtracted from the mean in it. 0: equation 7 alone."""

    # Fusion (section III-B, equations 8–10)
    probability: Literal["clip", "minimum", "raw"] = "minimum"
    """How a response becomes a probability map: clip negative values, subtract the minimum, or keep it raw."""
    sharpness: int = 1
    """Power, 1 or 2, to which a map is raised before it is normalized."""
    statistical_weight: float = 3.0
    """Weight of the statistical map in the weighted form of equation 9. Each template map has weight 1."""

    # Reliability and update (section III-C)
    fused_threshold: float = 0.5
    """γ_q: a reliable frame's fused peak exceeds this multiple of its ten-frame mean."""
    template_threshold: float = 0.7
    """γ_t: the same for the template peak."""
    statistical_threshold: float = 0.5
    """γ_s: the same for the statistical peak."""
    usual_threshold: float = 0.25
    """In a reliable frame, both peaks also exceed this multiple of their long-term means. 0: no test."""
    usual_frames: int = 100
    """Number of learned frames that the long-term means cover."""
    lost_after: int = 30
    """Number of unreliable frames in a row after which the target is lost. 0: never."""
    found_threshold: float = 0.6
    """A lost target is found in a reliable frame whose peaks both exceed this multiple of their long-term means."""
    search_after: int = 4
    """Number of frames in a row with a confidence below ``lost_threshold`` after which the whole frame is searched for
    the target. 0: only once the target is lost."""
    doubt_threshold: float = 0.6
    """Probe other places, too, if the template peak is below this multiple of its long-term mean. 0: never."""
    doubt_margin: float = 2.0
    """Move to another place only if its template peak is this many times as high."""

    # Confidence (beyond the paper)
    tracking_threshold: float = 0.4
    """Confidence from which on a target is ``tracking``; below it is ``uncertain``. 0: the three tests alone decide
    over the status, and ``reliable`` does not ask for it."""
    lost_threshold: float = 0.2
    """Confidence below which a target counts as lost after ``lost_after`` frames in a row."""
    hysteresis: float = 0.05
    """How far beyond a threshold the confidence must be to bring a better status back."""
    learn_threshold: float = 0.0
    """Confidence that a frame needs, beside the three tests, for the models to learn from it."""

    # Scale (Algorithm 1, line 8; DSST)
    num_scales: int = 33
    """Number of scales searched, odd. 1: the size is fixed."""
    scale_samples: int = 15
    """Number of scales actually sampled, odd. The response is interpolated between them (fDSST)."""
    scale_step: float = 1.02
    """Ratio of neighboring scales."""
    scale_interval: int = 2
    """Search and learn the scale on every N-th learned frame, or later if that frame probes other places, too."""
    scale_learning_rate: float = 0.025
    """Learning rate of the scale filter."""
    scale_regularization: float = 1e-2
    """λ of the scale filter."""
    scale_sigma_factor: float = 0.25
    """Standard deviation of the scale label, as a fraction of √num_scales."""
    scale_max_area: float = 1024.0
    """Largest area of a scale sample in pixels."""
    scale_when_reliable: bool = True
    """Search the scale on reliable frames only. False: also on unreliable frames, without learning it."""

    @classmethod
    def default(cls) -> MFCMTConfig:
        """Return the preset that tracks best over many sequences; docs/tracker.md has the measured differences."""
        return cls()

    @classmethod
    def paper(cls) -> MFCMTConfig:
        """Return the preset that follows the paper; docs/tracker.md lists the decisions that fill its gaps."""
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
            search_after=0,
            tracking_threshold=0.0,
            lost_threshold=0.0,
            hysteresis=0.0,
            doubt_threshold=0.0,
            learn_within=0.0,
            scale_samples=33,
            scale_interval=1,
            scale_max_area=512.0,
        )

    @classmethod
    def preset(cls, name: str) -> MFCMTConfig:
        """Return the preset called ``"default"`` or ``"paper"``. Raises BadConfig for another name."""
        if name not in PRESETS:
            raise BadConfig(f"preset {name!r} is not one of {', '.join(PRESETS)}")
        return getattr(cls, name)()  # type: ignore[no-any-return]

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> MFCMTConfig:
        """Return the configuration with these fields. Missing fields take the default.

        Raises
        ------
        BadConfig
            If a field is unknown, outside its range, or does not go with the others.
        """
        unknown = set(values) - {f.name for f in fields(cls)}
        if unknown:
            raise BadConfig(f"no parameter is called {', '.join(sorted(map(repr, unknown)))}")
        try:
            return cls(**values)
        except TypeError as error:
            raise BadConfig(str(error)) from error

    def to_dict(self) -> dict[str, Any]:
        """Return the fields as plain values, ready for JSON or MessagePack."""
        return asdict(self) | {"features": list(self.features)}

    def replace(self, **changes: Any) -> MFCMTConfig:
        """Return a copy with some fields changed. Raises BadConfig as the constructor does."""
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
        if not set(self.features) <= set(CUES) or len(set(self.features)) != len(self.features):
            raise BadConfig(f"features={self.features!r} are not distinct ones of {CUES}")
        if not (self.color_histogram or set(self.features) & {"gray", "fhog"}):
            raise BadConfig("a gray target needs color_histogram, or gray or fhog among the features")
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
"""Largest factor of size in one scale search: it bounds the pixels that the samples are taken from."""

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
    "search_after": (int, 0, 1_000_000),
    "found_threshold": (float, 0, 10),
    "doubt_threshold": (float, 0, 1),
    "doubt_margin": (float, 1, 1e3),
    "tracking_threshold": (float, 0, 1),
    "lost_threshold": (float, 0, 1),
    "hysteresis": (float, 0, 1),
    "learn_threshold": (float, 0, 1),
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
