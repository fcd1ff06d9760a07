"""Tells when a file that somebody edits during the run has another content, and is complete."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

__all__ = ["FileWatch", "Stamp", "stamp_of"]

#: Interval of checks, s.
_LOOK_SECONDS = 0.5


#: What a file has no more when it is written anew; empty if it is not there.
Stamp = tuple[int, ...]


def stamp_of(path: Path) -> Stamp:
    """Return what tells a file as it is now from what is written later; to be taken before it is read."""
    try:
        status = path.stat()
    except OSError:
        return ()
    return status.st_mtime_ns, status.st_size, status.st_ino


class FileWatch:
    """Looks at a file now and then.

    Parameters
    ----------
    path : Path
    read : Stamp, optional
        Of what was read of it; by default it is as it was read.
    clock : callable
        Monotonic time, s.
    """

    def __init__(
        self, path: Path, read: Stamp | None = None, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._path = path
        self._clock = clock
        self._looked_at = clock()
        self._seen = self._read = stamp_of(path) if read is None else read

    def has_changed(self) -> bool:
        """Check the file if it is time; return whether it is to be read again.

        That is so when two checks see the same, so that no half-written file is taken for a complete one.
        """
        now = self._clock()
        if now - self._looked_at < _LOOK_SECONDS:
            return False
        self._looked_at = now
        before, self._seen = self._seen, stamp_of(self._path)
        if self._seen == self._read or self._seen != before:
            return False
        self._read = self._seen
        return True
