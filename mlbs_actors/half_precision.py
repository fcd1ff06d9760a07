"""Numbers in half precision made single: NumPy does it without the processor's help, twenty times slower."""

from __future__ import annotations

import numpy as np

from mlbs_actors.compilation import compiled
from mlbs_actors.flattened import flattened
from mlbs_actors.messages import Array

__all__ = ["single_precision"]

#: What the exponents' different offsets make of a half whose bits are moved to those of a single.
_SCALE = np.float32(2.0**112)


@compiled()
def single_precision(bits: Array, top: int, bottom: int, left: int, right: int) -> Array:
    """Part of an array (h, w, c) of finite numbers in half precision, told by their bits as uint16, as
    float32: rows from top to bottom, columns from left to right."""
    channels = bits.shape[2]
    length = (right - left) * channels
    moved, flat = np.empty((bottom - top) * length, np.int32), flattened(bits)
    for y in range(top, bottom):
        begin = (y * bits.shape[1] + left) * channels
        row = flat[begin : begin + length]
        result = moved[(y - top) * length : (y - top + 1) * length]
        for i in range(length):
            one = np.int32(row[i])
            size, sign = (one & np.int32(0x7FFF)) << np.int32(13), (one & np.int32(0x8000)) << np.int32(16)
            result[i] = size | sign
    singles = moved.view(np.float32)
    for i in range(singles.size):
        singles[i] *= _SCALE
    return singles.reshape((bottom - top, right - left, channels))
