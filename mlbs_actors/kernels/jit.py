"""Compile loops over pixels, trajectories and nodes with Numba, and keep the machine code."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numba

from mlbs_actors.kernels.machine_code import machine_code_folder

__all__ = ["compiled", "inlined"]

_config: Any = numba.config
Function = TypeVar("Function", bound=Callable[..., Any])


def compiled(function: Function) -> Function:
    """Decorate a function that Numba compiles when it is first called with arguments of new types.

    As in NumPy, a division by zero gives infinity or NaN: Python's check would keep loops that divide from
    being vectorised.
    """
    return _kernel(function)


def inlined(function: Function) -> Function:
    """Decorate a few lines that are inlined into each kernel that calls them, so that its loop stays one."""
    return _kernel(function, forceinline=True)


def _kernel(function: Function, forceinline: bool = False) -> Function:
    # Only while the kernel is defined, so that a caller's own kernels keep their folder.
    before, _config.CACHE_DIR = _config.CACHE_DIR, str(machine_code_folder())
    try:
        kernel: Function = numba.njit(function, cache=True, error_model="numpy", forceinline=forceinline)
    finally:
        _config.CACHE_DIR = before
    return kernel
