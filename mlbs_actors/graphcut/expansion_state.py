"""The state of α-expansion: the labelling, and when each label was last expanded (§7).

Differs from the paper: an expansion is repeated only where a pixel or a neighbour has changed since; the last
one was the best there.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mlbs_actors.graphcut.energy import UndecidedEnergy, cost_of_labels
from mlbs_actors.graphcut.expansion import (
    free_expansion,
    freeing_expansion,
    may_free,
    paid_expansion,
    paid_for,
)
from mlbs_actors.graphcut.persistency import movable
from mlbs_actors.kernels.jit import compiled
from mlbs_actors.messages import Array

__all__ = ["ExpansionState", "begin", "expand", "is_settled"]


class ExpansionState(NamedTuple):
    """A labelling of n undecided pixels, and when each label was last expanded.

    Steps count the expansions that have changed the labelling; 0 is the start.

    Attributes
    ----------
    labels : (n,) intp
    chosen : (n,) int32
        Cost of each pixel's label.
    used : (K,) int64
        How many pixels have each label.
    lost_at : (K,) int64
        Step that last took a pixel from each label.
    changed_at : (n,) int32
        Step that gave each pixel its label.
    news_at : (n,) int32
        Step that last changed a pixel or a neighbour of it.
    came_from : (n,) intp
        Label before that step; −1 at the start.
    expanded_at : (K,) int64
        Step after which each label was last expanded; −1 if never.
    step : (1,) int64
        The last one.
    """

    labels: Array
    chosen: Array
    used: Array
    lost_at: Array
    changed_at: Array
    news_at: Array
    came_from: Array
    expanded_at: Array
    step: Array


@compiled
def begin(rest: UndecidedEnergy, labels: Array) -> ExpansionState:
    """Return the state before the first expansion of labels (n,) intp, which are modified later."""
    count = rest.label_costs.size
    used = np.zeros(count, np.int64)
    for label in labels:
        used[label] += 1
    return ExpansionState(
        labels,
        cost_of_labels(rest.unaries, labels),
        used,
        np.zeros(count, np.int64),
        np.zeros(labels.size, np.int32),
        np.zeros(labels.size, np.int32),
        np.full(labels.size, -1),
        np.full(count, -1),
        np.zeros(1, np.int64),
    )


def is_settled(state: ExpansionState) -> bool:
    """Whether no expansion would change the labelling any more."""
    return bool((state.expanded_at == state.step[0]).all())


def expand(rest: UndecidedEnergy, state: ExpansionState, alphas: Array) -> None:
    """Expand labels (k,) int64 cyclically; skip one if nothing has changed since its last expansion."""
    due_place = 0
    while True:
        due_place, nodes, price, paid = _expand_cyclically(rest, state, alphas, due_place)
        if due_place == alphas.size:
            return
        alpha = int(alphas[due_place])
        moves, change = paid_expansion(rest, state.labels, alpha, nodes, price, paid)
        _take(rest, state, alpha, nodes, price, moves, np.int64(change))
        due_place += 1


@compiled
def _expand_cyclically(
    rest: UndecidedEnergy, state: ExpansionState, alphas: Array, due_place: int
) -> tuple[int, Array, Array, Array]:
    """Expand labels until the next one could free several others of their costs.

    Returns
    -------
    due_place : int
        Position of that one; the number of labels if there is none.
    nodes, price, paid
        As :func:`~mlbs_actors.graphcut.expansion.paid_expansion` takes them.
    """
    for due in range(due_place, alphas.size):
        alpha = alphas[due]
        before = state.expanded_at[alpha]
        if before == state.step[0]:
            continue
        if before >= 0 and _nothing_new(rest, state, alpha):
            state.expanded_at[alpha] = state.step[0]
            continue
        nodes, price, kept = movable(rest, state.labels, state.chosen, state.used, alpha)
        # The cost of a label that is not used yet is shared by all parts of the move.
        if before >= 0 and (rest.label_costs[alpha] == 0 or state.used[alpha] > 0):
            worth = _worth_expanding(rest, state, alpha, nodes, kept)
            nodes, price = nodes[worth], price[worth]
        paid = paid_for(state.labels, nodes, kept)
        if paid.size > 1:
            moves, change, left = free_expansion(rest, state.labels, alpha, nodes, price)
            if may_free(rest, state.labels, nodes, left, paid):
                return due, nodes, price, paid
        elif paid.size:
            moves, change = freeing_expansion(rest, state.labels, alpha, nodes, price, paid[0])
        else:
            moves, change, _ = free_expansion(rest, state.labels, alpha, nodes, price)
        _take(rest, state, alpha, nodes, price, moves, change)
    nothing = np.empty(0, np.int64)
    return alphas.size, nothing, nothing, nothing


@compiled
def _take(
    rest: UndecidedEnergy, state: ExpansionState, alpha: int, nodes: Array, price: Array, moves: Array,
    change: np.int64,
) -> None:  # fmt: skip
    """Give alpha to the nodes that move, if that lowers the energy."""
    if state.used[alpha] == 0:
        change += rest.label_costs[alpha]
    if change < 0:
        state.step[0] += 1
        step = state.step[0]
        for i in range(nodes.size):
            if not moves[i]:
                continue
            p = nodes[i]
            label = state.labels[p]
            state.used[label] -= 1
            state.lost_at[label] = step
            state.came_from[p], state.labels[p] = label, alpha
            state.chosen[p] += price[i]
            state.changed_at[p], state.news_at[p] = step, step
            for k in range(8):
                if rest.neighbour[p, k] >= 0:
                    state.news_at[rest.neighbour[p, k]] = step
            state.used[alpha] += 1
    state.expanded_at[alpha] = state.step[0]


@compiled
def _nothing_new(rest: UndecidedEnergy, state: ExpansionState, alpha: int) -> bool:
    """Whether nothing has changed since a label's last expansion at the pixels that it could take, beside
    them, or in the labels that it could free of their cost."""
    before, used = state.expanded_at[alpha], state.used
    offered = np.zeros(used.size, np.int64)
    for p in rest.unaries.pixel[rest.unaries.first[alpha] : rest.unaries.first[alpha + 1]]:
        if state.labels[p] != alpha:
            if state.news_at[p] > before:
                return False
            offered[state.labels[p]] += 1
    for label in range(used.size):
        could_be_freed = rest.label_costs[label] > 0 and 0 < offered[label] == used[label]
        if could_be_freed and state.lost_at[label] > before:
            return False
    return True


@compiled
def _worth_expanding(
    rest: UndecidedEnergy, state: ExpansionState, alpha: int, nodes: Array, kept: Array
) -> Array:
    """Select the nodes (m,) bool in components that an expansion of alpha, which is in use, could improve.

    The gain of an expansion is the sum over the connected components of the moved pixels, if each label that
    it could free of its cost lies in one component. A component gains nothing if no pixel of it or beside it
    has changed since alpha's last expansion, nor if the very last change in and around it was an expansion
    that took all of it from alpha: that was optimal too, and could have left any of it. Both hold for freeing
    a label as well, unless it has lost pixels since, which makes freeing it easier.
    """
    before, labels, used = state.expanded_at[alpha], state.labels, state.used
    open_node = np.zeros(labels.size, np.bool_)
    open_node[nodes] = True
    worth = np.zeros(labels.size, np.bool_)
    part, inside = np.empty(nodes.size, np.intp), np.zeros(used.size, np.int64)
    for i in range(nodes.size):
        if not open_node[nodes[i]]:
            continue
        open_node[nodes[i]] = False
        part[0] = nodes[i]
        head, tail = 0, 1
        oldest = newest = state.changed_at[nodes[i]]
        from_alpha = True
        while head < tail:
            p = part[head]
            head += 1
            oldest = min(oldest, state.changed_at[p])
            newest = max(newest, state.news_at[p])
            from_alpha = from_alpha and state.came_from[p] == alpha
            inside[labels[p]] += 1
            for k in range(8):
                q = rest.neighbour[p, k]
                if q >= 0 and open_node[q]:
                    open_node[q] = False
                    part[tail] = q
                    tail += 1
        settled = newest <= before or (from_alpha and oldest == newest)
        for label in range(used.size):
            if inside[label] > 0 and not kept[label]:
                whole = inside[label] == used[label] and state.lost_at[label] <= max(newest, before)
                settled = settled and whole
            inside[label] = 0
        if not settled:
            worth[part[:tail]] = True
    return worth[nodes]
