"""A label-cost energy on pixels of twice the size, and what its solution leaves open on the original ones.

The cost of a cut grows faster than its pixels. An energy is therefore first minimised over the labellings
in which every 2×2 block has one label, which is an energy of the same form on a quarter of the pixels; then
only pixels near the outlines of that solution are labelled anew (the banded cut of Lombaert, Sun, Grady and
Xu, ICCV 2005), every label once: a second sweep would move hardly a pixel. The tests bound how far the energy
of the result lies above that of a cut of all pixels.

An outline along blocks is not charged for where it lies but for the cheapest place within a pixel, to which
the band can move it. Else the edges of the image that do not happen to lie between two blocks would be lost:
outlines cost more on blocks than on pixels, and limbs are cut off, for good.

Differs from the paper, which cuts the whole grid.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mlbs_actors.compilation import compiled
from mlbs_actors.label_cost_energy import UNDECIDED, LabelCostEnergy, UndecidedEnergy, undecided_energy
from mlbs_actors.messages import Array

__all__ = ["Band", "band_around_outlines", "halved"]

#: Largest unary cost of a block: what no sum of pair weights outweighs, and nine of which fit into 32 bits.
MAX_BLOCK_COST = 2**24


@dataclass(frozen=True, slots=True)
class Band:
    """What a labelling of blocks leaves open.

    Attributes
    ----------
    labels : (H, W) int16
        Of the pixels, ``UNDECIDED`` where they are open.
    rest : UndecidedEnergy
        Of those.
    start : (n,) intp
        The labels of their blocks.
    """

    labels: Array
    rest: UndecidedEnergy
    start: Array


def halved(whole: LabelCostEnergy) -> LabelCostEnergy:
    """The same energy for labellings that are constant on 2×2 blocks, outlines at their cheapest nearby.

    Parameters
    ----------
    whole : LabelCostEnergy
        Of (H, W) pixels.

    Returns
    -------
    LabelCostEnergy
        Of (⌈H/2⌉, ⌈W/2⌉) blocks; but for the outlines equal on every such labelling, up to the bound of a
        block's cost.
    """
    if whole.side != 2:
        whole = whole.of_pixels()
    unary, weights, places = _halved(whole.unary, whole.side, whole.extras, whole.boxes(), whole.weights)
    return LabelCostEnergy(unary, weights, whole.label_costs, places=places)


def band_around_outlines(whole: LabelCostEnergy, blocks: Array) -> Band:
    """What is left open by a labelling of blocks: the pixels on both sides of an outline.

    Parameters
    ----------
    whole : LabelCostEnergy
        Of (H, W) pixels.
    blocks : (⌈H/2⌉, ⌈W/2⌉) int16

    Returns
    -------
    Band
    """
    labels, elsewhere = _opened(blocks, whole.label_costs.size, *whole.weights.shape[:2])
    rest = undecided_energy(whole, labels, elsewhere)
    return Band(labels, rest, _of_blocks(blocks, rest.pixels, rest.row, labels.shape[1]))


@compiled()
def _opened(blocks: Array, label_count: int, height: int, width: int) -> tuple[Array, Array]:
    """The labels of the blocks' pixels, open beside the outlines; and which labels are elsewhere."""
    rows, columns = blocks.shape
    labels, elsewhere = np.empty((height, width), np.int16), np.zeros(label_count, np.bool_)
    for y in range(height):
        own, above = labels[y], blocks[y // 2]
        for u in range(width // 2):
            own[2 * u] = own[2 * u + 1] = above[u]
        own[width - 1] = above[columns - 1]
    for v in range(rows):
        for u in range(columns):
            y, x = 2 * v, 2 * u
            if u + 1 < columns and blocks[v, u] != blocks[v, u + 1]:
                labels[max(y - 1, 0) : y + 3, x + 1 : x + 3] = UNDECIDED
            if v + 1 < rows and blocks[v, u] != blocks[v + 1, u]:
                labels[y + 1 : y + 3, max(x - 1, 0) : x + 3] = UNDECIDED
    for y in range(height):
        own, last = labels[y], np.int16(UNDECIDED)
        for x in range(width):
            if own[x] != last:
                last = own[x]
                if last != UNDECIDED:
                    elsewhere[last] = True
    return labels, elsewhere


@compiled()
def _of_blocks(blocks: Array, pixels: Array, row: Array, width: int) -> Array:
    """Labels (n,) intp of the blocks that some pixels of an image lie in."""
    labels = np.empty(pixels.size, np.intp)
    for i in range(pixels.size):
        labels[i] = blocks[row[i] // 2, (pixels[i] - row[i] * width) // 2]
    return labels


@compiled()
def _halved(
    unary: Array, side: int, extras: Array, places: Array, weights: Array
) -> tuple[Array, Array, Array]:
    height, width = weights.shape[:2]
    boxes = np.empty_like(places)
    for label in range(len(places)):
        for edge in range(4):
            most = height if edge < 2 else width
            pixels = min(places[label, edge] * side, most)
            # Blocks that lie in it with all their pixels; one that ends with the image holds its last block.
            begins = edge % 2 == 0
            boxes[label, edge] = (pixels + 1) // 2 if begins or pixels == most else pixels // 2
    return _halved_unary(unary, side, extras, boxes, height, width), _halved_weights(weights), boxes


@compiled()
def _halved_unary(unary: Array, side: int, extras: Array, places: Array, height: int, width: int) -> Array:
    """Sums over blocks of 2×2 pixels of an (H, W) image, of which each, or each block, has its cost; made
    only where a label can be, in boxes of blocks."""
    rows, columns = (height + 1) // 2, (width + 1) // 2
    sums = np.empty((unary.shape[0], rows, columns), np.int32)
    most = np.int32(MAX_BLOCK_COST)
    for label in range(unary.shape[0]):
        top, bottom, left, right = places[label]
        for v in range(top, bottom):
            down = min(2, height - 2 * v)
            total = sums[label, v]
            for u in range(left, right):
                across = min(2, width - 2 * u)
                if side == 1:
                    total[u] = 0
                    for y in range(2 * v, 2 * v + down):
                        for x in range(2 * u, 2 * u + across):
                            total[u] += unary[label, y, x]
                else:
                    total[u] = unary[label, v, u] * np.int32(down * across)
    for extra in range(extras.shape[0]):
        sums[extras[extra, 0], extras[extra, 1] // 2, extras[extra, 2] // 2] += extras[extra, 3]
    for label in range(unary.shape[0]):
        top, bottom, left, right = places[label]
        for v in range(top, bottom):
            total = sums[label, v]
            for u in range(left, right):
                total[u] = min(total[u], most)
    return sums


@compiled()
def _halved_weights(weights: Array) -> Array:
    """Pair weights (rows, columns, 4) int32 of blocks: those of their pixels, lowered to what the cheapest
    straight outline costs that lies within a pixel of the blocks' edge."""
    joined = _joined_weights(weights)
    beside, below = _shares_of_edges(weights)
    for v in range(joined.shape[0]):
        for u in range(joined.shape[1]):
            own, left = joined[v, u], max(u - 1, 0)
            own[0] = np.int32(own[0] * beside[v, u])
            own[1] = np.int32(own[1] * below[v, u])
            own[2] = np.int32(own[2] * min(beside[v, u], below[v, u]))
            own[3] = np.int32(own[3] * min(beside[v, left], below[v, u]))
    return joined


@compiled()
def _shares_of_edges(weights: Array) -> tuple[Array, Array]:
    """What the cheapest outline near a block's edge costs of an outline there, (rows, columns) in [0, 1], of
    its right edge and its lower one. Beyond the image is no outline."""
    height, width, _ = weights.shape
    rows, columns = (height + 1) // 2, (width + 1) // 2
    # What an outline along a block costs to the right of a column, and below a row.
    upright, level = np.zeros((rows, width), np.int32), np.zeros((height, columns), np.int32)
    for y in range(height):
        own, right_of, under = weights[y], upright[y // 2], level[y]
        for x in range(width - 1):
            right_of[x] += own[x, 0] + own[x, 2] + own[x + 1, 3]
        for x in range(width):
            under[x // 2] += own[x, 1] + own[x, 2] + own[x, 3]
    beside, below = np.ones((rows, columns)), np.ones((rows, columns))
    for v in range(rows):
        right_of, y = upright[v], 2 * v + 1
        for u in range((width - 1) // 2):
            x = 2 * u + 1
            least = min(right_of[x - 1], right_of[min(x + 1, width - 2)])
            if least < right_of[x]:
                beside[v, u] = least / right_of[x]
        if y < height - 1:
            before, under, after = level[y - 1], level[y], level[min(y + 1, height - 2)]
            for u in range(columns):
                least = min(before[u], after[u])
                if least < under[u]:
                    below[v, u] = least / under[u]
    return beside, below


@compiled()
def _joined_weights(weights: Array) -> Array:
    """Sums over the pairs of pixels of two blocks, by block and direction."""
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
