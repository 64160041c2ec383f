"""Sessions on disk, in one SQLite file that one process uses."""

from __future__ import annotations

import sqlite3
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from ..observability.metrics import Metrics
from .database import BackgroundWriter, Change, SavedSession
from .state_file import StateFile

FLUSH_S = 10.0


class SqliteStore(BackgroundWriter):
    """The database of a service that is one process. The lock of its file keeps other processes out.

    So epochs are counted in memory: a claim is late only against a later one of the same process.
    """

    faults = (sqlite3.Error,)

    def __init__(self, folder: Path, metrics: Metrics) -> None:
        super().__init__(metrics)
        self._file = StateFile(folder)
        self._epochs: dict[str, int] = {}
        self._found: list[SavedSession] = []
        self._damaged: list[tuple[str, str]] = []

    def open(self) -> None:
        """Open the file and read its sessions, unless it is open. Raises StateDirError."""
        if self._file.db is not None:
            return
        self._file.open()
        try:
            self._found, self._damaged = self._file.read()
        except sqlite3.Error as broken:
            self._file.close()
            raise self._file.unusable(broken) from broken
        self._stored = {saved.id for saved in self._found}

    def take_over(self) -> None:
        """Take over the sessions: from now on, one is whole only if :meth:`save` says so. Raises StateDirError."""
        self.open()
        try:
            self._file.take_over(self._damaged)
        except sqlite3.Error as broken:
            raise self._file.unusable(broken) from broken
        self._thread.start()

    def load(self) -> tuple[list[SavedSession], list[tuple[str, str]]]:
        """Return, once, the sessions in the order of their making, and the ids and owners of damaged ones."""
        found, self._found = self._found, []
        damaged, self._damaged = self._damaged, []
        return found, damaged

    def claim(self, sid: str) -> SavedSession | None:
        """Claim a session and return its newest state with the epoch of the claim; None if there is none."""
        self.flush(FLUSH_S)
        found = next((saved for saved in self._file.read()[0] if saved.id == sid), None)
        if found is None:
            return None
        self._epochs[sid] = self._epochs.get(sid, 0) + 1
        return replace(found, epoch=self._epochs[sid])

    def _write(self, batch: Mapping[str, Change]) -> list[str]:
        late = [sid for sid, change in batch.items() if self._is_late(sid, change)]
        changes = {sid: change for sid, change in batch.items() if sid not in late}
        self._file.write({sid: c if isinstance(c, SavedSession) else None for sid, c in changes.items()})
        return late

    def _is_late(self, sid: str, change: Change) -> bool:
        return change is not None and change.epoch < self._epochs.get(sid, 0)

    def _where(self) -> str:
        return str(self._file.folder)

    def _finish(self) -> None:
        self._file.empty_log()

    def _release(self) -> None:
        self._file.close()
