"""A tracker to bytes and back: MessagePack around raw little-endian arrays, never pickle."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from math import isfinite
from typing import TYPE_CHECKING, Any

import msgpack
import numpy as np
import numpy.typing as npt

from .config import MFCMTConfig
from .errors import BadConfig, BadSnapshot
from .geometry import MAX_FRAME_SIDE
from .reliability import HISTORY
from .scale import LANES

if TYPE_CHECKING:
    from .target import Target

FORMAT = "mfcmt-tracker"
VERSION = 4
PREVIOUS = 3
"""Held the scale filter as real waves, and no anchor. Read, not written."""
SINCE = {"scale_interval": 1, "surroundings_weight": 0.0}
"""Parameters that it did not know, as it had them."""
MAX_VALUE = 1e12
"""Of any array: far above what images give, and responses to it stay inside float32."""
MIN_SIDE = 1e-3
"""Of a target: trackers that were made before boxes below a pixel were refused are still read."""
SIGNED = ("scale_waves",)
"""Arrays of real numbers that may be negative."""
MAX_BYTES = 16 << 20
"""A larger one is refused unread; the default preset's takes well below one megabyte."""


@dataclass(frozen=True, slots=True)
class State:
    """What a snapshot holds beside the configuration, checked except for the arrays."""

    version: int
    base_size: tuple[float, float]
    grey: bool
    center: tuple[float, float]
    anchor: tuple[float, float]
    scale: float
    rival: tuple[float, float] | None
    waited: int
    reliability: dict[str, Any]
    arrays: dict[str, Any]


def dump(config: MFCMTConfig, target: Target, frame_size: tuple[int, int]) -> bytes:
    """Everything that decides later results."""
    r = target.reliability
    document = {
        "format": FORMAT,
        "version": VERSION,
        "config": config.to_dict(),
        "frame_size": list(frame_size),
        "base_size": list(target.base_size),
        "grey": target.grey,
        "center": list(target.center),
        "anchor": list(target.anchor),
        "scale": target.scale,
        "rival": target.rival,
        "waited": target.sizes.waited if target.sizes else 0,
        "reliability": {
            "history": [list(peaks) for peaks in r.history],
            "usual": list(r.usual),
            "learned": r.learned,
            "unreliable_run": r.unreliable_run,
            "lost": r.lost,
            "doubtful": r.doubtful,
        },
        "arrays": {name: _pack(array) for name, array in _arrays(target).items()},
    }
    data: bytes = msgpack.packb(document)
    return data


def parse(data: bytes) -> tuple[MFCMTConfig, State, tuple[int, int]]:
    """Check a snapshot as far as that is possible without building models. Raises BadSnapshot."""
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
    if document.get("version") not in (VERSION, PREVIOUS):
        raise BadSnapshot(f"version {document.get('version')!r} is not {VERSION} or {PREVIOUS}")
    try:
        config = MFCMTConfig.from_dict((SINCE if document["version"] == PREVIOUS else {}) | document["config"])
        width, height = (_integer(v, 1, MAX_FRAME_SIDE) for v in document["frame_size"])
        w, h = (_number(v, MIN_SIDE, 4 * MAX_FRAME_SIDE) for v in document["base_size"])
        if document["version"] == PREVIOUS:
            document["anchor"] = document["center"]
        center, anchor = (_place(document[name], (width, height)) for name in ("center", "anchor"))
        r = document["reliability"]
        reliability = {
            "history": _history(r["history"]),
            "usual": _pair(r["usual"], -1e6, 1e6),
            "learned": _integer(r["learned"], 0, 1 << 62),
            "unreliable_run": _integer(r["unreliable_run"], 0, 1 << 62),
            "lost": _boolean(r["lost"]),
            "doubtful": _boolean(r["doubtful"]),
        }
        scale = _number(document["scale"], 1e-6, 1e10)
        # the first of this version had neither: every so many-th learned frame was searched, whatever it was
        rival = document.get("rival")
        waited = document.get("waited", r["learned"] % config.scale_interval)
        state = State(
            document["version"],
            (w, h),
            _boolean(document["grey"]),
            center,
            anchor,
            scale,
            None if rival is None else _place(rival, (width, height)),
            _integer(waited, 0, 1 << 62),
            reliability,
            dict(document["arrays"]),
        )
    except (KeyError, TypeError, ValueError, BadConfig) as error:
        raise BadSnapshot(f"a field is missing or out of its range: {error}") from error
    return config, state, (width, height)


def restore(target: Target, state: State) -> None:
    """Fill a target built for ``state``'s sizes. Raises BadSnapshot where an array does not fit it."""
    expected = _arrays(target) if state.version == VERSION else _previous_arrays(target)
    if set(expected) != set(state.arrays):
        raise BadSnapshot(f"the arrays are not {sorted(expected)}")
    for name, array in expected.items():
        _unpack(name, state.arrays[name], array)
    target.center, target.anchor, target.scale = state.center, state.anchor, state.scale
    target.rival = state.rival
    if target.sizes:
        target.sizes.waited = state.waited
    for name, value in state.reliability.items():
        setattr(target.reliability, name, value)
    if target.sizes and state.version == PREVIOUS:
        target.sizes.adopt(*(expected[name] for name in ("scale_waves", "scale_sums", "scale_energy")))
    if target.template:
        target.template.refresh()
    if target.color:
        if not (target.color.gain > 0).all():
            raise BadSnapshot("histograms without gain")
        target.color.refresh()


def _arrays(target: Target) -> dict[str, npt.NDArray[Any]]:
    """The live arrays of every model by name; what follows from others is left out."""
    arrays: dict[str, npt.NDArray[Any]] = {}
    if t := target.template:
        arrays["mean"] = t.mean
        if t.average == "spectra":
            arrays["denominator"] = t.denominator
        if t.background:
            arrays |= {"background_filters": t.background.filters, "background_unmasked": t.background.unmasked}
    if c := target.color:
        arrays |= {"histograms": c.histograms, "histogram_gain": c.gain}
    if s := target.sizes:
        arrays |= {"scale_mean": s.mean, "scale_energy": s.energy}
    return arrays


def _previous_arrays(target: Target) -> dict[str, npt.NDArray[Any]]:
    """What the version before held: the scale filter as :meth:`ScaleModel.adopt` takes it."""
    arrays = _arrays(target)
    if target.sizes:
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


def _boolean(value: Any) -> bool:
    if not isinstance(value, bool):
        raise ValueError(f"{value!r} is not a boolean")
    return value
