"""Loaded once in the fork server: the tracker, its kernels compiled and warm, and the decoders.

Every lane is a fork of this state and starts in milliseconds. Importing this module does the work; only
the fork server and the tests of lanes import it.
"""

# ruff: noqa: E402
from __future__ import annotations

import gc
import os
import signal

# Before the libraries load: a second thread doubles the CPU time of a frame and gains nothing, and no
# decoder may open what the header check would refuse (its limit can be set no higher than this).
for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ[variable] = "1"
os.environ["OPENCV_IO_MAX_IMAGE_PIXELS"] = str(1 << 26)

import cv2
import numpy as np

from mfcmt_core import MFCMT, MFCMTConfig

from ..frames import FrameLimits
from ..frames.decode import decode
from . import store as store
from .orphans import die_with_parent

# The front ends its lanes itself, after it has drained; a signal to the whole group must not come first.
signal.signal(signal.SIGTERM, signal.SIG_IGN)
signal.signal(signal.SIGINT, signal.SIG_IGN)
die_with_parent()
cv2.setNumThreads(1)


def _warm() -> None:
    noise = np.random.default_rng(0).integers(0, 255, (120, 160, 3), dtype=np.uint8)
    for config in (MFCMTConfig.default(), MFCMTConfig.paper()):
        for image in (noise, noise[:, :, 0].copy()):
            tracker = MFCMT(config)
            tracker.init(image, (60, 40, 30, 24))
            for _ in range(2):
                tracker.update(image)
            MFCMT.from_bytes(tracker.to_bytes())
    for suffix in (".jpg", ".png", ".webp"):
        decode(cv2.imencode(suffix, noise)[1].tobytes(), FrameLimits())


_warm()
# What is here now never dies: keep the collector from touching (and so copying) its pages in every lane.
gc.collect()
gc.freeze()
