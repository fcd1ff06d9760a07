"""Tells when a file that somebody edits during the run has another content, and is complete."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

__all__ = ["FileWatch"]

#: Interval of checks, s.
_LOOK_SECONDS = 0.5


class FileWatch:
    """Looks at a file now and then.

    Parameters
    ----------
    path : Path
        Read just before.
    clock : callable
        Monotonic time, s.
    """

    def __init__(self, path: Path, clock: Callable[[], float] = time.monotonic) -> None:
        self._path = path
        self._clock = clock
        self._looked_at = clock()
        self._seen = self._read_stamp = self._stamp()

    def has_changed(self) -> bool:
        """Check the file if it is time; return whether it is to be read again.

        That is so when two checks see the same, so that no half-written file is taken for a complete one.
        """
        now = self._clock()
        if now - self._looked_at < _LOOK_SECONDS:
            return False
        self._looked_at = now
        before, self._seen = self._seen, self._stamp()
        if self._seen == self._read_stamp or self._seen != before:
            return False
        self._read_stamp = self._seen
        return True

    def _stamp(self) -> tuple[int, ...] | None:
        try:
            status = self._path.stat()
        except OSError:
            return None
        return status.st_mtime_ns, status.st_size, status.st_ino
