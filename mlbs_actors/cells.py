"""The cells of a frame: squares of pixels that share a flow vector, a posterior and samples of colours.

They are the one grid of a frame: the dense flow, how well the camera explains the image, and every layer's
posterior and colours are maps of cells. A cell is 2×2 pixels of a 640×480 frame, 3×3 of 960×540 and of
1280×720, 4×4 of 1920×1080, 5×5 of 3840×2160 (:func:`~mlbs_actors.config.length_scale`). The graph cut draws
outlines from the pixels themselves; elsewhere a cell's mean colour is nearly as good, at a fraction of the
time, the memory and the messages. Objects' regions begin and end between cells.

Differs from the paper, which evaluates and keeps samples for every pixel.
"""

from __future__ import annotations

import cv2
import numpy as np

from mlbs_actors.config import length_scale
from mlbs_actors.kernels.jit import compiled
from mlbs_actors.messages import Array, Region

__all__ = [
    "aligned",
    "cell_side",
    "cells_won",
    "in_cells",
    "in_pixels",
    "mean_of_cells",
    "spread_over_cells",
]


def cell_side(shape: tuple[int, int], cell_px: float) -> int:
    """Return the side of a cell, px of a (H, W) frame, for ``cell_px`` of a 640×480 frame; at least 1."""
    return max(1, round(cell_px * length_scale(*shape)))


def aligned(region: Region, side: int, shape: tuple[int, int]) -> Region:
    """Return the least region of whole cells around another one; cells end at the right and lower border."""
    x, y = region.x // side * side, region.y // side * side
    right = min(-(-(region.x + region.width) // side) * side, shape[1])
    bottom = min(-(-(region.y + region.height) // side) * side, shape[0])
    return Region(x, y, right - x, bottom - y) if region.area else region


def in_cells(region: Region, side: int) -> Region:
    """Convert an aligned region to units of cells."""
    return Region(region.x // side, region.y // side, -(-region.width // side), -(-region.height // side))


def in_pixels(cells: Region, side: int, shape: tuple[int, int]) -> Region:
    """Convert a region of cells to pixels, clipped to the (H, W) frame."""
    x, y = cells.x * side, cells.y * side
    right = min(x + cells.width * side, shape[1])
    bottom = min(y + cells.height * side, shape[0])
    return Region(x, y, right - x, bottom - y)


def mean_of_cells(values: Array, side: int) -> Array:
    """Average over the cells of an aligned region; past the frame's border its last row and column repeat.

    Parameters
    ----------
    values : (h, w[, c]) uint8 or float32
    side : int

    Returns
    -------
    (⌈h/side⌉, ⌈w/side⌉[, c])
        Of the same type, rounded.
    """
    height, width = values.shape[:2]
    if side == 1 or values.size == 0:
        # A copy: for Numba a read-only array is another type, with kernels of its own.
        return values.copy()
    rows, columns = -(-height // side), -(-width // side)
    missing = (rows * side - height, columns * side - width)
    if any(missing):
        values = cv2.copyMakeBorder(values, 0, missing[0], 0, missing[1], cv2.BORDER_REPLICATE)
    return np.asarray(cv2.resize(values, (columns, rows), interpolation=cv2.INTER_AREA))


def cells_won(labels: Array, layer: int, region: Region, side: int, trusted: Array) -> tuple[Array, Array]:
    """Compute how much of each cell of an aligned region a layer has in a map.

    Parameters
    ----------
    labels : (H, W) uint16
        C-contiguous.
    layer : int
    region : Region
    side : int
    trusted : (⌈h/side⌉, ⌈w/side⌉) bool

    Returns
    -------
    share : (⌈h/side⌉, ⌈w/side⌉) uint8
        255 = all; past the frame's border its last row and column repeat.
    learnt : (⌈h/side⌉, ⌈w/side⌉) bool
        Cells that are trusted and entirely the layer's.
    """
    share, learnt = _count_won(labels, np.uint16(layer), region.box, side, trusted)
    return share, learnt


@compiled
def _count_won(
    labels: Array, layer: np.uint16, box: tuple[int, int, int, int], side: int, trusted: Array
) -> tuple[Array, Array]:
    left, top, width, height = box
    share, learnt = np.empty(trusted.shape, np.uint8), np.empty(trusted.shape, np.bool_)
    columns, scale = trusted.shape[1], np.float32(255.0 / (side * side))
    own = np.empty(columns * side, np.uint8)  # pixels of each column in a row of cells
    for y in range(trusted.shape[0]):
        own[:] = 0
        for v in range(y * side, (y + 1) * side):
            line = labels[top + min(v, height - 1), left : left + width]
            for x in range(width):
                own[np.uint64(x)] += np.uint8(line[np.uint64(x)] == layer)
        own[width:] = own[width - 1]
        row, trusted_cells, trust = share[y], learnt[y], trusted[y]
        if side == 2:  # the usual one: a loop of known length is vectorised
            for x in range(columns):
                first = np.uint64(2 * x)
                count = np.int32(own[first]) + np.int32(own[first + np.uint64(1)])
                row[x] = np.uint8((np.int32(255) * count + np.int32(2)) >> np.int32(2))
                trusted_cells[x] = (count == 4) & trust[x]
            continue
        for x in range(columns):
            count = np.int32(0)
            for u in range(x * side, (x + 1) * side):
                count += np.int32(own[u])
            row[x] = np.uint8(np.int32(np.rint(scale * np.float32(count))))
            trusted_cells[x] = (count == side * side) & trust[x]
    return share, learnt


def spread_over_cells(values: Array, side: int, shape: tuple[int, int]) -> Array:
    """Give every pixel of an aligned region its cell's value.

    Parameters
    ----------
    values : (⌈h/side⌉, ⌈w/side⌉[, c]) uint8, int8, bool or int32
    side : int
    shape : (h, w)

    Returns
    -------
    (h, w[, c])
        Of the same type.
    """
    if side == 1 or values.size == 0:
        return values
    size = (values.shape[1] * side, values.shape[0] * side)
    known = values.view(np.uint8) if values.itemsize == 1 else values  # cv2 has no bool
    spread = cv2.resize(known, size, interpolation=cv2.INTER_NEAREST)
    return np.ascontiguousarray(spread[: shape[0], : shape[1]]).view(values.dtype)
