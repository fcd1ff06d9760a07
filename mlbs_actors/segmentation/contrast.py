"""Contrast-sensitive cost of an outline between two pixels: low where the image has an edge (§7).

Differs from the paper: its pair factor q_ij = ±1 makes the pair term submodular only where its logarithm is
positive. Here it is a contrast-sensitive Potts weight w ≥ 0, as in the authors' program, with the two
diagonal directions divided by √2: an outline then costs the same per length along an axis and a diagonal.
"""

from __future__ import annotations

import functools
import math

import numpy as np

from mlbs_actors.graphcut.energy import NEIGHBOUR_OFFSETS
from mlbs_actors.kernels.image_rows import padded_part
from mlbs_actors.kernels.jit import compiled
from mlbs_actors.messages import Array

__all__ = ["COST_QUANTUM", "contrast_weights", "weights_by_distance"]

#: Unit of all costs, nats.
COST_QUANTUM = 1.0 / 1024.0


@functools.lru_cache(maxsize=16)
def weights_by_distance(strength: float, scale: float) -> Array:
    """Tabulate the weights by squared colour distance, which is an integer.

    Parameters
    ----------
    strength : float
        Weight between equal colours, nats.
    scale : float
        Squared colour distance, summed over the channels, at which the weight has fallen to 1/e.

    Returns
    -------
    (2, n) int32
        Straight ones, then diagonal ones; the last entry, for all larger distances, is 0. ``COST_QUANTUM``.
    """
    reach = scale * math.log(max(1.0, 2.0 * strength / COST_QUANTUM))
    straight = strength * np.exp(-np.arange(int(min(reach, 3 * 255**2)) + 1) / scale)
    table = np.zeros((2, straight.size + 1))
    table[:, :-1] = straight, straight / math.sqrt(2.0)
    return np.rint(table / COST_QUANTUM).astype(np.int32)


@compiled
def contrast_weights(image: Array, box: tuple[int, int, int, int], table: Array) -> Array:
    """Compute contrast-sensitive Potts weights: strength · exp(−|ΔRGB|² / scale), diagonals divided by √2.

    Parameters
    ----------
    image : (H, W, 3) uint8
        C-contiguous; the order of the channels does not matter.
    box : (left, top, width, height)
        The part to evaluate.
    table : (2, n) int32
        Of :func:`weights_by_distance`.

    Returns
    -------
    (height, width, 4) int32
        To the neighbour at ``NEIGHBOUR_OFFSETS[k]``, k < 4; 0 where that is outside. Units of
        ``COST_QUANTUM``.
    """
    left, top, width, height = box
    weights = np.empty((height, width, 4), np.int32)
    _weigh(padded_part(image, left, top, width, height), table, np.empty((4, width), np.int32), weights)
    return weights


@compiled
def _weigh(planes: Array, table: Array, distances: Array, weights: Array) -> None:
    """Compute the weights from an image's padded planes, with scratch for a row's distances, (4, w) int32."""
    height, width, last = weights.shape[0], weights.shape[1], np.int32(table.shape[1] - 1)
    beside, below, diagonal, anti = distances[0], distances[1], distances[2], distances[3]
    results = weights.reshape(-1)
    for y in range(height):
        for k in range(4):  # branch-free, hence vectorised
            down, right = NEIGHBOUR_OFFSETS[k]
            distance = distances[k]
            blues, greens, reds = planes[0, y + 1], planes[1, y + 1], planes[2, y + 1]
            those = planes[:, y + 1 + down]
            other_blues, other_greens, other_reds = those[0], those[1], those[2]
            for x in range(width):
                own, other = np.uint64(x + 1), np.uint64(x + 1 + right)
                blue = np.int32(blues[own]) - np.int32(other_blues[other])
                green = np.int32(greens[own]) - np.int32(other_greens[other])
                red = np.int32(reds[own]) - np.int32(other_reds[other])
                distance[np.uint64(x)] = min(np.int32(blue * blue + green * green + red * red), last)
            if y + down == height:
                distance[:] = last
            if right:
                distance[width - 1 if right > 0 else 0] = last
        row = results[4 * width * y : 4 * width * (y + 1)]
        for x in range(width):
            at, first = np.uint64(x), np.uint64(4 * x)
            row[first] = table[0, np.uint64(beside[at])]
            row[first + np.uint64(1)] = table[0, np.uint64(below[at])]
            row[first + np.uint64(2)] = table[1, np.uint64(diagonal[at])]
            row[first + np.uint64(3)] = table[1, np.uint64(anti[at])]
