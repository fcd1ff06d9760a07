"""The energy of a labelling, of a whole image and of the pixels that are still open (§7).

E(L) = Σ_p U_p(l_p) + Σ_pq w_pq [l_p ≠ l_q] + Σ_k h_k δ_k(L), in integers of any unit. Where some pixels have
their label for good, the others have an energy of their own, into whose unary terms those neighbours are
folded.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from mlbs_actors.kernels.jit import compiled
from mlbs_actors.messages import Array

__all__ = [
    "NEIGHBOUR_OFFSETS",
    "UNDECIDED",
    "LabelCostEnergy",
    "Offers",
    "UndecidedEnergy",
    "cost_of_labels",
    "costs_of_pixels",
    "energy_of_labels",
    "left_open",
    "undecided_energy",
]

#: Label of a pixel that has none yet.
UNDECIDED = -1
#: Label of neighbours that do not have the same one.
_SEVERAL = -2

#: (dy, dx) of the eight neighbours; entry k + 4 is the opposite of entry k.
NEIGHBOUR_OFFSETS = np.array([(0, 1), (1, 0), (1, 1), (1, -1), (0, -1), (-1, 0), (-1, -1), (-1, 1)])


@dataclass(frozen=True, slots=True)
class LabelCostEnergy:
    """E(L) of an (H, W) image and K labels, in integers of any unit.

    Attributes
    ----------
    unary : (K, ⌈H / side⌉, ⌈W / side⌉) int32
        Cost of each label at each pixel of a cell, at most 2²⁴ in size.
    weights : (H, W, 4) int32
        Potts weight to the neighbour at ``NEIGHBOUR_OFFSETS[k]``, k < 4, in 0 … 2²⁴; 0 where it would be
        outside the image. C-contiguous.
    label_costs : (K,) int64
        Cost of using a label at all, ≥ 0.
    side : int
        Of the square cells whose pixels share their unary costs.
    extras : (n, 4) int64
        Label, row, column, and what is added to that label's unary cost at that pixel alone; the label can
        be there.
    places : (K, 4) int64, optional
        The box of cells that each label can have: first row, row past the last, first column, column past the
        last. Its costs elsewhere are never read. Everywhere by default.
    """

    unary: Array
    weights: Array
    label_costs: Array
    side: int = 1
    extras: Array = field(default_factory=lambda: np.zeros((0, 4), np.int64))
    places: Array | None = None

    def boxes(self) -> Array:
        """``places``, of all labels in any case."""
        if self.places is not None:
            return self.places
        return np.tile(
            np.array([0, self.unary.shape[1], 0, self.unary.shape[2]], np.int64), (len(self.unary), 1)
        )

    @property
    def arrays(self) -> tuple[Array, int, Array, Array, Array, Array]:
        """What kernels take of an energy, in their order: ``unary``, ``side``, ``extras``, ``places`` of all
        labels, ``weights`` and ``label_costs``."""
        return self.unary, self.side, self.extras, self.boxes(), self.weights, self.label_costs

    def of_pixels(self) -> LabelCostEnergy:
        """The same energy with a unary cost for each pixel, (K, H, W)."""
        if self.side == 1 and len(self.extras) == 0:
            return self
        height, width = self.weights.shape[:2]
        unary, places = costs_of_pixels(self.unary, self.side, self.extras, self.boxes(), height, width)
        return LabelCostEnergy(unary, self.weights, self.label_costs, places=places)

    def energy(self, labels: Array) -> int:
        """E(labels) of label positions (H, W) intp, each of which can be where it is."""
        used = np.bincount(labels.reshape(-1), minlength=self.label_costs.size) > 0
        pixel_terms = _image_energy(self.of_pixels().unary, self.weights, labels)
        return int(pixel_terms) + int(self.label_costs[used].sum())


@dataclass(frozen=True, slots=True)
class Offers:
    """What the undecided pixels can have: label by label, the pixels that can have it and what it costs them.

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

    def chosen(self, labels: Array) -> Array:
        """What each pixel pays for its label, (n,) int32, of labels (n,) intp that they can have."""
        return np.asarray(cost_of_labels(self.first, self.pixel, self.cost, labels))


@dataclass(frozen=True, slots=True)
class UndecidedEnergy:
    """The energy that is left on the n undecided pixels, up to a constant, in the unit of the whole.

    Attributes
    ----------
    pixels : (n,) intp
        Flat index in the image, ascending.
    row : (n,) intp
        Image row.
    offers : Offers
        Unary costs, with the pair terms to decided neighbours folded in.
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
    row: Array
    offers: Offers
    neighbour: Array
    weight: Array
    label_costs: Array
    elsewhere: Array

    def energy(self, labels: Array) -> int:
        """Energy of a labelling (n,) intp of the undecided pixels."""
        chosen = self.offers.chosen(labels)
        return int(energy_of_labels(chosen, self.neighbour, self.weight, self.label_costs, labels))


def undecided_energy(whole: LabelCostEnergy, labels: Array, elsewhere: Array) -> UndecidedEnergy:
    """The energy that is left where some pixels have their label.

    Parameters
    ----------
    whole : LabelCostEnergy
    labels : (H, W) int16
        ``UNDECIDED`` where it is open.
    elsewhere : (K,) bool
        Labels that the others hold.

    Returns
    -------
    UndecidedEnergy
    """
    pixels, row, offers, neighbour, weight, label_costs = left_open(*whole.arrays, labels, elsewhere)
    return UndecidedEnergy(pixels, row, Offers(*offers), neighbour, weight, label_costs, elsewhere)


@compiled
def _neighbour_and_weight(y: int, x: int, k: int) -> tuple[int, int, int, int, int]:
    """Row and column of a neighbour, and where the weight to it is found: row, column and direction."""
    v, u = y + NEIGHBOUR_OFFSETS[k, 0], x + NEIGHBOUR_OFFSETS[k, 1]
    if k < 4:
        return v, u, y, x, k
    return v, u, v, u, k - 4


@compiled
def left_open(
    unary: Array, side: int, extras: Array, places: Array, weights: Array, label_costs: Array, labels: Array,
    elsewhere: Array,
) -> tuple[Array, Array, tuple[Array, Array, Array], Array, Array, Array]:  # fmt: skip
    """The fields of `UndecidedEnergy` but the last."""
    pixels, begins, position = _numbered(labels)
    row, column = np.empty(pixels.size, np.intp), np.empty(pixels.size, np.int32)
    for y in range(labels.shape[0]):
        for i in range(begins[y], begins[y + 1]):
            row[i], column[i] = y, pixels[i] - y * labels.shape[1]
    neighbour, weight, known, saved = _around(weights, labels, position, row, column)
    offers = _offers(unary, side, extras, places, weights, labels, begins, column, known, saved, position)
    return pixels, row, offers, neighbour, weight, np.where(elsewhere, 0, label_costs)


@compiled
def costs_of_pixels(
    unary: Array, side: int, extras: Array, places: Array, height: int, width: int
) -> tuple[Array, Array]:
    """``unary`` and ``places`` of :meth:`LabelCostEnergy.of_pixels`, of (H, W) pixels."""
    boxes = places * side
    spread = np.empty((unary.shape[0], height, width), np.int32)
    for label in range(unary.shape[0]):
        box = boxes[label]
        box[:2], box[2:] = np.minimum(box[:2], height), np.minimum(box[2:], width)
        for y in range(box[0], box[1]):
            own, costs = unary[label, y // side], spread[label, y]
            for x in range(box[2], box[3]):
                costs[x] = own[x // side]
    for extra in range(extras.shape[0]):
        spread[extras[extra, 0], extras[extra, 1], extras[extra, 2]] += extras[extra, 3]
    return spread, boxes


@compiled
def _offers(
    unary: Array, side: int, extras: Array, places: Array, weights: Array, labels: Array, begins: Array,
    column: Array, known: Array, saved: Array, position: Array,
) -> tuple[Array, Array, Array]:  # fmt: skip
    """The fields of `Offers`; the last five as of :func:`_numbered` and :func:`_around`."""
    first = np.zeros(unary.shape[0] + 1, np.int64)
    _count_offers(side, places, begins, position, first)
    pixel, cost = np.empty(first[-1], np.int32), np.empty(first[-1], np.int32)
    cell_of = np.arange(labels.shape[1]) // side
    _write_offers(
        unary, side, places, weights, labels, begins, column, known, saved, position, cell_of, pixel, cost
    )
    for extra in range(extras.shape[0]):
        y, x = extras[extra, 1], extras[extra, 2]
        if labels[y, x] == UNDECIDED:
            i = position[y, x]
            begin, end = first[extras[extra, 0]], first[extras[extra, 0] + 1]
            cost[begin + np.searchsorted(pixel[begin:end], i)] += extras[extra, 3]
    return first, pixel, cost


@compiled
def _count_offers(side: int, places: Array, begins: Array, position: Array, first: Array) -> None:
    """``first`` of `Offers`, into zeros."""
    for label in range(len(places)):
        first[label + 1] = first[label]
        left, right = places[label, 2] * side, places[label, 3] * side
        for y in range(places[label, 0] * side, min(places[label, 1] * side, position.shape[0])):
            first[label + 1] += _open_before(y, right, position, begins)
            first[label + 1] -= _open_before(y, left, position, begins)


@compiled
def _write_offers(
    unary: Array, side: int, places: Array, weights: Array, labels: Array, begins: Array, column: Array,
    known: Array, saved: Array, position: Array, cell_of: Array, pixel: Array, cost: Array,
) -> None:  # fmt: skip
    """``pixel`` and ``cost`` of `Offers`; ``cell_of`` tells the cell of each column."""
    count = 0
    for label in range(len(places)):
        left, right = places[label, 2] * side, places[label, 3] * side
        for y in range(places[label, 0] * side, min(places[label, 1] * side, position.shape[0])):
            own = unary[label, y // side]
            for i in range(_open_before(y, left, position, begins), _open_before(y, right, position, begins)):
                total = own[cell_of[column[i]]]
                # Up to a constant, agreeing with a neighbour of known label saves the weight.
                total -= saved[i] if known[i] == label else np.int32(0)
                if known[i] == _SEVERAL:
                    total -= _saved_by(label, labels, weights, y, column[i])
                pixel[count], cost[count] = i, total
                count += 1


@compiled
def _open_before(y: int, x: int, position: Array, begins: Array) -> int:
    """How many undecided pixels come before a place in a row, or at its end, from what `_numbered` tells."""
    return int(position[y, x] if x < position.shape[1] else begins[y + 1])


@compiled
def _saved_by(label: int, labels: Array, weights: Array, y: int, x: int) -> int:
    """Sum of the weights to a pixel's neighbours of one label."""
    saved = 0
    for k in range(8):
        v, u, row, column, direction = _neighbour_and_weight(y, x, k)
        if 0 <= v < labels.shape[0] and 0 <= u < labels.shape[1] and labels[v, u] == label:
            saved += weights[row, column, direction]
    return saved


@compiled
def cost_of_labels(first: Array, pixel: Array, cost: Array, labels: Array) -> Array:
    """:meth:`Offers.chosen` from the fields of `Offers`."""
    chosen = np.empty(labels.size, np.int32)
    for label in range(first.size - 1):
        for entry in range(first[label], first[label + 1]):
            p = np.uint64(pixel[entry])
            chosen[p] = cost[entry] if labels[p] == label else chosen[p]
    return chosen


@compiled
def _numbered(labels: Array) -> tuple[Array, Array, Array]:
    """Flat indices of the undecided pixels, ascending; how many of them come before each row, (H + 1,), and
    before each pixel, (H, W) int32: that is the position of an undecided one."""
    height, width = labels.shape
    pixels, position = np.empty(labels.size, np.intp), np.empty((height, width), np.int32)
    begins, count = np.empty(height + 1, np.intp), 0
    for y in range(height):
        begins[y] = count
        for x in range(width):
            position[y, x] = count
            if labels[y, x] == UNDECIDED:
                pixels[count] = y * width + x
                count += 1
    begins[height] = count
    return pixels[:count], begins, position


@compiled
def _around(
    weights: Array, labels: Array, position: Array, rows: Array, columns: Array
) -> tuple[Array, Array, Array, Array]:
    """Neighbours (n, 8) of the undecided pixels among themselves, and the weights to them; the label of their
    decided neighbours, ``_SEVERAL`` if these differ, and the sum of the weights to those."""
    height, width = labels.shape
    neighbour, weight = np.empty((rows.size, 8), np.int32), np.empty((rows.size, 8), np.int32)
    known, saved = np.empty(rows.size, np.int16), np.empty(rows.size, np.int32)
    # Flat unsigned indices, and no look for the border in the interior: half the time.
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
            # Expansions look up no neighbour whose weight is 0.
            neighbour[i, k], weight[i, k] = -1, 0
            if w > 0:
                if only == UNDECIDED:
                    only = label
                elif only != label:
                    only = np.int16(_SEVERAL)
                total += w
        known[i], saved[i] = only, total
    return neighbour, weight, known, saved


@compiled
def _image_energy(unary: Array, weights: Array, labels: Array) -> np.int64:
    """Unary and pair terms; the first four neighbours name each pair once."""
    total = np.int64(0)
    height, width = labels.shape
    for y in range(height):
        for x in range(width):
            label = labels[y, x]
            total += unary[label, y, x]
            for k in range(4):
                w = weights[y, x, k]
                if w > 0 and labels[y + NEIGHBOUR_OFFSETS[k, 0], x + NEIGHBOUR_OFFSETS[k, 1]] != label:
                    total += w
    return total


@compiled
def energy_of_labels(
    chosen: Array, neighbour: Array, weight: Array, label_costs: Array, labels: Array
) -> np.int64:
    """:meth:`UndecidedEnergy.energy` from what the pixels pay for their labels, (n,) int32."""
    total = np.int64(0)
    used = np.zeros(label_costs.size, np.bool_)
    for p in range(labels.size):
        total += chosen[p]
        used[labels[p]] = True
        for k in range(4):  # they name each pair once
            q = neighbour[p, k]
            if q >= 0 and labels[q] != labels[p]:
                total += weight[p, k]
    for label in range(used.size):
        if used[label]:
            total += label_costs[label]
    return total
