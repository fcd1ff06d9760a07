"""Decides most pixels of a label-cost energy before any graph is built, without changing a single optimum.

For E(L) = Σ_p U_p(l_p) + Σ_pq w_pq [l_p ≠ l_q] + Σ_k h_k δ_k(L), let pixel p's best label b beat every other
label by ``gap``. Whatever its neighbours are, giving p the label b changes the pair terms by at most
W_p = Σ_q w_pq, so with *margin* = gap − W_p > 0 the label b is the better one, except that b may have to
be bought for h_b. Hence

* a label b is **certain** when the margins of the pixels that prefer b add up to more than h_b: a labelling
  without b would gain by giving all of them b at once, so every optimum uses b;
* a pixel of positive margin whose best label is certain has that label in every optimum: it is **decided**.
  (One pixel whose margin exceeds h_b makes b certain by itself, so no second rule is needed.)

A decided pixel q of label d lowers its neighbours' bar: U_p(d) and W_p both fall by w_pq, as the pair term
with a known label is a unary term. The test is repeated along a queue until nothing more can be decided.

What is left is an energy on the undecided pixels alone, with the decided neighbours folded into the unary
terms and the certain labels free of charge; its optima are those of the whole. Nor does an expansion move on
the whole image need a decided pixel: put back in the order of their decision, the decided pixels lower the
energy at each step. So where no expansion on the rest lowers the energy, none on the whole does.

The same argument with two choices, stay or move, keeps single expansions small (``movable``).

Differs from the paper: the paper cuts the whole pixel grid.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from mlbs_actors.messages import Array

__all__ = [
    "NEIGHBOUR_OFFSETS",
    "UNDECIDED",
    "LabelCostEnergy",
    "Pruning",
    "UndecidedEnergy",
    "movable",
    "prune",
]

#: Label of a pixel that the pruning could not decide.
UNDECIDED = -1

#: (dy, dx) of the eight neighbours; entry k + 4 is the opposite of entry k.
NEIGHBOUR_OFFSETS = np.array([(0, 1), (1, 0), (1, 1), (1, -1), (0, -1), (-1, 0), (-1, -1), (-1, 1)])


@dataclass(frozen=True, slots=True)
class LabelCostEnergy:
    """E(L) of an (H, W) image and K labels, in integers of any unit.

    Attributes
    ----------
    unary : (K, H, W) int32
        Cost of each label at each pixel, at most 2²⁴ in size.
    weights : (H, W, 4) int32
        Potts weight to the neighbour at ``NEIGHBOUR_OFFSETS[k]``, k < 4, in 0 … 2²⁴; 0 where it would be
        outside the image.
    label_costs : (K,) int64
        Cost of using a label at all, ≥ 0.
    """

    unary: Array
    weights: Array
    label_costs: Array

    def energy(self, labels: Array) -> int:
        """E(labels) of label positions (H, W) intp."""
        used = np.bincount(labels.reshape(-1), minlength=self.label_costs.size) > 0
        pixel_terms = _image_energy(self.unary, self.weights, labels)
        return int(pixel_terms) + int(self.label_costs[used].sum())


@dataclass(frozen=True, slots=True)
class UndecidedEnergy:
    """The energy that is left on the n undecided pixels, up to a constant, in the unit of the whole.

    Attributes
    ----------
    pixels : (n,) intp
        Flat index in the image, ascending.
    row : (n,) intp
        Image row.
    unary : (K, n) int32
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
    row: Array
    unary: Array
    neighbour: Array
    weight: Array
    label_costs: Array
    elsewhere: Array

    def used(self, labels: Array) -> Array:
        """(K,) bool: labels in use anywhere in the image, given those of the undecided pixels, (n,) intp."""
        in_use: Array = self.elsewhere | (np.bincount(labels, minlength=self.elsewhere.size) > 0)
        return in_use

    def energy(self, labels: Array) -> int:
        """Energy of a labelling (n,) intp of the undecided pixels."""
        pixel_terms = _energy(self.unary, self.neighbour, self.weight, labels)
        return int(pixel_terms) + int(self.label_costs[self.used(labels)].sum())


@dataclass(frozen=True, slots=True)
class Pruning:
    """What every optimum of an energy has in common, and the energy that is left.

    Attributes
    ----------
    labels : (H, W) intp
        Label position of the decided pixels, ``UNDECIDED`` elsewhere.
    rest : UndecidedEnergy
    """

    labels: Array
    rest: UndecidedEnergy


def prune(whole: LabelCostEnergy) -> Pruning:
    """Decide the pixels whose label can be proven locally to be the same in all optima.

    Parameters
    ----------
    whole : LabelCostEnergy

    Returns
    -------
    Pruning
    """
    width = whole.unary.shape[2]
    best, margin, evidence = _first_look(whole.unary, whole.weights)
    certain = evidence > whole.label_costs
    labels = np.where((margin > 0) & certain[best], best, UNDECIDED)
    pixels = np.flatnonzero(labels == UNDECIDED)
    folded, neighbour, weight, open_weight = _fold(whole.unary, whole.weights, labels, pixels)
    open_labels = _decide(
        folded,
        neighbour,
        weight,
        open_weight,
        best.reshape(-1)[pixels],
        margin.reshape(-1)[pixels],
        evidence,
        certain,
        whole.label_costs,
    )
    labels.reshape(-1)[pixels] = open_labels
    left = np.flatnonzero(open_labels == UNDECIDED)
    pixels = pixels[left]
    rest = UndecidedEnergy(
        pixels,
        pixels // width,
        *_compressed(folded, neighbour, weight, left),
        np.where(certain, 0, whole.label_costs),
        certain,
    )
    return Pruning(labels, rest)


def movable(rest: UndecidedEnergy, labels: Array, alpha: int) -> tuple[Array, Array]:
    """Pixels that a best expansion of ``alpha`` may take, and labels that it leaves in use.

    A pixel is left out when taking it costs more than its neighbours, those that can be at alpha, and the
    release of its own label can ever pay back: every move is better without it. Its neighbours then have one
    less to count on and its label stays in use, so the test is repeated.

    Parameters
    ----------
    rest : UndecidedEnergy
    labels : (n,) intp
        The labelling to expand in.
    alpha : int
        Label position.

    Returns
    -------
    pixels : (m,) intp
        Positions 0 … n−1, ascending.
    kept : (K,) bool
        Labels that keep a pixel in every best move, or cost nothing; alpha's own entry has no meaning.
    """
    pixels, kept = _movable(rest.unary, rest.neighbour, rest.weight, rest.label_costs, labels, alpha)
    return pixels, kept


@njit(cache=True)
def _best_and_margin(costs: Array, open_weight: np.int64) -> tuple[int, np.int64]:
    """First label of least cost, and by how much it beats the others beyond ``open_weight``."""
    best, least, second = 0, np.int64(costs[0]), np.int64(2**40)  # beyond every cost: there may be no other
    for label in range(1, costs.size):
        cost = np.int64(costs[label])
        if cost < least:
            best, least, second = label, cost, least
        elif cost < second:
            second = cost
    return best, second - least - open_weight


@njit(cache=True)
def _first_look(unary: Array, weights: Array) -> tuple[Array, Array, Array]:
    """Best label and margin of every pixel, and the positive margins' sum by best label."""
    label_count, height, width = unary.shape
    best = np.empty((height, width), np.intp)
    margin = np.empty((height, width), np.int64)
    evidence = np.zeros(label_count, np.int64)
    for y in range(height):
        for x in range(width):
            open_weight = np.int64(0)
            for k in range(4):
                open_weight += weights[y, x, k]
                y0, x0 = y - NEIGHBOUR_OFFSETS[k, 0], x - NEIGHBOUR_OFFSETS[k, 1]
                if y0 >= 0 and 0 <= x0 < width:
                    open_weight += weights[y0, x0, k]
            best[y, x], margin[y, x] = _best_and_margin(unary[:, y, x], open_weight)
            if margin[y, x] > 0:
                evidence[best[y, x]] += margin[y, x]
    return best, margin, evidence


@njit(cache=True)
def _fold(unary: Array, weights: Array, labels: Array, pixels: Array) -> tuple[Array, Array, Array, Array]:
    """The open pixels by themselves: unary (n, K) with decided neighbours folded in, neighbours, weights."""
    label_count, height, width = unary.shape
    count = pixels.size
    position = np.full((height, width), -1, np.int32)
    for i in range(count):
        position[pixels[i] // width, pixels[i] % width] = i
    folded = np.empty((count, label_count), np.int32)
    neighbour, weight = np.full((count, 8), -1, np.int32), np.zeros((count, 8), np.int32)
    open_weight = np.zeros(count, np.int64)
    for i in range(count):
        y, x = pixels[i] // width, pixels[i] % width
        for label in range(label_count):
            folded[i, label] = unary[label, y, x]
        for k in range(8):
            v, u = y + NEIGHBOUR_OFFSETS[k, 0], x + NEIGHBOUR_OFFSETS[k, 1]
            if not (0 <= v < height and 0 <= u < width):
                continue
            w = weights[y, x, k] if k < 4 else weights[v, u, k - 4]
            if labels[v, u] != UNDECIDED:
                folded[i, labels[v, u]] -= w
            elif w > 0:
                neighbour[i, k], weight[i, k] = position[v, u], w
                open_weight[i] += w
    return folded, neighbour, weight, open_weight


@njit(cache=True)
def _decide(
    folded: Array,
    neighbour: Array,
    weight: Array,
    open_weight: Array,
    best: Array,
    margin: Array,
    evidence: Array,
    certain: Array,
    label_costs: Array,
) -> Array:
    """Labels of the open pixels.

    All but the last argument are kept up to date: newly decided neighbours are folded in.
    """
    count = len(folded)
    for p in range(count):
        if margin[p] > 0:
            evidence[best[p]] -= margin[p]
        best[p], margin[p] = _best_and_margin(folded[p], open_weight[p])
        if margin[p] > 0:
            evidence[best[p]] += margin[p]
    labels = np.full(count, UNDECIDED, np.intp)
    queue = np.empty(count, np.intp)
    while True:
        certain |= evidence > label_costs
        head = tail = 0
        for p in range(count):
            if labels[p] == UNDECIDED and margin[p] > 0 and certain[best[p]]:
                labels[p] = best[p]
                queue[tail] = p
                tail += 1
        if tail == 0:
            return labels
        while head < tail:
            q = queue[head]
            head += 1
            label = labels[q]
            for k in range(8):
                p = neighbour[q, k]
                if p < 0 or labels[p] != UNDECIDED:
                    continue
                w = weight[q, k]
                if margin[p] > 0:
                    evidence[best[p]] -= margin[p]
                folded[p, label] -= w
                open_weight[p] -= w
                best[p], margin[p] = _best_and_margin(folded[p], open_weight[p])
                if margin[p] > 0:
                    evidence[best[p]] += margin[p]
                    if certain[best[p]]:
                        labels[p] = best[p]
                        queue[tail] = p
                        tail += 1


@njit(cache=True)
def _compressed(folded: Array, neighbour: Array, weight: Array, left: Array) -> tuple[Array, Array, Array]:
    """Unary (K, m), neighbours and weights (m, 8) of the open pixels that are left."""
    position = np.full(len(folded), -1, np.int32)
    for i in range(left.size):
        position[left[i]] = i
    unary = np.empty((folded.shape[1], left.size), np.int32)
    near, near_weight = np.full((left.size, 8), -1, np.int32), np.zeros((left.size, 8), np.int32)
    for i in range(left.size):
        unary[:, i] = folded[left[i]]
        for k in range(8):
            q = neighbour[left[i], k]
            if q >= 0 and position[q] >= 0:
                near[i, k], near_weight[i, k] = position[q], weight[left[i], k]
    return unary, near, near_weight


@njit(cache=True)
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


@njit(cache=True)
def _energy(unary: Array, neighbour: Array, weight: Array, labels: Array) -> np.int64:
    """Unary and pair terms; the first four neighbours name each pair once."""
    total = np.int64(0)
    for p in range(labels.size):
        total += unary[labels[p], p]
        for k in range(4):
            q = neighbour[p, k]
            if q >= 0 and labels[q] != labels[p]:
                total += weight[p, k]
    return total


@njit(cache=True)
def _movable(
    unary: Array, neighbour: Array, weight: Array, label_costs: Array, labels: Array, alpha: int
) -> tuple[Array, Array]:
    kept = label_costs == 0
    free = labels != alpha
    price = np.zeros(labels.size, np.int64)
    pixels = np.empty(labels.size, np.intp)
    count = 0
    # A first look with all neighbours at alpha leaves few pixels to look at closely.
    for p in range(labels.size):
        if not free[p]:
            continue
        label = labels[p]
        price[p] = np.int64(unary[alpha, p]) - unary[label, p]
        refund = np.int64(0) if kept[label] else label_costs[label]
        if price[p] > refund:
            for k in range(8):
                refund += weight[p, k]
            if price[p] > refund:
                free[p] = False
                kept[label] = True
                continue
        pixels[count] = p
        count += 1
    while True:
        left = 0
        for i in range(count):
            p = pixels[i]
            label = labels[p]
            # Beside a neighbour at alpha moving saves w; beside one that keeps p's own label it costs w.
            gain = np.int64(0) if kept[label] else label_costs[label]
            for k in range(8):
                q = neighbour[p, k]
                if q >= 0:
                    if free[q] or labels[q] == alpha:
                        gain += weight[p, k]
                    elif labels[q] == label:
                        gain -= weight[p, k]
            if price[p] > gain:
                free[p] = False
                kept[label] = True
            else:
                pixels[left] = p
                left += 1
        # A round that leaves out few is not worth another; stopping early only makes the graph larger.
        if 4 * (count - left) <= count:
            return pixels[:left], kept
        count = left
