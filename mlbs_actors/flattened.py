"""The numbers of an array one after the other, for kernels.

A flat array's places are plain sums, and its loops run in vector registers. Numba's ``reshape(-1)`` gives the
same, but by a function that looks at every axis: in an object's frame, whose arrays are small, a fortieth of
all instructions.
"""

from __future__ import annotations

from typing import Any

from numba import types
from numba.core import imputils
from numba.extending import intrinsic
from numba.np import arrayobj

__all__ = ["flattened"]

# Untyped in Numba.
_in_kernels: Any = intrinsic(prefer_literal=True)
_structure: Any = arrayobj.make_array
_fill: Any = arrayobj.populate_array
_same_memory: Any = imputils.impl_ret_borrowed


@_in_kernels
def flattened(typing: Any, array: Any) -> Any:
    """A contiguous array (of any number of axes, in C order) as one of a single axis; the memory is the same.

    Only kernels can call it, and of an array that is not contiguous it does not compile.
    """
    if not isinstance(array, types.Array) or array.layout != "C":
        return None
    row = array.copy(ndim=1)

    def build(context: Any, builder: Any, called: Any, values: Any) -> Any:
        given = _structure(array)(context, builder, values[0])
        made = _structure(row)(context, builder)
        _fill(
            made,
            data=given.data,
            shape=[given.nitems],
            strides=[given.itemsize],
            itemsize=given.itemsize,
            meminfo=given.meminfo,
            parent=given.parent,
        )
        return _same_memory(context, builder, row, made._getvalue())

    return row(array), build
