"""A labelling on its way down: one expansion after the other (§7).

Differs from the paper: an expansion is tried again only where a pixel or a neighbour has changed since;
the last one was the best there.
"""

from __future__ import annotations

from dataclasses import dataclass

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

__all__ = ["Course", "expand_in_turn", "started"]


@dataclass(slots=True)
class Course:
    """A labelling on its way down, and when which expansion was tried.

    Attributes
    ----------
    labels : (n,) intp
    chosen : (n,) int32
        What each pixel pays for its label.
    used : (K,) int64
        How many pixels have each label.
    lost_at : (K,) int64
        Step that last took a pixel from each label; 0 at the start.
    energy : int
    step : int
        How many expansions have changed the labelling.
    changed_at : (n,) int32
        Step that gave each pixel its label; 0 at the start.
    news_at : (n,) int32
        Step that last changed a pixel or a neighbour of it; 0 at the start.
    came_from : (n,) intp
        Label before that step; −1 at the start.
    expanded_at : (K,) int64
        Step after which each label was last expanded; −1 if never.
    """

    labels: Array
    chosen: Array
    used: Array
    lost_at: Array
    energy: int
    step: int
    changed_at: Array
    news_at: Array
    came_from: Array
    expanded_at: Array

    @classmethod
    def starting(cls, rest: UndecidedEnergy, labels: Array) -> Course:
        """Before the first expansion of labels (n,) intp."""
        offers = rest.offers
        chosen, used, changed_at, news_at, came_from, expanded_at = started(
            offers.first, offers.pixel, offers.cost, rest.label_costs.size, labels
        )
        return cls(
            labels=labels,
            chosen=chosen,
            used=used,
            lost_at=np.zeros_like(used),
            energy=rest.energy(labels),
            step=0,
            changed_at=changed_at,
            news_at=news_at,
            came_from=came_from,
            expanded_at=expanded_at,
        )

    def expand(self, rest: UndecidedEnergy, alphas: Array) -> None:
        """One sweep; a label is left out if nothing has changed since its last expansion."""
        turn = 0
        while True:
            turn, self.step, self.energy, nodes, price, paid = expand_in_turn(
                alphas,
                turn,
                rest.offers.first,
                rest.offers.pixel,
                rest.offers.cost,
                rest.neighbour,
                rest.weight,
                rest.label_costs,
                self.labels,
                self.chosen,
                self.used,
                self.lost_at,
                self.changed_at,
                self.news_at,
                self.came_from,
                self.expanded_at,
                self.step,
                self.energy,
            )
            if turn == alphas.size:
                return
            alpha = alphas[turn]
            moves, change = paid_expansion(rest, self.labels, alpha, nodes, price, paid)
            if self.used[alpha] == 0:
                change += int(rest.label_costs[alpha])
            if change < 0:
                self.energy += change
                self.step += 1
                _take(
                    rest.neighbour,
                    self.labels,
                    self.chosen,
                    self.used,
                    self.lost_at,
                    self.changed_at,
                    self.news_at,
                    self.came_from,
                    self.step,
                    alpha,
                    nodes,
                    price,
                    moves,
                )
            self.expanded_at[alpha] = self.step
            turn += 1


@compiled
def started(
    first: Array, pixel: Array, cost: Array, label_count: int, labels: Array
) -> tuple[Array, Array, Array, Array, Array, Array]:
    """The fields of `Course` but the labels, which are given, ``lost_at``, the energy and the step."""
    chosen = cost_of_labels(first, pixel, cost, labels)
    used = np.zeros(label_count, np.int64)
    for label in labels:
        used[label] += 1
    changed_at, news_at = np.zeros(labels.size, np.int32), np.zeros(labels.size, np.int32)
    came_from, expanded_at = np.full(labels.size, -1), np.full(label_count, -1)
    return chosen, used, changed_at, news_at, came_from, expanded_at


@compiled
def expand_in_turn(
    alphas: Array, turn: int, first: Array, pixel: Array, cost: Array, neighbour: Array, weight: Array,
    label_costs: Array, labels: Array, chosen: Array, used: Array, lost_at: Array, changed_at: Array,
    news_at: Array, came_from: Array, expanded_at: Array, step: int, energy: int,
) -> tuple[int, int, int, Array, Array, Array]:  # fmt: skip
    """Expand labels until one is due that could free several of their costs: its turn, how the course stands,
    the pixels that may take it, what it costs them more, and those several."""
    for due in range(turn, alphas.size):
        alpha = alphas[due]
        if expanded_at[alpha] == step:
            continue
        own = slice(first[alpha], first[alpha + 1])
        before = expanded_at[alpha]
        if before >= 0 and _nothing_new(
            pixel[own], label_costs, labels, used, lost_at, news_at, before, alpha
        ):
            expanded_at[alpha] = step
            continue
        nodes, price, kept = movable(
            pixel[own], cost[own], chosen, neighbour, weight, label_costs, labels, used, alpha
        )
        # What must be bought anew is paid for by all its parts together.
        if before >= 0 and (label_costs[alpha] == 0 or used[alpha] > 0):
            worth = _worth_expanding(
                neighbour, kept, labels, used, lost_at, changed_at, news_at, came_from, before, alpha, nodes
            )
            nodes, price = nodes[worth], price[worth]
        paid = paid_for(labels, nodes, kept)
        if nodes.size:
            if paid.size > 1:
                moves, change, left = free_expansion(neighbour, weight, labels, alpha, nodes, price)
                if may_free(labels, nodes, left, paid, label_costs):
                    return due, step, energy, nodes, price, paid
            elif paid.size:
                moves, change = freeing_expansion(
                    neighbour, weight, labels, alpha, nodes, price, paid[0], label_costs[paid[0]]
                )
            else:
                moves, change, _ = free_expansion(neighbour, weight, labels, alpha, nodes, price)
            if used[alpha] == 0:
                change += label_costs[alpha]
            if change < 0:
                energy += int(change)
                step += 1
                _take(
                    neighbour,
                    labels,
                    chosen,
                    used,
                    lost_at,
                    changed_at,
                    news_at,
                    came_from,
                    step,
                    alpha,
                    nodes,
                    price,
                    moves,
                )
        expanded_at[alpha] = step
    nothing = np.empty(0, np.int64)
    return alphas.size, step, energy, nothing, nothing, nothing


@compiled
def _take(
    neighbour: Array, labels: Array, chosen: Array, used: Array, lost_at: Array, changed_at: Array,
    news_at: Array, came_from: Array, step: int, alpha: int, nodes: Array, price: Array, moves: Array,
) -> None:  # fmt: skip
    """Give the nodes that move the label alpha."""
    for i in range(nodes.size):
        if not moves[i]:
            continue
        p = nodes[i]
        used[labels[p]] -= 1
        lost_at[labels[p]] = step
        came_from[p], labels[p] = labels[p], alpha
        chosen[p] += price[i]
        changed_at[p], news_at[p] = step, step
        for k in range(8):
            if neighbour[p, k] >= 0:
                news_at[neighbour[p, k]] = step
        used[alpha] += 1


@compiled
def _nothing_new(
    candidates: Array, label_costs: Array, labels: Array, used: Array, lost_at: Array, news_at: Array,
    expanded_at: int, alpha: int,
) -> bool:  # fmt: skip
    """Whether nothing that a label could take has changed since its last expansion, nor what is beside it,
    nor what it could free of its cost."""
    offered = np.zeros(used.size, np.int64)
    for p in candidates:
        if labels[p] != alpha:
            if news_at[p] > expanded_at:
                return False
            offered[labels[p]] += 1
    for label in range(used.size):
        could_be_freed = label_costs[label] > 0 and 0 < offered[label] == used[label]
        if could_be_freed and lost_at[label] > expanded_at:
            return False
    return True


@compiled
def _worth_expanding(
    neighbour: Array, kept: Array, labels: Array, used: Array, lost_at: Array, changed_at: Array,
    news_at: Array, came_from: Array, expanded_at: int, alpha: int, nodes: Array,
) -> Array:  # fmt: skip
    """Nodes (m,) bool whose connected part an expansion of alpha, which is paid for, could still improve.

    What an expansion gains is the sum over the connected parts of what it moves, if each label that it could
    free of its cost lies in one part. A part gains nothing where no pixel of it or beside it has changed
    since alpha's last expansion, and nothing where the very last change in and around it was to take all of
    it from alpha: that was a best expansion too, which could have left any of it. Both hold for freeing a
    label as well, unless it has lost pixels since: then it might not have been freed so easily.
    """
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
        oldest, newest = changed_at[nodes[i]], changed_at[nodes[i]]
        from_alpha = True
        while head < tail:
            p = part[head]
            head += 1
            oldest = min(oldest, changed_at[p])
            newest = max(newest, news_at[p])
            from_alpha = from_alpha and came_from[p] == alpha
            inside[labels[p]] += 1
            for k in range(8):
                q = neighbour[p, k]
                if q >= 0 and open_node[q]:
                    open_node[q] = False
                    part[tail] = q
                    tail += 1
        settled = newest <= expanded_at or (from_alpha and oldest == newest)
        for label in range(used.size):
            if inside[label] > 0 and not kept[label]:
                whole = inside[label] == used[label] and lost_at[label] <= max(newest, expanded_at)
                settled = settled and whole
            inside[label] = 0
        if not settled:
            worth[part[:tail]] = True
    return worth[nodes]
