"""Image rows prepared for vector registers: one plane per channel, with a border instead of special cases."""

from __future__ import annotations

import numpy as np

from mlbs_actors.kernels.jit import compiled, inlined
from mlbs_actors.kernels.simd import LANES, Lanes, broadcast, load, maximum, store
from mlbs_actors.messages import Array

__all__ = ["mirrored", "padded_part", "padded_planes", "read_row", "row_room"]


@compiled
def padded_planes(image: Array) -> Array:
    """Apply :func:`padded_part` to a whole image."""
    return padded_part(image, 0, 0, image.shape[1], image.shape[0])


@compiled
def padded_part(image: Array, left: int, top: int, width: int, height: int) -> Array:
    """Split a part of a C-contiguous image (H, W, 3) into channels, its border repeated: (3, height + 2,
    width + 2).

    The array has spare room at the end, so that a whole register can be read from the last row.
    """
    size = 3 * (height + 2) * (width + 2)
    planes = np.empty(size + LANES, np.uint8)[:size].reshape(3, height + 2, width + 2)
    if height == 0:
        return planes
    pixels = image.reshape(-1)
    for y in range(height + 2):
        first = 3 * ((top + min(max(y - 1, 0), height - 1)) * image.shape[1] + left)
        row = pixels[first : first + 3 * width]
        blues, greens, reds = planes[0, y], planes[1, y], planes[2, y]
        for x in range(width):
            place, pixel = np.uint64(x + 1), np.uint64(3 * x)
            blues[place], greens[place] = row[pixel], row[pixel + np.uint64(1)]
            reds[place] = row[pixel + np.uint64(2)]
        for plane in (blues, greens, reds):
            plane[0], plane[width + 1] = plane[1], plane[width]
    return planes


@compiled
def row_room(width: int) -> Array:
    """Return the buffer of :func:`read_row`: (5, whole registers), float32."""
    return np.zeros((5, -(-width // LANES) * LANES), np.float32)


@compiled
def read_row(planes: Array, y: int, residual: Array, first: int, end: int, room: Array) -> None:
    """Interpolate colours in a part of an image's row, each less than 1 px off its pixel, inside the image.

    All nine neighbours are weighted, most of them by 0: branch-free, and in the order of the row, this takes
    a tenth of the time of reading the four that count.

    Parameters
    ----------
    planes : Array
        :func:`padded_planes`.
    y : int
    residual : (h, w, 2) float32
        Offset (x, y) from the pixel, of all rows.
    first, end : int
        The part; it is read in whole registers.
    room : Array
        :func:`row_room`. Its first three rows become the colours, the others are the residual's.
    """
    flat, rests, row = planes.reshape(-1), residual[y].reshape(-1), room.reshape(-1)
    height, width, length = planes.shape[1], np.uint64(planes.shape[2]), np.uint64(room.shape[1])
    first = first // LANES * LANES
    for pixel in range(first, min(end, residual.shape[1])):
        room[3, pixel], room[4, pixel] = rests[np.uint64(2 * pixel)], rests[np.uint64(2 * pixel + 1)]
    zero, one = broadcast(np.float32(0), LANES), broadcast(np.float32(1), LANES)
    for start in range(first, end, LANES):
        x = np.uint64(start)
        right, down = load(row, np.uint64(3) * length + x, LANES), load(row, np.uint64(4) * length + x, LANES)
        left_share, right_share = maximum(zero - right, zero), maximum(right, zero)
        share = one - left_share - right_share
        upper, lower = maximum(zero - down, zero), maximum(down, zero)
        level = one - upper - lower
        for channel in range(3):
            above = np.uint64(channel * height + y) * width + x
            beside, below = above + width, above + width + width
            top = _weighed(flat, above, left_share, share, right_share)
            middle = _weighed(flat, beside, left_share, share, right_share)
            bottom = _weighed(flat, below, left_share, share, right_share)
            store(row, np.uint64(channel) * length + x, upper * top + level * middle + lower * bottom)


@inlined
def _weighed(flat: Array, at: np.uint64, before: Lanes, here: Lanes, after: Lanes) -> Lanes:
    """Sum lanes of an image, the next ones and those after these, by their weights."""
    one, two = np.uint64(1), np.uint64(2)
    weighed: Lanes = (
        before * load(flat, at, LANES) + here * load(flat, at + one, LANES)
        + after * load(flat, at + two, LANES)
    )  # fmt: skip
    return weighed


@compiled
def mirrored(at: int, length: int) -> int:
    """Mirror an index at the first and last pixel of a row."""
    while length > 1 and not 0 <= at < length:
        at = -at if at < 0 else 2 * length - 2 - at
    return at if length > 1 else 0
