"""A bell that the driver rings for an actor of its own node that waits for its next call.

Ray's main loop looks a hundred times a second for signals, except inside a call: 3 ms of CPU time a second,
and what each look pushes out of the caches. So an actor that is to be called in a while waits inside a call
for the bell.
"""

from __future__ import annotations

import os
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

__all__ = ["Bell", "BellRope", "await_bell"]


@dataclass(frozen=True, slots=True)
class BellRope:
    """Where a bell is heard.

    Attributes
    ----------
    owner : int
        Process id of who rings it.
    descriptor : int
        The owner's file descriptor of what is to be read from.
    inode : int
        Of that: with another one it is no longer this bell.
    """

    owner: int
    descriptor: int
    inode: int


class Bell:
    """What is rung; heard in another process, once for each time, also by who listens later.

    Attributes
    ----------
    rope : BellRope
        To be told to who listens.
    """

    def __init__(self) -> None:
        heard, rung = os.pipe()
        self._heard, self._rung = os.fdopen(heard, "rb", 0), os.fdopen(rung, "wb", 0)
        self.rope = BellRope(os.getpid(), heard, os.fstat(heard).st_ino)

    def ring(self) -> None:
        """End one :func:`await_bell`; nothing once it is closed."""
        with suppress(ValueError):
            self._rung.write(b"!")

    def close(self) -> None:
        """Ring for all who still listen, and for good."""
        self._rung.close()
        self._heard.close()


def await_bell(rope: BellRope) -> None:
    """Wait until the bell is rung, or is gone with its owner."""
    end = Path(f"/proc/{rope.owner}/fd/{rope.descriptor}")
    with suppress(OSError), end.open("rb", buffering=0) as heard:
        if os.fstat(heard.fileno()).st_ino == rope.inode:
            heard.read(1)
