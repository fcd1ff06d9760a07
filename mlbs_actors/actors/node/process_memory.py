"""Memory of a process that does nothing but work on frames. Results do not depend on it.

*Freed memory.* The arrays of a frame are megabytes, of one with many objects tens of them, made and freed
again for each frame. The C library gives such memory back to the system, which hands it out page by page,
each cleared first: 500 page faults a frame in a coordinator, with 32 objects 5,000 in a segmenter, a twelfth
of its time.

*Garbage.* Python looks for cycles of objects that nobody needs any more, again and again, among all that a
process has loaded: 200,000 objects of Ray, Numba and others, that live as long as it. That took 20 ms every
25 frames in each process of a stream, a tenth of all its time.
"""

from __future__ import annotations

import ctypes
import gc

__all__ = ["settle_memory"]

#: Names of the GNU C library's settings, and their values in bytes: what is freed at the heap's end and kept,
#: and the size from which on an array has a mapping of its own, at its upper limit.
_TRIM_THRESHOLD, _KEPT = -1, 2**28
_MMAP_THRESHOLD, _MAPPED = -3, 2**25


def settle_memory() -> None:
    """Keep what this process frees, and pass over what it has loaded by now when it looks for garbage.

    To be called when all is loaded: what has been freed by then is given back. For all but the garbage it
    takes the GNU C library; elsewhere that is without effect.
    """
    library = ctypes.CDLL(None)
    mallopt = getattr(library, "mallopt", None)
    if mallopt is not None:
        library.malloc_trim(0)
        mallopt(_TRIM_THRESHOLD, _KEPT)
        mallopt(_MMAP_THRESHOLD, _MAPPED)
    gc.freeze()
