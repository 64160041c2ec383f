"""What the evaluation raises."""

from __future__ import annotations

from ..errors import MFCMTError


class DataError(MFCMTError, ValueError):
    """A data set or a result file cannot be used; the message names the file and the line."""


class NoData(DataError):
    """A folder holds no sequence at all."""
