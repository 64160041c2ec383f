"""Pixels for the tests of the tracker: rendered ones always, real ones where they are."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from mfcmt_core import MFCMT, synthetic


@pytest.fixture(scope="session")
def clip() -> synthetic.Clip:
    """Return a plain clip of 320×240: a textured plate of 56×44 that moves over a texture."""
    return synthetic.clip("motion")


@pytest.fixture(scope="session")
def box(clip) -> str:
    """Return the target's box in the first frame of :func:`clip`, as the command line takes it."""
    return ",".join(map(str, clip.boxes[0]))


@pytest.fixture(scope="session")
def frames(clip) -> list[np.ndarray]:
    """Return the first 40 frames of :func:`clip`."""
    return clip.frames[:40]


@pytest.fixture(scope="session")
def data(frames, clip) -> bytes:
    """Return a snapshot from the middle of :func:`clip`."""
    tracker = MFCMT()
    for _ in tracker.track(frames[:13], clip.boxes[0]):
        pass
    return tracker.to_bytes()


@pytest.fixture(scope="session", params=["rendered", "noise", "flat", "real"])
def picture(request) -> np.ndarray:
    """Return a BGR picture of at least 240×180."""
    if request.param == "real":
        return cv2.imread(str(request.getfixturevalue("otb_root") / "MountainBike" / "img" / "0001.jpg"))
    if request.param == "noise":
        return np.random.default_rng(5).integers(0, 256, (240, 320, 3), np.uint8)
    if request.param == "flat":
        return np.full((240, 320, 3), (90, 140, 30), np.uint8)
    return synthetic.clip("sample").frames[0]


@pytest.fixture(scope="session")
def gray(picture) -> np.ndarray:
    """Return :func:`picture` in gray."""
    return cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
