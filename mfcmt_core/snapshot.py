"""Write a tracker to bytes and read it back: MessagePack around raw little-endian arrays, never pickle.

The names in a snapshot are part of its format and older than some of those in the code.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from math import isfinite
from typing import TYPE_CHECKING, Any

import msgpack
import numpy as np
import numpy.typing as npt

from .confidence import SLOW
from .config import MFCMTConfig
from .errors import BadConfig, BadSnapshot
from .geometry import MAX_FRAME_SIDE
from .reliability import HISTORY
from .scale import LANES

if TYPE_CHECKING:
    from .target import Target

FORMAT = "mfcmt-tracker"
VERSION = 5
WITHOUT_CONFIDENCE = 4
"""A version that is read but not written. It held no look of the target; later frames give them."""
WITH_REAL_WAVES = 3
"""The version before that, read as well. It held the scale filter as real waves, and no ``anchor``."""
_STATUS_BY_TESTS = {
    "search_after": 0,
    "tracking_threshold": 0.0,
    "lost_threshold": 0.0,
    "hysteresis": 0.0,
    "learn_threshold": 0.0,
}
MISSING_CONFIG: dict[int, dict[str, float]] = {
    VERSION: {},
    WITHOUT_CONFIDENCE: _STATUS_BY_TESTS,
    WITH_REAL_WAVES: _STATUS_BY_TESTS | {"scale_interval": 1, "surroundings_weight": 0.0},
}
"""For each version that is read, the values of the parameters that it did not have."""
MAX_VALUE = 1e12
"""Largest value in any array: far above what images give, and responses to it stay inside float32."""
MIN_SIDE = 1e-3
"""Smallest side of a target. Older trackers accepted boxes below one pixel, and their snapshots are still read."""
SIGNED = ("scale_waves",)
"""Arrays of real numbers that may be negative."""
MAX_BYTES = 16 << 20
"""Size above which a snapshot is refused unread; that of the default preset is well below one megabyte."""


@dataclass(frozen=True, slots=True)
class State:
    """The state in a snapshot, checked except for the arrays. ``reliability`` has the attributes of Reliability."""

    version: int
    base_size: tuple[float, float]
    is_gray: bool
    center: tuple[float, float]
    last_reliable_center: tuple[float, float]
    scale: float
    runner_up: tuple[float, float] | None
    frames_since_scale_search: int
    reliability: dict[str, Any]
    confidence: dict[str, Any]
    looks: dict[str, Any]
    arrays: dict[str, Any]


def dump(config: MFCMTConfig, target: Target, frame_size: tuple[int, int]) -> bytes:
    """Return the bytes of everything that decides later results."""
    r, c = target.reliability, target.confidence
    document = {
        "format": FORMAT,
        "version": VERSION,
        "config": config.to_dict(),
        "frame_size": list(frame_size),
        "base_size": list(target.base_size),
        "grey": target.is_gray,
        "center": list(target.center),
        "anchor": list(target.last_reliable_center),
        "scale": target.scale,
        "rival": target.runner_up,
        "waited": target.scale_model.frames_since_search if target.scale_model else 0,
        "reliability": {
            "history": [list(peaks) for peaks in r.history],
            "usual": list(r.long_term_means),
            "learned": r.learned,
            "unreliable_run": r.unreliable_run,
            "lost": r.lost,
            "doubtful": r.template_low,
            "tracking": r.tracking,
            "low_run": r.low_run,
        },
        "confidence": {"slow": list(c.slow), "judged": c.judged, "known": c.known, "blank": c.blank},
        "looks": {"known": target.looks.known, "turn": target.looks.turn},
        "arrays": {name: _pack(array) for name, array in _arrays(target).items()},
    }
    data: bytes = msgpack.packb(document)
    return data


def parse(data: bytes) -> tuple[MFCMTConfig, State, tuple[int, int]]:
    """Return the configuration, the state and the frame size (w, h) of a snapshot. Raises BadSnapshot.

    Everything is checked but the arrays, which :func:`restore` checks against the models.
    """
    if not isinstance(data, bytes | bytearray | memoryview):
        raise BadSnapshot(f"{type(data).__name__} is not bytes")
    if len(data) > MAX_BYTES:
        raise BadSnapshot(f"{len(data)} bytes are more than {MAX_BYTES}")
    try:
        document = msgpack.unpackb(data)
    except Exception as error:  # msgpack raises many kinds for bytes that are not its own
        raise BadSnapshot("not MessagePack") from error
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        raise BadSnapshot("not a tracker's snapshot")
    version = document.get("version")
    if type(version) is not int or version not in MISSING_CONFIG:
        raise BadSnapshot(f"version {version!r} is not one of {', '.join(map(str, MISSING_CONFIG))}")
    try:
        config = MFCMTConfig.from_dict(MISSING_CONFIG[version] | document["config"])
        width, height = (_integer(v, 1, MAX_FRAME_SIDE) for v in document["frame_size"])
        w, h = (_number(v, MIN_SIDE, 4 * MAX_FRAME_SIDE) for v in document["base_size"])
        if version == WITH_REAL_WAVES:
            document["anchor"] = document["center"]
        center, anchor = (_place(document[name], (width, height)) for name in ("center", "anchor"))
        r = document["reliability"]
        reliability = {
            "history": _history(r["history"]),
            "long_term_means": _pair(r["usual"], -1e6, 1e6),
            "learned": _integer(r["learned"], 0, 1 << 62),
            "unreliable_run": _integer(r["unreliable_run"], 0, 1 << 62),
            "lost": _boolean(r["lost"]),
            "template_low": _boolean(r["doubtful"]),
            "tracking": _boolean(r["tracking"]) if version == VERSION else True,
            "low_run": _integer(r["low_run" if version == VERSION else "unreliable_run"], 0, 1 << 62),
        }
        confidence = _confidence(document["confidence"]) if version == VERSION else {}
        looks = _looks(document["looks"]) if version == VERSION else {}
        scale = _number(document["scale"], 1e-6, 1e10)
        # the first snapshots of this version had neither: the scale was searched in every N-th learned frame
        runner_up = document.get("rival")
        waited = document.get("waited", r["learned"] % config.scale_interval)
        state = State(
            version,
            (w, h),
            _boolean(document["grey"]),
            center,
            anchor,
            scale,
            None if runner_up is None else _place(runner_up, (width, height)),
            _integer(waited, 0, 1 << 62),
            reliability,
            confidence,
            looks,
            dict(document["arrays"]),
        )
    except (KeyError, TypeError, ValueError, BadConfig) as error:
        raise BadSnapshot(f"a field is missing or out of its range: {error}") from error
    return config, state, (width, height)


def restore(target: Target, state: State) -> None:
    """Fill a target that was built for ``state``. Raises BadSnapshot if an array does not fit its models."""
    expected = _arrays_of(state.version, target)
    if set(expected) != set(state.arrays):
        raise BadSnapshot(f"the arrays are not {sorted(expected)}")
    for name, array in expected.items():
        _unpack(name, state.arrays[name], array)
    target.center, target.last_reliable_center = state.center, state.last_reliable_center
    target.scale, target.runner_up = state.scale, state.runner_up
    if target.scale_model:
        target.scale_model.frames_since_search = state.frames_since_scale_search
    for name, value in state.reliability.items():
        setattr(target.reliability, name, value)
    for name, value in state.confidence.items():
        setattr(target.confidence, name, value)
    for name, value in state.looks.items():
        setattr(target.looks, name, value)
    if target.scale_model and state.version == WITH_REAL_WAVES:
        waves, sums, energy = (expected[name] for name in ("scale_waves", "scale_sums", "scale_energy"))
        target.scale_model.load_real_waves(waves, sums, energy)
    if max(target.looks.first.max(), target.looks.latest.max()) > 255:
        raise BadSnapshot("looks brighter than a pixel can be")
    if target.template:
        target.template.refresh()
    if target.color:
        if not (target.color.decay_scale > 0).all():
            raise BadSnapshot("histograms without gain")
        target.color.refresh()


def _arrays(target: Target) -> dict[str, npt.NDArray[Any]]:
    """Return the live arrays of every model by their names in a snapshot, without those that follow from others."""
    arrays: dict[str, npt.NDArray[Any]] = {}
    if t := target.template:
        arrays["mean"] = t.numerator
        if t.average == "spectra":
            arrays["denominator"] = t.denominator
        if t.background:
            arrays |= {"background_filters": t.background.filters, "background_unmasked": t.background.unmasked}
    if c := target.color:
        arrays |= {"histograms": c.histograms, "histogram_gain": c.decay_scale}
    if s := target.scale_model:
        arrays |= {"scale_mean": s.numerator, "scale_energy": s.energy}
    looks = {"search_look_first": target.looks.first, "search_look_latest": target.looks.latest}
    return arrays | {"first_look": target.confidence.first} | looks


def _arrays_of(version: int, target: Target) -> dict[str, npt.NDArray[Any]]:
    """Return the arrays that a snapshot of this version holds, by name."""
    arrays = _arrays(target)
    if version != VERSION:
        for name in ("first_look", "search_look_first", "search_look_latest"):
            del arrays[name]
    if version == WITH_REAL_WAVES and target.scale_model:  # as ScaleModel.load_real_waves takes them
        cells, channels, half = arrays.pop("scale_mean").shape
        lanes = -(-(half - 1) // LANES) * LANES
        arrays |= {
            "scale_waves": np.empty((cells * channels, 2 * lanes), np.float32),
            "scale_sums": np.empty(cells * channels, np.float32),
            "scale_energy": np.empty(lanes + 1, np.float32),
        }
    return arrays


def _pack(array: npt.NDArray[Any]) -> dict[str, Any]:
    little = array.astype(array.dtype.newbyteorder("<"), copy=False)
    return {"dtype": little.dtype.str, "shape": list(array.shape), "data": little.tobytes()}


def _unpack(name: str, packed: Any, into: npt.NDArray[Any]) -> None:
    dtype = into.dtype.newbyteorder("<")
    fits = (
        isinstance(packed, dict)
        and packed.get("dtype") == dtype.str
        and packed.get("shape") == list(into.shape)
        and isinstance(packed.get("data"), bytes)
        and len(packed["data"]) == into.nbytes
    )
    if not fits:
        raise BadSnapshot(f"array {name!r} is not {dtype.str} of shape {into.shape}")
    values = np.frombuffer(packed["data"], dtype).reshape(into.shape)
    lowest = 0 if into.dtype.kind == "f" and name not in SIGNED else -np.inf  # histograms and energies
    if not (np.abs(values) <= MAX_VALUE).all() or (values.real < lowest).any():
        raise BadSnapshot(f"array {name!r} has values that no tracker has")
    into[...] = values


def _number(value: Any, low: float, high: float) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not isfinite(value) or not low <= value <= high:
        raise ValueError(f"{value!r} is not a number in [{low}, {high}]")
    return float(value)


def _integer(value: Any, low: int, high: int) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise ValueError(f"{value!r} is not an integer in [{low}, {high}]")
    return value


def _pair(value: Any, low: float, high: float) -> tuple[float, float]:
    first, second = (_number(v, low, high) for v in value)
    return first, second


def _place(value: Any, frame_size: tuple[int, int]) -> tuple[float, float]:
    x, y = (_number(v, 0, side) for v, side in zip(value, frame_size, strict=True))
    return x, y


def _history(value: Any) -> deque[tuple[float, float, float]]:
    if not isinstance(value, list) or len(value) > HISTORY:
        raise ValueError(f"not a history of at most {HISTORY} frames")
    rows = [tuple(_number(v, -1e6, 1e6) for v in row) for row in value]
    if any(len(row) != 3 for row in rows):
        raise ValueError("a frame has three peaks")
    return deque(rows, maxlen=HISTORY)  # type: ignore[arg-type]


def _confidence(fields: Any) -> dict[str, Any]:
    slow = [_number(v, -1e6, 1e6) for v in fields["slow"]]
    if len(slow) != len(SLOW):
        raise ValueError(f"not {len(SLOW)} slow means")
    judged = _integer(fields["judged"], 0, 1 << 62)
    return {"slow": slow, "judged": judged} | {name: _boolean(fields[name]) for name in ("known", "blank")}


def _looks(fields: Any) -> dict[str, Any]:
    return {"known": _boolean(fields["known"]), "turn": _integer(fields["turn"], 0, 1 << 62)}


def _boolean(value: Any) -> bool:
    if not isinstance(value, bool):
        raise ValueError(f"{value!r} is not a boolean")
    return value
