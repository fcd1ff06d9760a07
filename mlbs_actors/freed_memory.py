"""Lets a process keep the memory that it frees, for processes that do nothing but work on frames.

The arrays of a frame are megabytes, of one with many objects tens of megabytes, made and freed again for each
frame. The C library gives such memory back to the system, which hands it out page by page, each cleared
first: 500 page faults a frame in a coordinator, with 32 objects 5,000 in a segmenter, a twelfth of its time.
Results do not depend on it.
"""

from __future__ import annotations

import ctypes

__all__ = ["keep_freed_memory"]

#: Names of the GNU C library's settings, and their values in bytes: what is freed at the heap's end and kept,
#: and the size from which on an array has a mapping of its own, at its upper limit.
_TRIM_THRESHOLD, _KEPT = -1, 2**28
_MMAP_THRESHOLD, _MAPPED = -3, 2**25


def keep_freed_memory() -> None:
    """Set it for the whole process; without effect where the C library has no such setting."""
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(_TRIM_THRESHOLD, _KEPT)
        mallopt(_MMAP_THRESHOLD, _MAPPED)
