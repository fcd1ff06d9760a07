"""Coarse-to-fine minimisation: a label-cost energy on pixels of twice the size, then a band of fine ones.

The cost of a cut grows faster than its number of pixels. So an energy is first minimised over the labellings
in which every 2×2 block has one label, which is an energy of the same form on a quarter of the pixels; then
only pixels near the outlines of that solution are labelled anew (the banded cut of Lombaert, Sun, Grady and
Xu, ICCV 2005), every label once: a second sweep would move hardly a pixel. The tests bound how far the energy
of the result lies above that of a cut of all pixels.

An outline along blocks costs what the cheapest outline within a pixel of it costs, as the band can move it
there. Otherwise image edges that do not coincide with block borders would be lost: outlines would cost more
on blocks than on pixels, and limbs would be cut off for good.

Differs from the paper, which cuts the whole grid.
"""

from __future__ import annotations

import numpy as np

from mlbs_actors.graphcut.energy import (
    UNDECIDED,
    LabelCostEnergy,
    UndecidedEnergy,
    energy_of_pixels,
    undecided_energy,
)
from mlbs_actors.kernels.jit import compiled
from mlbs_actors.messages import Array

__all__ = ["band_around_outlines", "halved"]

#: Largest unary cost of a block: no sum of pair weights exceeds it, and nine of them fit into 32 bits.
MAX_BLOCK_COST = 2**24


def halved(whole: LabelCostEnergy) -> LabelCostEnergy:
    """Return the energy of labellings that are constant on 2×2 blocks, outlines at their cheapest nearby.

    Parameters
    ----------
    whole : LabelCostEnergy
        Of (H, W) pixels.

    Returns
    -------
    LabelCostEnergy
        Of (⌈H/2⌉, ⌈W/2⌉) blocks; but for outlines equal to the whole energy on every such labelling, up to
        the bound of a block's cost.
    """
    height, width = whole.weights.shape[:2]
    if whole.side > 2 and whole.side % 2 == height % 2 == width % 2 == 0:
        return _energy_in_cells(whole)
    return _energy_of_blocks(whole if whole.side == 2 else energy_of_pixels(whole))


@compiled
def _energy_in_cells(whole: LabelCostEnergy) -> LabelCostEnergy:
    """Apply :func:`halved` to cells of whole blocks, which share their costs there, too."""
    sums = np.empty_like(whole.unary)
    for label in range(sums.shape[0]):
        top, bottom, left, right = whole.places[label]
        for v in range(top, bottom):
            for u in range(left, right):
                sums[label, v, u] = min(np.int32(4) * whole.unary[label, v, u], np.int32(MAX_BLOCK_COST))
    extras = whole.extras.copy()
    extras[:, 1:3] //= 2
    return LabelCostEnergy(
        sums, _halved_weights(whole.weights), whole.label_costs, whole.places, whole.side // 2, extras
    )


@compiled
def band_around_outlines(whole: LabelCostEnergy, blocks: Array) -> tuple[Array, UndecidedEnergy, Array]:
    """Reopen the pixels on both sides of an outline of a labelling of blocks.

    Parameters
    ----------
    whole : LabelCostEnergy
        Of (H, W) pixels.
    blocks : (⌈H/2⌉, ⌈W/2⌉) int16

    Returns
    -------
    labels : (H, W) int16
        Of the pixels, ``UNDECIDED`` where they are reopened.
    rest : UndecidedEnergy
        Of those.
    start : (n,) intp
        The labels of their blocks.
    """
    height, width = whole.weights.shape[:2]
    labels, elsewhere = _opened(blocks, whole.label_costs.size, height, width)
    rest = undecided_energy(whole, labels, elsewhere)
    start = np.empty(rest.pixels.size, np.intp)
    for i in range(start.size):
        start[i] = blocks[rest.pixels[i] // rest.width // 2, rest.pixels[i] % rest.width // 2]
    return labels, rest, start


@compiled
def _opened(blocks: Array, label_count: int, height: int, width: int) -> tuple[Array, Array]:
    """Return the labels of the blocks' pixels, undecided near outlines, and which labels are elsewhere."""
    rows, columns = blocks.shape
    labels = np.empty((height, width), np.int16)
    for y in range(height):
        own, above = labels[y], blocks[y // 2]
        for u in range(width // 2):
            own[2 * u] = own[2 * u + 1] = above[u]
        own[width - 1] = above[columns - 1]
    for v in range(rows):
        for u in range(columns):
            y, x = 2 * v, 2 * u
            if u + 1 < columns and blocks[v, u] != blocks[v, u + 1]:
                for row in range(max(y - 1, 0), min(y + 3, height)):
                    labels[row, x + 1] = labels[row, x + 2] = UNDECIDED
            if v + 1 < rows and blocks[v, u] != blocks[v + 1, u]:
                for column in range(max(x - 1, 0), min(x + 3, width)):
                    labels[y + 1, column] = labels[y + 2, column] = UNDECIDED
    seen = np.zeros(label_count + 1, np.bool_)
    for y in range(height):
        own = labels[y]
        for x in range(width):
            seen[np.uint64(own[np.uint64(x)] - UNDECIDED)] = True
    return labels, seen[1:].copy()


@compiled
def _energy_of_blocks(whole: LabelCostEnergy) -> LabelCostEnergy:
    """Apply :func:`halved` to cells of 1 or 2 px."""
    height, width = whole.weights.shape[:2]
    boxes = np.empty_like(whole.places)
    for label in range(len(boxes)):
        for edge in range(4):
            most = height if edge < 2 else width
            pixels = min(whole.places[label, edge] * whole.side, most)
            # Blocks with all their pixels inside; one at the end of the image contains its last block.
            begins = edge % 2 == 0
            boxes[label, edge] = (pixels + 1) // 2 if begins or pixels == most else pixels // 2
    sums = _summed_unary(whole, boxes)
    return LabelCostEnergy(
        sums, _halved_weights(whole.weights), whole.label_costs, boxes, 1, whole.extras[:0]
    )


@compiled
def _summed_unary(whole: LabelCostEnergy, boxes: Array) -> Array:
    """Sum over blocks of 2×2 pixels, only where a label can be, in boxes of blocks."""
    most, unary, extras = np.int32(MAX_BLOCK_COST), whole.unary, whole.extras
    height, width = whole.weights.shape[:2]
    sums = np.empty((unary.shape[0], (height + 1) // 2, (width + 1) // 2), np.int32)
    for label in range(unary.shape[0]):
        top, bottom, left, right = boxes[label]
        full = min(right, width // 2)
        for v in range(top, bottom):
            total = sums[label, v]
            if whole.side == 2:
                down, own = np.int32(min(2, height - 2 * v)), unary[label, v]
                for u in range(left, full):
                    total[u] = np.int32(2) * down * own[u]
                if full < right:
                    total[full] = down * own[full]
                continue
            total[left:right] = 0
            for y in range(2 * v, min(2 * v + 2, height)):
                own = unary[label, y]
                for u in range(left, full):
                    first = np.uint64(2 * u)
                    total[np.uint64(u)] += own[first] + own[first + np.uint64(1)]
                if full < right:
                    total[full] += own[width - 1]
    for extra in range(extras.shape[0]):
        sums[extras[extra, 0], extras[extra, 1] // 2, extras[extra, 2] // 2] += extras[extra, 3]
    for label in range(unary.shape[0]):
        top, bottom, left, right = boxes[label]
        for v in range(top, bottom):
            total = sums[label, v]
            for u in range(left, right):
                total[u] = min(total[u], most)
    return sums


@compiled
def _halved_weights(weights: Array) -> Array:
    """Return pair weights (rows, columns, 4) int32 of blocks: those of their pixels, lowered to the cost of
    the cheapest straight outline within a pixel of the blocks' edge."""
    height, width, _ = weights.shape
    rows, columns = (height + 1) // 2, (width + 1) // 2
    across, down = _outlines_along_blocks(weights)
    halved = np.empty((rows, columns, 4), np.int32)
    _halve(weights, across, down, np.empty((2, columns + 1), np.int32), np.ones((2, columns + 1)), halved)
    return halved


@compiled
def _halve(weights: Array, across: Array, down: Array, pairs: Array, shares: Array, halved: Array) -> None:
    """Apply :func:`_halved_weights` to the costs of :func:`_outlines_along_blocks`, with scratch for two rows
    of diagonal pairs, int32, and two of the shares left to straight ones, ones of float64."""
    (height, width, _), (rows, columns, _) = weights.shape, halved.shape
    # Diagonal neighbours share one pair of pixels; there is none to the left of the first block.
    diagonal, anti, beside, below = pairs[0], pairs[1], shares[0], shares[1]
    results = halved.reshape(-1)
    for v in range(rows):
        y, upright, own = 2 * v + 1, across[v], results[4 * columns * v : 4 * columns * (v + 1)]
        _diagonal_pairs(weights, y, diagonal, anti)
        # Branch-free, hence vectorised. A pair of weight 0 has no share to lose.
        for u in range((width - 1) // 2):
            at, first = np.uint64(u + 1), np.uint64(2 * u)
            here = upright[first + np.uint64(1)]
            least = min(upright[first], here, upright[first + np.uint64(2)])
            beside[at] = np.float64(least) / np.float64(max(here, 1))
        beside[0] = beside[1]
        before, level, after = down[y - 1], down[y], down[max(min(y + 1, height - 2), 0)]
        for u in range(columns):
            at = np.uint64(u)
            least = min(before[at], level[at], after[at])
            below[at] = np.float64(least) / np.float64(max(level[at], 1))
        for u in range(columns):
            at, following, first = np.uint64(u), np.uint64(u + 1), np.uint64(4 * u)
            right_side = upright[np.uint64(2 * u + 1)] - diagonal[at] - anti[following]
            lower_side = level[at] - diagonal[at] - anti[at]
            own[first] = np.int32(right_side * beside[following])
            own[first + np.uint64(1)] = np.int32(lower_side * below[at])
            own[first + np.uint64(2)] = np.int32(diagonal[at] * min(beside[following], below[at]))
            own[first + np.uint64(3)] = np.int32(anti[at] * min(beside[at], below[at]))
        halved[v, columns - 1, 0] = 0


@compiled
def _outlines_along_blocks(weights: Array) -> tuple[Array, Array]:
    """Return the cost of an outline along one block: to the right of each column of pixels, (rows,
    2 · columns + 1), the last but one again at the image's border; and below each row, (H + 1, columns)."""
    height, width, _ = weights.shape
    rows, columns = (height + 1) // 2, (width + 1) // 2
    across, down = np.zeros((rows, 2 * columns + 1), np.int32), np.zeros((height + 1, columns), np.int32)
    onward, back = np.empty(width, np.int32), np.empty(width, np.int32)
    under, flat = np.zeros(2 * columns, np.int32), weights.reshape(-1)
    for y in range(height):
        own, upright, level = flat[4 * width * y : 4 * width * (y + 1)], across[y // 2], down[y]
        for x in range(width):  # sequential, so that each is read once
            at, first = np.uint64(x), np.uint64(4 * x)
            diagonal, anti = own[first + np.uint64(2)], own[first + np.uint64(3)]
            onward[at], back[at] = own[first] + diagonal, anti
            under[at] = own[first + np.uint64(1)] + diagonal + anti
        for x in range(width - 1):
            at = np.uint64(x)
            upright[at] += onward[at] + back[at + np.uint64(1)]
        for u in range(columns):
            first = np.uint64(2 * u)
            level[np.uint64(u)] = under[first] + under[first + np.uint64(1)]
    across[:, width - 1] = across[:, max(width - 2, 0)]
    return across, down


@compiled
def _diagonal_pairs(weights: Array, y: int, diagonal: Array, anti: Array) -> None:
    """Write the weights from a block's last row of pixels to the blocks down right and down left, for each
    column; 0 where it has only one row."""
    height, width, _ = weights.shape
    diagonal[:] = 0
    anti[:] = 0
    if y < height:
        own = weights[y].reshape(-1)
        for u in range(width // 2):
            at, first = np.uint64(u), np.uint64(8 * u)
            diagonal[at], anti[at] = own[first + np.uint64(6)], own[first + np.uint64(3)]
        if width % 2 == 1:
            anti[width // 2] = own[4 * width - 1]
