"""The search for a target in one frame: lines 2–7 of Algorithm 1, and other places if the target may not be there."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from .confidence import MapEvidence
from .config import MFCMTConfig
from .fusion import fuse
from .geometry import Frame, Rect
from .kernels.fusion import second_peak_ratio
from .redetection import propose_by_color, second_peak
from .reliability import Peaks
from .target import Crop, Observation, Point, Target

LEAVE_OUT = 4
"""Cells on each side of a fused map's peak in which no second one is looked for, see :class:`MapEvidence`."""
MIN_CONFIDENCE = 0.6
"""Lowest confidence at which a place that the search of the whole frame proposed is taken.

It is the best of many places in many frames, so it must be more than just likely."""
MIN_ADVANTAGE = 0.2
"""How much higher that must be than the confidence at the last place."""


@dataclass(frozen=True, slots=True)
class Detection:
    """Where a fused map peaks: ``center`` (x, y) in the frame, the peaks of the maps, and what else the maps say."""

    center: Point
    peaks: Peaks
    evidence: MapEvidence


@dataclass(frozen=True, slots=True)
class Candidate:
    """A probed place: the window observed there and what was detected in it.

    ``recentered`` is the window around the detection, if that was observed too. ``jump_scale`` is the target's scale
    there if the search of the whole frame found it, and None if the box goes on from the last one.
    """

    observation: Observation
    detection: Detection
    recentered: Observation | None = None
    jump_scale: float | None = None

    @property
    def peaks(self) -> Peaks:
        """The peaks of the detection."""
        return self.detection.peaks

    @property
    def strength(self) -> tuple[float, float]:
        """The key by which candidates are compared; see :attr:`Peaks.strength`."""
        return self.peaks.strength


class Search:
    """The search for ``target`` in one frame. Pixels outside ``readable`` are not read."""

    def __init__(self, config: MFCMTConfig, target: Target, frame: Frame, readable: Rect) -> None:
        self.config, self.target, self.frame, self.readable = config, target, frame, readable

    def run(self) -> Candidate:
        """Return the candidate that gives this frame's result (lines 2–7 of Algorithm 1).

        The last place is probed first. Further places are probed only if the confidence has been low, in the whole
        frame, or if the template peak is low: the middle of the found peak, then one other place.
        :attr:`Target.runner_up` and ``reliability.template_low`` carry over to the next frame.
        """
        target, reliability = self.target, self.target.reliability
        runner_up, target.runner_up = target.runner_up, None
        here = self.probe(target.center)
        if reliability.searching:
            return self._redetect(here)
        was_low, reliability.template_low = reliability.template_low, False
        if not reliability.is_template_low(here.peaks):
            return here
        other_place = self._other_place(here.observation, was_low, runner_up)
        centered = here
        if not here.observation.is_central(here.detection.center):  # a peak is lower off the middle of the window
            centered = self.probe(here.detection.center, here.observation.crop)
            here = replace(here, recentered=centered.observation)
            if not reliability.is_template_low(centered.peaks):
                return here
        reliability.template_low = True
        if other_place is None or not self.frame.contains(other_place):
            return here
        other = self.probe(other_place)
        if other.peaks.template > self.config.doubt_margin * centered.peaks.template:
            return other
        if other.strength > centered.strength:  # probe it again in the next frame, where its peak is in the middle
            target.runner_up = other.detection.center
        return here

    def _redetect(self, here: Candidate) -> Candidate:
        """Return the best of the places that the whole frame has to offer, or ``here`` if none is better.

        A place is probed twice where its peak is off the middle, so that the second window has its surroundings. Its
        peaks must not be low, and the confidence in it must be clearly higher than in ``here``.
        """
        target, last_scale = self.target, self.target.scale
        best, highest = here, self._merit(here)
        if self.config.tracking_threshold:
            highest = max(MIN_CONFIDENCE, highest + MIN_ADVANTAGE)
        for place, scale in self._proposals():
            target.scale = scale
            found = self.probe(place)
            if not found.observation.is_central(found.detection.center):
                found = self.probe(found.detection.center)
            merit = self._merit(found)
            if merit > highest and not target.reliability.is_peak_low(found.peaks):
                best, highest = replace(found, jump_scale=scale), merit
        target.scale = last_scale
        return best

    def _proposals(self) -> Iterator[tuple[Point, float]]:
        """Yield places (x, y) in the whole frame, and the target's scale there."""
        target, scale = self.target, self.target.scale
        if target.color:
            yield propose_by_color(target.color, self.frame, target.base_size, scale), scale
        if proposal := target.looks.propose(self.frame, target.base_size, scale):
            place, scale = proposal
            yield place, target.scale_model.clamp(scale, self.frame.size) if target.scale_model else scale

    def _merit(self, candidate: Candidate) -> float:
        """Return by what candidates are compared: the confidence, or where that does not decide, the peaks."""
        target, detection = self.target, candidate.detection
        if not self.config.tracking_threshold:
            return detection.peaks.template * detection.peaks.statistical
        box = target.box_pixels(candidate.observation.crop, detection.center, self.frame.size)
        return target.confidence.estimate(detection.evidence, box)

    def _other_place(self, observation: Observation, was_low: bool, runner_up: Point | None) -> Point | None:
        """Return the one other place to probe in a frame with a low template peak.

        In the first such frame that is the second peak of the fused map, if there is one. Afterwards it is the
        runner-up of the last frame, or else a neighboring window: one side per frame, to keep each frame short.
        """
        target = self.target
        if not was_low:
            peak = second_peak(target.maps()[1], target.search_window.target)
            return observation.place_at(peak) if peak else None
        if runner_up is not None:
            return runner_up
        side = (target.reliability.learned + target.reliability.unreliable_run) % 4
        return target.search_window.neighbor(target.center, target.scale, side)

    def probe(self, place: Point, crop: Crop | None = None) -> Candidate:
        """Observe the window around ``place`` and detect the target in it."""
        observation = self.target.observe(self.frame, self.readable, place, crop)
        return Candidate(observation, detect(self.config, self.target, self.frame, observation))


def detect(config: MFCMTConfig, target: Target, frame: Frame, observation: Observation) -> Detection:
    """Compute the responses, fuse them and find the peak (lines 5–7 of Algorithm 1)."""
    responses, fused = target.maps()
    models = 0
    if target.template:
        models = len(target.template.blocks)
        target.template.respond(observation.spectra, responses[: len(target.template.names)])
    if target.color:
        target.color.respond(observation.bins, responses[-1])
    peak = fuse(responses, target.map_weights, config, fused)
    template = sum(peak.tops[:models]) / models if models else 1.0
    statistical = peak.tops[-1] if target.color else 1.0
    x, y = observation.place_at(peak.displacement)
    center = (min(max(x, 0.0), float(frame.size[0])), min(max(y, 0.0), float(frame.size[1])))
    evidence = MapEvidence(peak.psr, second_peak_ratio(fused, LEAVE_OUT), statistical)
    return Detection(center, Peaks(peak.height, template, statistical), evidence)


def copy_maps(
    config: MFCMTConfig, target: Target, frame: Frame, observation: Observation
) -> dict[str, npt.NDArray[np.float32]]:
    """Return copies of the probability maps by name, and of a joint filter also the part of each cue.

    The maps are computed again, for the search may have probed another place since.
    """
    detect(config, target, frame, observation)
    responses, fused = target.maps()
    copies = {"fused": fused.copy()}
    copies |= {name: np.array(r) for name, r in zip(target.map_names, responses, strict=True)}
    if target.template and config.joint_filter:
        parts = target.template.respond_by_cue(observation.spectra)
        for name, part in parts.items():
            fuse(part[None], np.ones(1, np.float32), config, np.empty_like(part))
            copies[name] = part
    return copies
