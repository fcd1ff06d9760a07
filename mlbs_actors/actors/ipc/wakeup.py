"""An event by which the driver wakes an actor of its own node that waits for its next call.

Ray's main loop checks for signals a hundred times a second, except inside a call: 3 ms of CPU time a second,
plus the cache lines that each check evicts. So an actor that has to wait for its next call waits for this
event inside a call.
"""

from __future__ import annotations

import os
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

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

    Attributes
    ----------
    handle : WakeupHandle
        For the process that waits.
    """

    def __init__(self) -> None:
        reading, writing = os.pipe()
        self._reading, self._writing = os.fdopen(reading, "rb", 0), os.fdopen(writing, "wb", 0)
        self.handle = WakeupHandle(os.getpid(), reading, os.fstat(reading).st_ino)

    def wake(self) -> None:
        """End one :func:`wait_until_woken`; does nothing once closed."""
        with suppress(ValueError):
            self._writing.write(b"!")

    def close(self) -> None:
        """Wake all present and future waiters."""
        self._writing.close()
        self._reading.close()


def wait_until_woken(handle: WakeupHandle) -> None:
    """Wait until the event is set, or its owner is gone."""
    end = Path(f"/proc/{handle.owner}/fd/{handle.descriptor}")
    with suppress(OSError), end.open("rb", buffering=0) as pipe:
        if os.fstat(pipe.fileno()).st_ino == handle.inode:
            pipe.read(1)
