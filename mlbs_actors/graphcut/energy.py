"""The energy of a labelling, of a whole image and of its undecided pixels (§7).

E(L) = Σ_p U_p(l_p) + Σ_pq w_pq [l_p ≠ l_q] + Σ_k h_k δ_k(L), in integers of any unit. Where some pixels are
decided, the others have an energy of their own, into whose unary terms the decided neighbours are folded.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mlbs_actors.kernels.jit import compiled
from mlbs_actors.messages import Array

__all__ = [
    "NEIGHBOUR_OFFSETS",
    "UNDECIDED",
    "LabelCostEnergy",
    "SparseUnaries",
    "UndecidedEnergy",
    "cost_of_labels",
    "energy_of_pixels",
    "undecided_energy",
    "undecided_energy_of",
]

#: Label of a pixel that is not decided yet.
UNDECIDED = -1
#: Label of neighbours that have different ones.
_SEVERAL = -2

#: (dy, dx) of the eight neighbours; entry k + 4 is the opposite of entry k.
NEIGHBOUR_OFFSETS = np.array([(0, 1), (1, 0), (1, 1), (1, -1), (0, -1), (-1, 0), (-1, -1), (-1, 1)])


class LabelCostEnergy(NamedTuple):
    """E(L) of an (H, W) image and K labels, in integers of any unit.

    Attributes
    ----------
    unary : (K, ⌈H / side⌉, ⌈W / side⌉) int32
        Cost of each label at each pixel of a cell, at most 2²⁴ in absolute value.
    weights : (H, W, 4) int32
        Potts weight to the neighbour at ``NEIGHBOUR_OFFSETS[k]``, k < 4, in 0 … 2²⁴; 0 where it would be
        outside the image. C-contiguous.
    label_costs : (K,) int64
        Cost of using a label at all, ≥ 0.
    places : (K, 4) int64
        The box of cells in which each label is allowed: first row, row past the last, first column, column
        past the last. Its costs elsewhere are never read.
    side : int
        Side of the square cells whose pixels share their unary costs.
    extras : (n, 4) int64
        Label, row, column, and an addition to that label's unary cost at that pixel alone; the label must be
        allowed there.
    """

    unary: Array
    weights: Array
    label_costs: Array
    places: Array
    side: int = 1
    extras: Array = np.zeros((0, 4), np.int64)


class SparseUnaries(NamedTuple):
    """Unary costs of the undecided pixels in compressed form: label by label, pixels and their costs.

    Attributes
    ----------
    first : (K + 1,) int64
        Label k has the entries ``first[k]`` … ``first[k + 1]`` − 1.
    pixel : (m,) int32
        Position of a pixel among the undecided ones, ascending within a label.
    cost : (m,) int32
    """

    first: Array
    pixel: Array
    cost: Array


class UndecidedEnergy(NamedTuple):
    """The energy of the n undecided pixels, up to a constant, in the unit of the whole.

    Attributes
    ----------
    pixels : (n,) intp
        Flat index in the image, ascending.
    width : int
        Of the image.
    unaries : SparseUnaries
        With the pair terms to decided neighbours folded in.
    neighbour : (n, 8) int32
        Position in ``pixels`` of each neighbour, −1 where there is none or it is decided.
    weight : (n, 8) int32
        Potts weight to it, 0 where there is none.
    label_costs : (K,) int64
        0 for the labels that decided pixels hold.
    elsewhere : (K,) bool
        Labels that decided pixels hold.
    """

    pixels: Array
    width: int
    unaries: SparseUnaries
    neighbour: Array
    weight: Array
    label_costs: Array
    elsewhere: Array


@compiled
def undecided_energy(whole: LabelCostEnergy, labels: Array, elsewhere: Array) -> UndecidedEnergy:
    """Return the energy of the undecided pixels.

    Parameters
    ----------
    whole : LabelCostEnergy
    labels : (H, W) int16
        ``UNDECIDED`` where it is open.
    elsewhere : (K,) bool
        Labels that decided pixels have.

    Returns
    -------
    UndecidedEnergy
    """
    numbered = _numbered(labels)
    around = _around(whole.weights, labels, numbered)
    unaries = _sparse_unaries(whole, labels, numbered, around)
    label_costs = np.where(elsewhere, 0, whole.label_costs)
    return UndecidedEnergy(
        numbered.pixels, labels.shape[1], unaries, around.neighbour, around.weight, label_costs, elsewhere
    )


@compiled
def energy_of_pixels(whole: LabelCostEnergy) -> LabelCostEnergy:
    """Expand an energy to a unary cost for each pixel, (K, H, W)."""
    height, width, side = whole.weights.shape[0], whole.weights.shape[1], whole.side
    boxes = whole.places * side
    spread = np.empty((whole.unary.shape[0], height, width), np.int32)
    for label in range(whole.unary.shape[0]):
        box = boxes[label]
        box[:2], box[2:] = np.minimum(box[:2], height), np.minimum(box[2:], width)
        for y in range(box[0], box[1]):
            own, costs = whole.unary[label, y // side], spread[label, y]
            for x in range(box[2], box[3]):
                costs[x] = own[x // side]
    for extra in whole.extras:
        spread[extra[0], extra[1], extra[2]] += extra[3]
    return LabelCostEnergy(spread, whole.weights, whole.label_costs, boxes, 1, whole.extras[:0])


class _Numbered(NamedTuple):
    """Numbering of the undecided pixels.

    Attributes
    ----------
    pixels : (n,) intp
        Flat indices in the image, ascending.
    row, column : (n,) intp, (n,) int32
    before_row : (H + 1,) intp
        How many of them precede each row.
    position : (H, W) int32
        How many precede each pixel; that is the number of an undecided one.
    """

    pixels: Array
    row: Array
    column: Array
    before_row: Array
    position: Array


class _Around(NamedTuple):
    """Neighbourhoods of the undecided pixels.

    Attributes
    ----------
    neighbour, weight : (n, 8) int32
        As of `UndecidedEnergy`.
    known : (n,) int16
        The label of their decided neighbours, ``_SEVERAL`` if these have different ones.
    saved : (n,) int32
        Sum of the weights to those neighbours.
    """

    neighbour: Array
    weight: Array
    known: Array
    saved: Array


@compiled
def _sparse_unaries(
    whole: LabelCostEnergy, labels: Array, numbered: _Numbered, around: _Around
) -> SparseUnaries:
    first = np.zeros(whole.unary.shape[0] + 1, np.int64)
    _count_entries(whole, numbered, first)
    pixel, cost = np.empty(first[-1], np.int32), np.empty(first[-1], np.int32)
    _write_entries(whole, labels, numbered, around, pixel, cost)
    for extra in whole.extras:
        y, x = extra[1], extra[2]
        if labels[y, x] == UNDECIDED:
            begin, end = first[extra[0]], first[extra[0] + 1]
            cost[begin + np.searchsorted(pixel[begin:end], numbered.position[y, x])] += extra[3]
    return SparseUnaries(first, pixel, cost)


@compiled
def _count_entries(whole: LabelCostEnergy, numbered: _Numbered, first: Array) -> None:
    """Count the entries of each label into ``first``, zeros, as running totals."""
    places, side = whole.places, whole.side
    for label in range(len(places)):
        first[label + 1] = first[label]
        left, right = places[label, 2] * side, places[label, 3] * side
        for y in range(places[label, 0] * side, min(places[label, 1] * side, numbered.position.shape[0])):
            first[label + 1] += _open_before(y, right, numbered) - _open_before(y, left, numbered)


@compiled
def _write_entries(
    whole: LabelCostEnergy, labels: Array, numbered: _Numbered, around: _Around, pixel: Array, cost: Array
) -> None:
    places, side, known, saved = whole.places, whole.side, around.known, around.saved
    cell_of = np.arange(labels.shape[1]) // side
    count = 0
    for label in range(len(places)):
        left, right = places[label, 2] * side, places[label, 3] * side
        for y in range(places[label, 0] * side, min(places[label, 1] * side, numbered.position.shape[0])):
            own = whole.unary[label, y // side]
            for i in range(_open_before(y, left, numbered), _open_before(y, right, numbered)):
                total = own[cell_of[numbered.column[i]]]
                # Up to a constant, agreeing with a decided neighbour saves the weight.
                total -= saved[i] if known[i] == label else np.int32(0)
                if known[i] == _SEVERAL:
                    total -= _saved_by(label, labels, whole.weights, y, numbered.column[i])
                pixel[count], cost[count] = i, total
                count += 1


@compiled
def _open_before(y: int, x: int, numbered: _Numbered) -> int:
    """Return how many undecided pixels precede a place in a row, or its end."""
    position = numbered.position
    return int(position[y, x] if x < position.shape[1] else numbered.before_row[y + 1])


@compiled
def _saved_by(label: int, labels: Array, weights: Array, y: int, x: int) -> int:
    """Sum the weights to a pixel's neighbours of one label."""
    saved = 0
    for k in range(8):
        v, u = y + NEIGHBOUR_OFFSETS[k, 0], x + NEIGHBOUR_OFFSETS[k, 1]
        if 0 <= v < labels.shape[0] and 0 <= u < labels.shape[1] and labels[v, u] == label:
            saved += weights[y, x, k] if k < 4 else weights[v, u, k - 4]
    return saved


@compiled
def cost_of_labels(unaries: SparseUnaries, labels: Array) -> Array:
    """Return the cost of each pixel's label, (n,) int32, for labels (n,) intp that they can have."""
    chosen = np.empty(labels.size, np.int32)
    for label in range(unaries.first.size - 1):
        for entry in range(unaries.first[label], unaries.first[label + 1]):
            p = np.uint64(unaries.pixel[entry])
            chosen[p] = unaries.cost[entry] if labels[p] == label else chosen[p]
    return chosen


@compiled
def _numbered(labels: Array) -> _Numbered:
    height, width = labels.shape
    pixels, row = np.empty(labels.size, np.intp), np.empty(labels.size, np.intp)
    column, position = np.empty(labels.size, np.int32), np.empty((height, width), np.int32)
    before_row, count = np.empty(height + 1, np.intp), 0
    for y in range(height):
        before_row[y] = count
        for x in range(width):
            position[y, x] = count
            if labels[y, x] == UNDECIDED:
                pixels[count], row[count], column[count] = y * width + x, y, x
                count += 1
    before_row[height] = count
    return _Numbered(pixels[:count], row[:count], column[:count], before_row, position)


@compiled
def _around(weights: Array, labels: Array, numbered: _Numbered) -> _Around:
    height, width = labels.shape
    rows, columns, position = numbered.row, numbered.column, numbered.position
    neighbour, weight = np.empty((rows.size, 8), np.int32), np.empty((rows.size, 8), np.int32)
    known, saved = np.empty(rows.size, np.int16), np.empty(rows.size, np.int32)
    # Flat unsigned indices, and no border check in the interior, halve the time.
    label_of, position_of, weights_of = labels.reshape(-1), position.reshape(-1), weights.reshape(-1, 4)
    for i in range(rows.size):
        y, x = rows[i], columns[i]
        pixel = y * width + x
        inside = 0 < y < height - 1 and 0 < x < width - 1
        only, total = np.int16(UNDECIDED), np.int32(0)
        for k in range(8):
            down, right = NEIGHBOUR_OFFSETS[k]
            if not inside and not (0 <= y + down < height and 0 <= x + right < width):
                neighbour[i, k], weight[i, k] = -1, 0
                continue
            other = np.uint64(pixel + down * width + right)
            w = weights_of[np.uint64(pixel), k] if k < 4 else weights_of[other, k - 4]
            label = label_of[other]
            if label == UNDECIDED and w > 0:
                neighbour[i, k], weight[i, k] = position_of[other], w
                continue
            # Expansions skip neighbours of weight 0.
            neighbour[i, k], weight[i, k] = -1, 0
            if w > 0:
                if only == UNDECIDED:
                    only = label
                elif only != label:
                    only = np.int16(_SEVERAL)
                total += w
        known[i], saved[i] = only, total
    return _Around(neighbour, weight, known, saved)


@compiled
def undecided_energy_of(rest: UndecidedEnergy, labels: Array) -> int:
    """Return the energy of a labelling (n,) intp of the undecided pixels."""
    total = cost_of_labels(rest.unaries, labels).astype(np.int64).sum()
    used = np.zeros(rest.label_costs.size, np.bool_)
    for p in range(labels.size):
        used[labels[p]] = True
        for k in range(4):  # these list each pair once
            q = rest.neighbour[p, k]
            if q >= 0 and labels[q] != labels[p]:
                total += rest.weight[p, k]
    return int(total + rest.label_costs[used].sum())
