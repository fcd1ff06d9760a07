"""How loops over pixels, points and nodes are compiled."""

from __future__ import annotations

import functools
import hashlib
import importlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import llvmlite.binding as llvm
from numba import njit

__all__ = ["compiled"]


Function = TypeVar("Function", bound=Callable[..., Any])


def compiled(*, in_place: bool = False, **options: Any) -> Callable[[Function], Function]:
    """Decorator of a function that Numba compiles when it is first called, and keeps beside the module.

    As in NumPy a division by zero gives infinity or NaN: with the check that Python makes, no loop that
    divides runs in vector registers.

    Parameters
    ----------
    in_place : bool
        The function makes no array and returns none: it works in those that it is given. Then it does not
        count who refers to them. Numba counts for each argument and each slice, with an atomic instruction
        that takes as long as twenty additions: too long for what is done row by row, or point by point.
    options
        Of :func:`numba.njit`.
    """
    if in_place:
        options["_nrt"] = False  # Numba's name for its runtime, which makes arrays and counts references

    def compile_and_keep(function: Function) -> Function:
        kernel: Any = njit(function, cache=True, error_model="numpy", **options)
        # Numba compiles anew what lies in a changed file, but not what calls it from another one, into which
        # it has been built. So what is kept counts only as long as no module has changed.
        kernel._cache._cache_file._source_stamp = _stamp(Path(function.__code__.co_filename).parent)
        kernel._cache.load_overload = _before_kernels(_packing(kernel._cache.load_overload))
        kept: Function = kernel
        return kept

    return compile_and_keep


def _before_kernels(load: Callable[..., Any]) -> Callable[..., Any]:
    """``load``, of a kernel's cache, which is asked before any kernel is there: what they make arrays with
    comes first. It takes a quarter of a second, which who has no kernel need not wait."""

    def loaded(*given: Any) -> Any:
        importlib.import_module("mlbs_actors.array_memory")
        return load(*given)

    return loaded


class _Packed:
    """Takes the place of an LLVM module that is only to be linked into others."""

    def __init__(self, module: llvm.ModuleRef) -> None:
        self._bitcode = module.as_bitcode()

    def clone(self) -> llvm.ModuleRef:
        """What is linked in."""
        return llvm.parse_bitcode(self._bitcode)


def _packing(load: Callable[..., Any]) -> Callable[..., Any]:
    """``load``, of a kernel's cache, but what it loads is packed where it is not to be run.

    With a kernel's machine code comes what it was made of, for kernels that call it and are yet to be
    compiled. LLVM unfolds that to ten times its size: 20 to 60 MB of a process. Packed at once, it leaves its
    memory to the next kernel that is loaded; packed when all are loaded, it would leave holes all over, and
    frames whose arrays lie in these take an eighth longer.
    """

    def loaded(*given: Any) -> Any:
        overload = load(*given)
        module = None if overload is None else overload.library._shared_module
        if isinstance(module, llvm.ModuleRef):
            overload.library._shared_module = _Packed(module)
        return overload

    return loaded


@functools.cache
def _stamp(folder: Path) -> str:
    """Names, times of the last change and sizes of all modules beside this one and of a folder, digested."""
    modules = sorted(path for here in {Path(__file__).parent, folder} for path in here.glob("*.py"))
    known = [(path.name, path.stat().st_mtime_ns, path.stat().st_size) for path in modules]
    return hashlib.sha256(repr(known).encode()).hexdigest()
