"""Low priority for processes that are prepared in advance, so that they do not delay frames.

Importing and loading everything that a layer needs takes a second of CPU time. On a machine without a free
core, frames would wait for it: dozens of times each, because every process on a frame's way would find the
core busy for a few milliseconds. A process that somebody waits for keeps its priority: on a busy machine it
could take a minute.

Any thread may set its policy to ``SCHED_IDLE``, but revert it only as root or within ``RLIMIT_NICE``; where
it may not, its priority is kept.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Thread

__all__ = ["stepping_back"]


@contextmanager
def stepping_back() -> Iterator[None]:
    """Run the calling thread only when no other wants to run, until the end of the ``with`` block.

    Its priority is kept if it could not be reverted.
    """
    if not _may_come_back():
        yield
        return
    before = os.sched_getscheduler(0)
    _schedule(os.SCHED_IDLE)
    try:
        yield
    finally:
        _schedule(before)


def _schedule(policy: int) -> None:
    os.sched_setscheduler(0, policy, os.sched_param(0))


def _may_come_back() -> bool:
    """Try it in a thread that ends at once: on Linux threads have policies of their own."""
    came_back = []

    def there_and_back() -> None:
        try:
            before = os.sched_getscheduler(0)
            _schedule(os.SCHED_IDLE)
            _schedule(before)
        except OSError:
            return
        came_back.append(True)

    thread = Thread(target=there_and_back)
    thread.start()
    thread.join()
    return bool(came_back)
