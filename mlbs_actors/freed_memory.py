"""Memory that is freed stays with the process.

The C library gives large blocks back to the system as soon as they are freed. Every frame's temporaries are
then fetched anew, page by page, at 2 µs each: up to 1,400 pages a frame.
"""

from __future__ import annotations

import ctypes
import functools

__all__ = ["keep_freed_memory"]

#: Of glibc's ``mallopt``: from how much free memory on it is given back, and from which size on a block is
#: fetched from the system by itself (at most 32 MB), bytes.
_TRIM_THRESHOLD, _MMAP_THRESHOLD = (-1, 256 * 2**20), (-3, 32 * 2**20)


@functools.cache
def keep_freed_memory() -> None:
    """Keep what this process frees, up to 256 MB; where the C library is another one, nothing happens."""
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        for parameter, value in (_TRIM_THRESHOLD, _MMAP_THRESHOLD):
            mallopt(parameter, value)
