"""A label-cost energy on pixels of twice the size, and what its solution leaves open on the original ones.

The cost of a cut grows faster than its pixels. An energy is therefore first minimised over the labellings
in which every 2×2 block has one label, which is an energy of the same form on a quarter of the pixels; then
only pixels near the outlines of that solution are labelled anew (the banded cut of Lombaert, Sun, Grady and
Xu, ICCV 2005). The result is a labelling that no expansion within the band improves; the tests bound how
far its energy lies above that of a cut of all pixels.

Differs from the paper, which cuts the whole grid.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from mlbs_actors.label_cost_energy import UNDECIDED, LabelCostEnergy, UndecidedEnergy, undecided_energy
from mlbs_actors.messages import Array

__all__ = ["band_around_outlines", "halved", "unhalved"]

#: Largest unary cost of a block: what no sum of pair weights outweighs, and nine of which fit into 32 bits.
MAX_BLOCK_COST = 2**24
#: The band reaches so many pixels to either side of an outline.
BAND = 2


def halved(whole: LabelCostEnergy) -> LabelCostEnergy:
    """The same energy for labellings that are constant on 2×2 blocks.

    Parameters
    ----------
    whole : LabelCostEnergy
        Of (H, W) pixels.

    Returns
    -------
    LabelCostEnergy
        Of (⌈H/2⌉, ⌈W/2⌉) blocks; equal on every such labelling, up to the bound of a block's cost.
    """
    if whole.side != 2:
        whole = whole.of_pixels()
    height, width = whole.weights.shape[:2]
    unary = _halved_unary(whole.unary, whole.side, whole.extras, height, width)
    return LabelCostEnergy(unary, _halved_weights(whole.weights), whole.label_costs)


def unhalved(labels: Array, shape: tuple[int, int]) -> Array:
    """The labelling of (H, W) pixels that the blocks' labels stand for."""
    return np.ascontiguousarray(labels.repeat(2, axis=0).repeat(2, axis=1)[: shape[0], : shape[1]])


def band_around_outlines(whole: LabelCostEnergy, labels: Array) -> UndecidedEnergy:
    """The energy of the pixels near the outlines of a labelling, the others keeping their labels.

    Parameters
    ----------
    whole : LabelCostEnergy
    labels : (H, W) intp

    Returns
    -------
    UndecidedEnergy
    """
    opened, elsewhere = _opened(labels, whole.label_costs.size, BAND)
    return undecided_energy(whole, opened, elsewhere)


@njit(cache=True)
def _opened(labels: Array, label_count: int, reach: int) -> tuple[Array, Array]:
    """The labels, open wherever a window that reaches so far holds more than one; and which are elsewhere."""
    height, width = labels.shape
    opened = labels.copy()
    for y in range(height):
        for x in range(width):
            if x + 1 < width and labels[y, x] != labels[y, x + 1]:
                top, left = max(y - reach, 0), max(x + 1 - reach, 0)
                opened[top : y + reach + 1, left : x + reach + 1] = UNDECIDED
            if y + 1 < height and labels[y, x] != labels[y + 1, x]:
                top, left = max(y + 1 - reach, 0), max(x - reach, 0)
                opened[top : y + reach + 1, left : x + reach + 1] = UNDECIDED
    elsewhere = np.zeros(label_count, np.bool_)
    for y in range(height):
        for x in range(width):
            if opened[y, x] != UNDECIDED:
                elsewhere[opened[y, x]] = True
    return opened, elsewhere


@njit(cache=True)
def _halved_unary(unary: Array, side: int, extras: Array, height: int, width: int) -> Array:
    """Sums over blocks of 2×2 pixels of an (H, W) image, of which each, or each block, has its cost."""
    rows, columns = (height + 1) // 2, (width + 1) // 2
    sums = np.zeros((unary.shape[0], rows, columns), np.int32)
    for label in range(unary.shape[0]):
        if side == 1:
            for y in range(height):
                own, total = unary[label, y], sums[label, y // 2]
                for u in range(width // 2):
                    total[u] += own[2 * u] + own[2 * u + 1]
                if width % 2:
                    total[columns - 1] += own[width - 1]
        else:
            for v in range(rows):
                down = min(2, height - 2 * v)
                for u in range(columns):
                    sums[label, v, u] = unary[label, v, u] * np.int32(down * min(2, width - 2 * u))
    for extra in range(extras.shape[0]):
        sums[extras[extra, 0], extras[extra, 1] // 2, extras[extra, 2] // 2] += extras[extra, 3]
    return np.minimum(sums, np.int32(MAX_BLOCK_COST))


@njit(cache=True)
def _halved_weights(weights: Array) -> Array:
    height, width, _ = weights.shape
    rows, columns = (height + 1) // 2, (width + 1) // 2
    joined = np.zeros((rows, columns, 4), np.int32)
    for y in range(height):
        for x in range(width):
            v, u = y // 2, x // 2
            odd_row, odd_column = y % 2 == 1, x % 2 == 1
            if odd_column:
                joined[v, u, 0] += weights[y, x, 0]
            if odd_row:
                joined[v, u, 1] += weights[y, x, 1]
            if odd_row and odd_column:
                joined[v, u, 2] += weights[y, x, 2]
            elif odd_row:
                joined[v, u, 1] += weights[y, x, 2]
            elif odd_column:
                joined[v, u, 0] += weights[y, x, 2]
            if odd_row and not odd_column:
                joined[v, u, 3] += weights[y, x, 3]
            elif odd_row:
                joined[v, u, 1] += weights[y, x, 3]
            elif not odd_column and u > 0:
                joined[v, u - 1, 0] += weights[y, x, 3]
    return joined
