"""A process that reads a video from a stranger and writes its frames to standard output, as JPEG.

    python -m service.bridges.video_frames FILE FROM_S

It gives up its rights before it opens the file. :data:`HEAD` stands before each frame.
"""

from __future__ import annotations

import struct
import sys
from pathlib import Path

from ..lanes.confine import confine, die_with_parent

# Of a frame: its number, its time in seconds, the width and height of its pixels, the bytes of the JPEG that follows.
HEAD = struct.Struct(">QdIII")
# Frames are encoded once more on their way to the tracker: with all colours, and nearly as they are.
QUALITY = 95


def main(path: Path, first_s: float) -> int:
    """Write the frames from ``first_s`` on, and return the exit code: 0 also if the file ends early."""
    import simplejpeg

    from mfcmt_core.video import MissingFrames, VideoError, VideoReader
    from mfcmt_core.video.library import library

    die_with_parent()
    out, origin_s = sys.stdout.buffer, None
    try:
        library()
        confine(readable=[path.parent])
        with VideoReader(path) as video:
            half = 0.5 / video.fps
            for frame in video:
                time_s = frame.index / video.fps if frame.time_s is None else frame.time_s
                origin_s = time_s if origin_s is None else origin_s
                if time_s - origin_s < first_s - half:
                    continue
                height, width = frame.image.shape[:2]
                jpeg = simplejpeg.encode_jpeg(frame.image, QUALITY, "BGR", "444")
                out.write(HEAD.pack(frame.index, time_s - origin_s, width, height, len(jpeg)))
                out.write(jpeg)
                out.flush()
    except MissingFrames:
        pass  # those before were written
    except VideoError as bad:
        sys.stderr.write(str(bad).replace(str(path), "the video"))
        return 1
    except BrokenPipeError:
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), float(sys.argv[2])))
