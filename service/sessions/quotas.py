"""How many sessions and streams one key may have."""

from __future__ import annotations

from collections.abc import Callable

from ..settings import Settings


class KeyQuotas:
    """What is set, or a share of the whole: all of it for a single owner, half where there are more.

    So one key never takes every place from the others, and a service with one key, or none, is used to the full.
    ``owners`` tells how many owners there are now.
    """

    def __init__(self, settings: Settings, owners: Callable[[], int]) -> None:
        self._settings, self._owners = settings, owners

    @property
    def sessions(self) -> int:
        """Sessions of one key."""
        return self._settings.max_sessions_per_key or self._share(self._settings.capacity)

    @property
    def streams(self) -> int:
        """Attached streams of one key."""
        return self._settings.max_streams_per_key or self._share(self._settings.max_streams)

    def _share(self, whole: int) -> int:
        return whole if self._owners() < 2 else max(1, whole // 2)
