"""What the package raises. A call that raises one of these has changed nothing."""

from __future__ import annotations


class MFCMTError(Exception):
    """Base of every exception of this package."""


class BadConfig(MFCMTError, ValueError):
    """A parameter of :class:`~mfcmt_core.MFCMTConfig` is out of its range."""


class BadBox(MFCMTError, ValueError):
    """The box is not four finite numbers, has a side below one pixel, or lies outside the frame.

    ``reason`` says what is wrong and never repeats the box.
    """

    def __init__(self, reason: str, box: object = None) -> None:
        super().__init__(reason if box is None else f"{reason} (it is {box})")
        self.reason = reason


class BadImage(MFCMTError, ValueError):
    """The image is not ``uint8`` of shape ``(H, W)`` or ``(H, W, 3)``, or not of the first one's size."""


class NotInitialised(MFCMTError, RuntimeError):
    """``update`` was called before ``init``."""


class BadSnapshot(MFCMTError, ValueError):
    """The bytes are not a snapshot of a supported version, or its contents do not fit together."""


class RegionTooSmall(MFCMTError, ValueError):
    """The image is a cut of the frame that does not show all that the tracker looks at.

    ``needed`` is the part that it must show: ``(x, y, w, h)`` in whole pixels of the frame.
    """

    def __init__(self, given: tuple[int, int, int, int], needed: tuple[int, int, int, int]) -> None:
        super().__init__(f"the cut {given} does not cover {needed}")
        self.given = given
        self.needed = needed
