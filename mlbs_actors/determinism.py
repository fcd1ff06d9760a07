"""One thread for every numerical library, so that equal input gives equal bytes.

A library that splits a sum over its threads gives other last bits with another number of threads (a matrix
product by OpenBLAS does), and a threshold downstream makes them visible. So all of this package computes in
one thread, in the caller's process (:func:`single_threaded`) and in each actor's (:func:`limit_process`);
parallelism is between processes. Numba needs no limit: no kernel here uses its threads, and changing their
number after its import makes its next compilation fail.
"""

from __future__ import annotations

import functools
import os
from collections.abc import Iterator
from contextlib import contextmanager

import cv2
from threadpoolctl import ThreadpoolController  # type: ignore[import-untyped]

__all__ = ["limit_process", "single_threaded"]

#: Read by numerical libraries when they are loaded; set for those that are loaded later.
_THREAD_VARIABLES = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "BLIS_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
)


@functools.cache
def _thread_pools() -> ThreadpoolController:
    """Return the BLAS and OpenMP libraries of this process; finding them takes 5 ms, so it is done once."""
    import scipy.linalg  # noqa: F401  (brings a BLAS along, which must be there before the search)

    return ThreadpoolController()


@contextmanager
def single_threaded() -> Iterator[None]:
    """Compute in one BLAS, OpenMP and OpenCV thread until the end of the ``with`` block.

    The numbers of threads found on entry are restored on exit, also after an exception. Blocks may be
    nested. Entering takes about 0.05 ms. The numbers belong to the process (that of OpenMP to the
    calling thread): do not use it in two threads at once.
    """
    opencv_threads = cv2.getNumThreads()
    with _thread_pools().limit(limits=1):
        cv2.setNumThreads(1)
        try:
            yield
        finally:
            cv2.setNumThreads(opencv_threads)


def limit_process() -> None:
    """Compute in one thread in this process from now on, for a process that does nothing else.

    Call it first in an actor, in the thread that will compute. Libraries that are loaded later follow the
    environment variables it sets; none is loaded for this purpose, since a process that only reads or writes
    files does not need them.
    """
    for variable in _THREAD_VARIABLES:
        os.environ[variable] = "1"
    ThreadpoolController().limit(limits=1)
    cv2.setNumThreads(1)
