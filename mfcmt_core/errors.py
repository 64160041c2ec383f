"""The exceptions of the package. A call that raises one of them has changed nothing."""

from __future__ import annotations


class MFCMTError(Exception):
    """The base class of all exceptions of this package."""


class BadConfig(MFCMTError, ValueError):
    """A parameter of :class:`~mfcmt_core.MFCMTConfig` is outside its range."""


class BadBox(MFCMTError, ValueError):
    """The box is not four finite numbers, has a side below one pixel, or lies mostly outside the frame.

    ``reason`` says what is wrong without repeating the box.
    """

    def __init__(self, reason: str, box: object = None) -> None:
        super().__init__(reason if box is None else f"{reason} (it is {box})")
        self.reason = reason


class BadImage(MFCMTError, ValueError):
    """The image is not ``uint8`` of shape ``(H, W)`` or ``(H, W, 3)``, or its frame has another size than the first."""


class NotInitialised(MFCMTError, RuntimeError):
    """``update`` was called before ``init``."""


class BadSnapshot(MFCMTError, ValueError):
    """The bytes are not a snapshot of a supported version, or what it holds does not fit together."""


class RegionTooSmall(MFCMTError, ValueError):
    """The image is a region of the frame that does not cover all that the tracker reads.

    ``given`` is the region and ``needed`` what it must cover, both ``(x, y, w, h)`` in whole pixels of the frame.
    """

    def __init__(self, given: tuple[int, int, int, int], needed: tuple[int, int, int, int]) -> None:
        super().__init__(f"the cut {given} does not cover {needed}")
        self.given = given
        self.needed = needed


class DataError(MFCMTError, ValueError):
    """A data set or a result file of an evaluation cannot be used; the message names the file and the line."""


class NoData(DataError):
    """A folder holds no sequence at all."""
