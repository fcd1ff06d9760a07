"""How loops over pixels, points and nodes are compiled."""

from __future__ import annotations

from functools import partial

from numba import njit

__all__ = ["compiled"]

#: Decorator of a function that Numba compiles when it is first called, and keeps beside the module. As in
#: NumPy a division by zero gives infinity or NaN: with the check that Python makes, no loop that divides
#: runs in vector registers. An index with a sign is asked each time whether it counts from the end, so that
#: the innermost loops over the edges of a graph make theirs np.uint32.
compiled = partial(njit, cache=True, error_model="numpy")
