"""Memory settings of processes dedicated to frames. Results do not depend on them.

*Freed memory.* The arrays of a frame are megabytes, with many objects tens of them, allocated and freed
for each frame. The C library returns such memory to the system, which provides it again page by page,
each cleared first: 500 page faults a frame in a coordinator, with 32 objects 5,000 in a segmenter, a twelfth
of its time.

*Garbage.* Python searches repeatedly for unused cycles among all objects of a process: 200,000 objects of
Ray, Numba and others, that live as long as it. That took 20 ms every
25 frames in each process of a stream, a tenth of all its time.
"""

from __future__ import annotations

import ctypes
import gc

__all__ = ["settle_memory"]

#: Parameters of the GNU C library, and their values in bytes: the most free memory to keep at the heap's end,
#: and the size from which on an array has a mapping of its own, at its upper limit.
_TRIM_THRESHOLD, _KEPT = -1, 2**28
_MMAP_THRESHOLD, _MAPPED = -3, 2**25


def settle_memory() -> None:
    """Keep freed memory in this process, and exempt all present objects from garbage collection.

    Call it when everything is loaded: memory freed before is returned. All but the garbage collection
    requires the GNU C library; elsewhere that has no effect.
    """
    library = ctypes.CDLL(None)
    mallopt = getattr(library, "mallopt", None)
    if mallopt is not None:
        library.malloc_trim(0)
        mallopt(_TRIM_THRESHOLD, _KEPT)
        mallopt(_MMAP_THRESHOLD, _MAPPED)
    gc.freeze()
