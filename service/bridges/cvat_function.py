"""MFCMT as a tracking function of CVAT's agents, in the agent's own process; no service is needed.

    cvat-cli function create-native MFCMT --function-module service.bridges.cvat_function
    cvat-cli function run-agent ID --function-module service.bridges.cvat_function

Parameters of :func:`create` go behind it, as ``-p preset=str:paper``.
"""

from __future__ import annotations

import itertools
import time
from typing import Any

import cvat_sdk.auto_annotation as cvataa

from mfcmt_core import MFCMT, MFCMTConfig
from mfcmt_core.adapters import bgr
from mfcmt_core.geometry import Image

from ..sessions.ttl_cache import TTLCache

# As long as the agent and CVAT remember a state.
KEEP_S = 8 * 3600.0
AGENT = "agent"


class StateDropped(Exception):
    """The state of a track was dropped, because it was not used for long or others needed its place."""


class TrackingFunction:
    """What CVAT's agent calls. It keeps a tracker for each state, of those used last ``max_states`` (1 to 2 MB each).

    The agent binds a state to its task and to the size of its images. A track that scores below ``min_confidence`` is
    not found in that image, as one that is lost.
    """

    def __init__(self, config: MFCMTConfig, max_states: int, min_confidence: float) -> None:
        self.spec = cvataa.TrackingFunctionSpec(supported_shape_types=["rectangle"])
        self._config, self._min_confidence = config, min_confidence
        self._trackers: TTLCache[MFCMT] = TTLCache(max_states, KEEP_S, time.monotonic)
        self._names = map(str, itertools.count())

    def preprocess_image(self, context: Any, image: Any) -> Image:  # noqa: ARG002 - CVAT passes it
        """Return the pixels of a PIL image, BGR or gray ``uint8``."""
        return bgr(image)

    def init_tracking_state(self, context: Any, pp_image: Image, shape: Any) -> str:  # noqa: ARG002
        """Start a tracker on a rectangle, and return the name of its state. Raises BadBox."""
        left, top, right, bottom = shape.points
        tracker = MFCMT(self._config)
        tracker.init(pp_image, (left, top, right - left, bottom - top))
        name = next(self._names)
        self._trackers.put(AGENT, name, tracker)
        return name

    def track(self, context: Any, pp_image: Image, state: str) -> Any:
        """Return the rectangle in the next image, or None while it is not found. Raises StateDropped, BadImage."""
        tracker = self._trackers.pop(state)
        if tracker is None:
            raise StateDropped("the track was not used for long, or too many others were: start it again")
        self._trackers.put(AGENT, state, tracker)  # last in the line of those that make room
        result = tracker.update(pp_image)
        if result.status == "lost" or result.confidence < self._min_confidence:
            return None
        x, y, w, h = result.box
        return cvataa.TrackableShape(type=context.original_shape_type, points=[x, y, x + w, y + h])


def create(preset: str = "default", max_states: int = 256, min_confidence: float = 0.0) -> TrackingFunction:
    """Return the function, as cvat-cli asks for it. ``preset`` is ``default`` or ``paper``. Raises BadConfig."""
    return TrackingFunction(MFCMTConfig.preset(preset), max_states, min_confidence)
