"""Partial optimality: decides most pixels of a label-cost energy before any graph is built.

For E(L) = Σ_p U_p(l_p) + Σ_pq w_pq [l_p ≠ l_q] + Σ_k h_k δ_k(L), let pixel p's best label b beat every other
label by ``gap``. Whatever its neighbours' labels, giving p the label b changes the pair terms by at most W_p
= Σ_q w_pq, so with *margin* = gap − W_p > 0 the label b is better, except that b may not be in use and cost
h_b. Hence:

* a label b is **certain** when the margins of the pixels that prefer b add up to more than h_b: a labelling
  without b would gain by giving all of them b at once, so every optimum uses b;
* a pixel of positive margin whose best label is certain has that label in every optimum: it is **decided**.
  (One pixel whose margin exceeds h_b makes b certain by itself, so no second rule is needed.)

A decided pixel q of label d lowers its neighbours' threshold: U_p(d) and W_p both fall by w_pq, as the pair
term with a decided label is a unary term. The test is repeated along a queue until nothing more is decided.

What remains is an energy on the undecided pixels alone, with the decided neighbours folded into the unary
terms and the certain labels free of charge; its optima are those of the whole. Nor does an expansion move on
the whole image need a decided pixel: put back in the order of their decision, the decided pixels lower the
energy at each step. So where no expansion on the rest lowers the energy, none on the whole does.

The same argument with two choices, stay or move, keeps single expansions small (``movable``).

Differs from the paper: the paper cuts the whole pixel grid.
"""

from __future__ import annotations

import numpy as np

from mlbs_actors.graphcut.energy import (
    NEIGHBOUR_OFFSETS,
    UNDECIDED,
    LabelCostEnergy,
    UndecidedEnergy,
    undecided_energy,
)
from mlbs_actors.kernels.jit import compiled
from mlbs_actors.messages import Array

__all__ = ["movable", "prune"]


def prune(whole: LabelCostEnergy) -> tuple[Array, UndecidedEnergy]:
    """Decide the pixels whose label can be proven locally to be the same in all optima.

    Parameters
    ----------
    whole : LabelCostEnergy
        Of single pixels: ``side`` is 1, and there are no extras.

    Returns
    -------
    labels : (H, W) int16
        Label position of the decided pixels, ``UNDECIDED`` elsewhere.
    rest : UndecidedEnergy
        The energy of the others.
    """
    labels, certain = _decide(whole)
    return labels, undecided_energy(whole, labels, certain)


@compiled
def _decide(whole: LabelCostEnergy) -> tuple[Array, Array]:
    """Return labels, and which of them are certain."""
    unary, places, weights, label_costs = whole.unary, whole.places, whole.weights, whole.label_costs
    label_count, height, width = unary.shape
    best = np.zeros((height, width), np.int32)
    # Larger than every cost, in case there is no other label.
    least = np.full((height, width), 2**29, np.int32)
    second = np.full((height, width), 2**29, np.int32)
    folded = np.empty_like(unary)
    _compare_costs(unary, places, folded, best, least, second)
    # The sum of weights to undecided neighbours; the margin is gap − open weight.
    open_weight = np.zeros((height, width), np.int32)
    _sum_weights(weights, open_weight)

    labels = np.full((height, width), UNDECIDED, np.int16)
    certain = np.zeros(label_count, np.bool_)
    queue = np.empty(height * width, np.int32)
    label_of, best_of, open_weight_of = labels.reshape(-1), best.reshape(-1), open_weight.reshape(-1)
    least_of, second_of, weights_of = least.reshape(-1), second.reshape(-1), weights.reshape(-1, 4)
    while True:
        evidence = np.zeros(label_count, np.int64)
        for pixel in range(labels.size):
            evidence[best_of[pixel]] += max(second_of[pixel] - least_of[pixel] - open_weight_of[pixel], 0)
        newly_certain = ~certain & (evidence > label_costs)
        if not newly_certain.any():
            break
        certain |= newly_certain
        head = tail = 0
        for pixel in range(labels.size):
            margin = second_of[pixel] - least_of[pixel] - open_weight_of[pixel]
            if label_of[pixel] == UNDECIDED and margin > 0 and certain[best_of[pixel]]:
                label_of[pixel], queue[tail] = best_of[pixel], pixel
                tail += 1
        while head < tail:
            pixel = int(queue[head])
            y = pixel // width
            x = pixel - y * width
            head += 1
            label = label_of[pixel]
            top, bottom, left, right = places[label]
            inside = 0 < y < height - 1 and 0 < x < width - 1
            for k in range(8):
                down, across = NEIGHBOUR_OFFSETS[k]
                v, u = y + down, x + across
                if not inside and not (0 <= v < height and 0 <= u < width):
                    continue
                other = np.uint64(pixel + down * width + across)
                if label_of[other] != UNDECIDED:
                    continue
                w = weights_of[np.uint64(pixel), k] if k < 4 else weights_of[other, k - 4]
                open_weight_of[other] -= w
                if top <= v < bottom and left <= u < right:
                    folded[label, v, u] -= w
                    cost = folded[label, v, u]
                    if label == best_of[other]:
                        least_of[other] = cost
                    elif cost < least_of[other]:
                        best_of[other], second_of[other], least_of[other] = label, least_of[other], cost
                    elif cost < second_of[other]:
                        second_of[other] = cost
                margin = second_of[other] - least_of[other] - open_weight_of[other]
                if margin > 0 and certain[best_of[other]]:
                    label_of[other], queue[tail] = best_of[other], other
                    tail += 1

    return labels, certain


@compiled
def _compare_costs(
    unary: Array, places: Array, folded: Array, best: Array, least: Array, second: Array
) -> None:
    """Copy the costs of labels where they are allowed; find the cheapest label and the two least costs."""
    for label in range(len(places)):
        top, bottom, left, right = places[label]
        for y in range(top, bottom):
            costs, copied = unary[label, y], folded[label, y]
            best_of, least_of, second_of = best[y], least[y], second[y]
            for x in range(left, right):  # branch-free, hence vectorised
                at = np.uint64(x)
                cost, lowest = costs[at], least_of[at]
                copied[at] = cost
                best_of[at] = label if cost < lowest else best_of[at]
                second_of[at] = lowest if cost < lowest else min(second_of[at], cost)
                least_of[at] = min(cost, lowest)


@compiled
def _sum_weights(weights: Array, total: Array) -> None:
    """Add the weights to all neighbours of each pixel, (H, W) int32, to zeros."""
    height, width = total.shape
    flat = weights.reshape(-1)
    for y in range(height):
        own, first = total[y], 4 * y * width
        for x in range(width):
            at = np.uint64(first + 4 * x)
            own[np.uint64(x)] += (
                flat[at] + flat[at + np.uint64(1)] + flat[at + np.uint64(2)] + flat[at + np.uint64(3)]
            )
        for k in range(4):  # they are 0 outside the image
            down, right = NEIGHBOUR_OFFSETS[k]
            if y + down == height:
                continue
            others = total[y + down]
            for x in range(max(0, -right), min(width, width - right)):
                others[np.uint64(x + right)] += flat[np.uint64(first + 4 * x + k)]


@compiled
def movable(
    rest: UndecidedEnergy, labels: Array, chosen: Array, used: Array, alpha: int
) -> tuple[Array, Array, Array]:
    """Find the pixels that a best expansion of ``alpha`` may take, and the labels that it leaves in use.

    A pixel is left out when taking it costs more than its neighbours that can be at alpha, and the release of
    its own label, can ever make up for: every move is better without it. Its neighbours then have one less to
    count on and its label stays in use, so the test is repeated.

    Parameters
    ----------
    rest : UndecidedEnergy
    labels : (n,) intp
        The current labelling.
    chosen : (n,) int32
        Cost of each pixel's label.
    used : (K,) int64
        How many pixels have each label.
    alpha : int
        Label position.

    Returns
    -------
    pixels : (m,) intp
        Positions 0 … n−1, ascending.
    price : (m,) int64
        Cost of alpha less that of the pixel's own label.
    kept : (K,) bool
        Labels that keep a pixel in every best move, or have no cost; alpha's own entry is meaningless.
    """
    own = slice(rest.unaries.first[alpha], rest.unaries.first[alpha + 1])
    candidates, costs = rest.unaries.pixel[own], rest.unaries.cost[own]
    neighbour, weight = rest.neighbour, rest.weight
    # Saved if none of a label's pixels stays; 0 as soon as one does.
    in_rest = np.zeros(used.size, np.int64)
    for p in candidates:
        in_rest[labels[p]] += 1
    refund = np.where(in_rest == used, rest.label_costs, 0)
    # The labels if all pixels that still can move.
    moved = labels.copy()
    price, pixels = np.empty(candidates.size, np.int64), np.empty(candidates.size, np.intp)
    count = 0
    for i in range(candidates.size):  # an optimistic first test, as if all neighbours were at alpha
        p = candidates[i]
        label, cost = labels[p], np.int64(costs[i]) - chosen[p]
        if label == alpha:
            continue
        gain = refund[label]
        for k in range(8):
            gain += weight[p, k]
        if cost > gain:
            refund[label] = 0
            continue
        moved[p] = alpha
        pixels[count], price[count] = p, cost
        count += 1
    while True:
        left = 0
        for i in range(count):
            p, cost = pixels[i], price[i]
            label = labels[p]
            gain = refund[label]
            # Beside a neighbour at alpha moving saves w; beside one that keeps p's own label it costs w.
            for k in range(8):
                if weight[p, k] > 0:
                    beside = moved[neighbour[p, k]]
                    gain += weight[p, k] if beside == alpha else 0
                    gain -= weight[p, k] if beside == label else 0
            if cost > gain:
                refund[label] = 0
                moved[p] = label
                continue
            pixels[left], price[left] = p, cost
            left += 1
        # Stop after a round that leaves out few: that only makes the graph larger.
        if 4 * (count - left) <= count:
            return pixels[:left], price[:left], refund == 0
        count = left
