"""How loops over pixels, points and nodes are compiled."""

from __future__ import annotations

import functools
import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from numba import njit

__all__ = ["compiled"]


Function = TypeVar("Function", bound=Callable[..., Any])


def compiled(**options: Any) -> Callable[[Function], Function]:
    """Decorator of a function that Numba compiles when it is first called, and keeps beside the module.

    As in NumPy a division by zero gives infinity or NaN: with the check that Python makes, no loop that
    divides runs in vector registers.
    """

    def compile_and_keep(function: Function) -> Function:
        kernel: Any = njit(function, cache=True, error_model="numpy", **options)
        # Numba compiles anew what lies in a changed file, but not what calls it from another one, into which
        # it has been built. So what is kept counts only as long as no module has changed.
        kernel._cache._cache_file._source_stamp = _stamp(Path(function.__code__.co_filename).parent)
        kept: Function = kernel
        return kept

    return compile_and_keep


@functools.cache
def _stamp(folder: Path) -> str:
    """Names, times of the last change and sizes of all modules beside this one and of a folder, digested."""
    modules = sorted(path for here in {Path(__file__).parent, folder} for path in here.glob("*.py"))
    known = [(path.name, path.stat().st_mtime_ns, path.stat().st_size) for path in modules]
    return hashlib.sha256(repr(known).encode()).hexdigest()
