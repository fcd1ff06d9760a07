"""Slots as kernels read and write them: :mod:`mlbs_actors.actors.shared_memory` by addresses.

A kernel is told where the slots are that its process has mapped
(:meth:`~mlbs_actors.actors.shared_memory.SharedMemory.places`), and finds the arrays in them by their places.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import types
from numba.extending import intrinsic
from numba.np.arrayobj import populate_array

from mlbs_actors.actors.shared_memory import ALIGNMENT, HEADER, PLACE
from mlbs_actors.compilation import compiled
from mlbs_actors.messages import Array

__all__ = [
    "WORD",
    "after_places",
    "array_bytes",
    "array_shape",
    "copy",
    "find_slot",
    "padded",
    "put_array",
    "sign",
    "signature",
]

#: Bytes of a number.
WORD = 8
_HEADER, _PLACE = HEADER.size, PLACE.size

# Untyped in Numba.
_in_kernels: Any = intrinsic(prefer_literal=True)
_populate: Any = populate_array


@_in_kernels
def _memory_at(typing: Any, address: Any, size: Any, writable: Any) -> Any:
    """So many bytes from an address on, which somebody else holds."""
    array = types.Array(types.uint8, 1, "C", readonly=not writable.literal_value)

    def build(context: Any, builder: Any, called: Any, values: Any) -> Any:
        made = context.make_array(array)(context, builder)
        one = context.get_constant(types.intp, 1)
        data = builder.inttoptr(values[0], made.data.type)
        _populate(made, data=data, shape=[values[1]], strides=[one], itemsize=one, meminfo=None)
        return made._getvalue()

    return array(types.int64, types.int64, writable), build


@compiled()
def copy(source: Array, begin: int, count: int, target: Array, at: int) -> None:
    """As slices do, whose code is twenty times as large; to the left also within an array."""
    for one in range(count):
        target[at + one] = source[begin + one]


@compiled()
def find_slot(slots: Array, owner: int, descriptor: int, size: int) -> int:
    """Address of a slot of at least so many bytes; 0 if no such one is known."""
    for one in range(slots.shape[0]):
        if slots[one, 0] == owner and slots[one, 1] == descriptor and slots[one, 3] >= size:
            return int(slots[one, 2])
    return 0


@compiled()
def signature(slot: int) -> tuple[int, int]:
    """The turn in which a slot was written, and how many arrays it holds."""
    head = _memory_at(slot, _HEADER, False).view(np.int64)
    return head[0], head[1]


@compiled()
def sign(slot: int, turn: int, arrays: int) -> None:
    """Write these."""
    head = _memory_at(slot, _HEADER, True).view(np.int64)
    head[0], head[1] = turn, arrays


@compiled()
def _place(slot: int, number: int) -> Array:
    """Where an array of a slot is, the character of its type, its dimensions, its shape."""
    place: Array = _memory_at(slot + _HEADER + _PLACE * number, _PLACE, True).view(np.int64)
    return place


@compiled()
def array_bytes(slot: int, number: int, item: int) -> Array:
    """The bytes of an array of a slot, whose items have so many; to read."""
    place = _place(slot, number)
    for one in range(place[2]):
        item *= place[3 + one]
    content: Array = _memory_at(slot + place[0], item, False)
    return content


@compiled()
def array_shape(slot: int, number: int) -> tuple[int, int]:
    """The first two dimensions of an array of a slot."""
    place = _place(slot, number)
    return place[3], place[4]


@compiled()
def put_array(
    slot: int, number: int, begin: int, content: Array, kind: int, dimensions: int, shape: tuple[int, int]
) -> None:
    """Write an array of at most two dimensions, given by its bytes, and its place, so far into a slot."""
    place = _place(slot, number)
    place[0], place[1], place[2] = begin, kind, dimensions
    place[3], place[4], place[5] = shape[0], shape[1], 0
    copy(content, 0, content.size, _memory_at(slot + begin, content.size, True), 0)


@compiled()
def after_places(arrays: int) -> int:
    """Where the first of so many arrays begins in a slot."""
    return padded(_HEADER + _PLACE * arrays)


@compiled()
def padded(size: int) -> int:
    """So many bytes, up to where the next array begins."""
    return -(-size // ALIGNMENT) * ALIGNMENT
