"""An event by which the driver wakes an actor of its own node that waits for its next call.

Ray's main loop checks for signals a hundred times a second, except inside a call: 3 ms of CPU time a second,
plus the cache lines that each check evicts. So an actor that has to wait for its next call waits for this
event inside a call.
"""

from __future__ import annotations

import os
import weakref
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

__all__ = ["WakeupEvent", "WakeupHandle", "wait_until_woken"]


@dataclass(frozen=True, slots=True)
class WakeupHandle:
    """Where another process finds a :class:`WakeupEvent`.

    Attributes
    ----------
    owner : int
        Process id of its owner.
    descriptor : int
        The owner's file descriptor of the pipe to read from.
    inode : int
        Of that pipe: with another one the descriptor has been reused.
    """

    owner: int
    descriptor: int
    inode: int


class WakeupEvent:
    """Wakes one waiting process each time it is set, even one that begins to wait later.

    It is closed with :attr:`close`, when this object is dropped, or with its owner.

    Attributes
    ----------
    handle : WakeupHandle
        For the process that waits.
    close : callable
        Wakes all present and future waiters. May be called twice.
    """

    def __init__(self) -> None:
        reading, writing = os.pipe()
        self._writing = os.fdopen(writing, "wb", 0)
        self.handle = WakeupHandle(os.getpid(), reading, os.fstat(reading).st_ino)
        self.close = weakref.finalize(self, _close, self._writing, os.fdopen(reading, "rb", 0))

    def wake(self) -> None:
        """End one :func:`wait_until_woken`; does nothing once closed."""
        with suppress(ValueError):
            self._writing.write(b"!")


def wait_until_woken(handle: WakeupHandle) -> None:
    """Wait until the event is set, or its owner is gone."""
    end = Path(f"/proc/{handle.owner}/fd/{handle.descriptor}")
    with suppress(OSError), end.open("rb", buffering=0) as pipe:
        if os.fstat(pipe.fileno()).st_ino == handle.inode:
            pipe.read(1)


def _close(*ends: BinaryIO) -> None:
    for end in ends:
        end.close()
