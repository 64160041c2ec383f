"""Loads and warms all that a lane works with: the tracker, its compiled kernels, and the decoders.

The import itself does the work. The fork server imports this, so that every lane, which is a fork of it, starts in
milliseconds; measurements of a lane's work without a process import it, too.
"""

# ruff: noqa: E402
from __future__ import annotations

import os

# Set before the libraries load. A second thread doubles the CPU time of a frame and gains nothing; and no decoder may
# open an image that the header check would refuse (the setting cannot be higher than this).
for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ[variable] = "1"
os.environ["OPENCV_IO_MAX_IMAGE_PIXELS"] = str(1 << 26)

import cv2
import numpy as np

from mfcmt_core import MFCMT, MFCMTConfig
from mfcmt_core.images import FrameLimits
from mfcmt_core.images.decode import decode
from mfcmt_core.images.excerpt import excerpt
from mfcmt_core.images.mend import mend

from . import operations as operations

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
    jpeg = cv2.imencode(".jpg", noise)[1].tobytes()
    mend(jpeg)
    excerpt(jpeg, (60, 40, 30, 24))


_warm()
