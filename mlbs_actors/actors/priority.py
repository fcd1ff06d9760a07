"""Processes that are being made ready give way to those that work on frames.

To import and load all that a layer needs takes half a second of CPU time. On a machine that has no core to
spare, frames would wait for it, and most of all at a birth, when the pool replaces the process that it lent.

A process may always lower its priority, but raise it again only as root or within ``RLIMIT_NICE``; where it
may not, it does not step back.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Thread

__all__ = ["stepping_back"]

#: By how much the priority is lowered. A process that works gets three times the share of one that gives way,
#: which still comes to its end on a machine that is always busy.
_NICE = 5


@contextmanager
def stepping_back() -> Iterator[None]:
    """Run the calling thread at a lower priority until the end of the ``with`` block, if it may come back."""
    if not _may_come_back():
        yield
        return
    before = os.getpriority(os.PRIO_PROCESS, 0)
    os.setpriority(os.PRIO_PROCESS, 0, before + _NICE)
    try:
        yield
    finally:
        os.setpriority(os.PRIO_PROCESS, 0, before)


def _may_come_back() -> bool:
    """Try it in a thread that ends at once: on Linux priorities belong to threads."""
    came_back = []

    def there_and_back() -> None:
        before = os.getpriority(os.PRIO_PROCESS, 0)
        os.setpriority(os.PRIO_PROCESS, 0, before + 1)
        try:
            os.setpriority(os.PRIO_PROCESS, 0, before)
        except PermissionError:
            return
        came_back.append(True)

    thread = Thread(target=there_and_back)
    thread.start()
    thread.join()
    return bool(came_back)
