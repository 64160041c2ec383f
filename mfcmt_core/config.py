"""Every parameter of the tracker (being written)."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class MFCMTConfig:
    """Parameters of the tracker."""

    @classmethod
    def default(cls) -> MFCMTConfig:
        return cls()

    @classmethod
    def paper(cls) -> MFCMTConfig:
        return cls()
