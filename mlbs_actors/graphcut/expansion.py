"""One expansion move: find the pixels that best take a label (§7).

It is a minimum cut: of pixels alone by ``min_cut`` where no label is freed (:func:`free_expansion`). Where
one label could be freed of its cost, it is the better of two such cuts (:func:`freeing_expansion`); several
need a general graph (:func:`paid_expansion`).

Differs from the construction of Delong et al., in which the one node of a label cost has an edge to each of
thousands of pixels, a star on which the Boykov–Kolmogorov algorithm is slow. Here the pixels of one image row
are joined in a row node first; the minimum is the same.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import maxflow
import numpy as np

from mlbs_actors.graphcut.energy import UndecidedEnergy
from mlbs_actors.graphcut.min_cut import min_cut
from mlbs_actors.kernels.jit import compiled
from mlbs_actors.messages import Array

__all__ = ["free_expansion", "freeing_expansion", "may_free", "paid_expansion", "paid_for"]


@compiled
def free_expansion(
    rest: UndecidedEnergy, labels: Array, alpha: int, nodes: Array, price: Array
) -> tuple[Array, np.int64, Array]:
    """Find the pixels that best take a label if no label is freed of its cost.

    Parameters
    ----------
    rest : UndecidedEnergy
    labels : (n,) intp
        The current labelling.
    alpha : int
        Label position.
    nodes : (m,) intp
        Positions of the pixels that may take it.
    price : (m,) int64
        Cost of alpha less that of the pixel's own label.
    Returns
    -------
    moves : (m,) bool
        Which of the nodes take it.
    change : int
        Of the energy, without the cost of alpha itself: that is the same for all moves that move anything.
    left : (m,) int32
        Residual: no set of moves changes the energy by less than ``change`` plus the positive part of this at
        its nodes.
    """
    graph = _move_graph(rest, labels, alpha, nodes, price)
    flow, moves = min_cut(graph.surplus, graph.neighbour, graph.capacity)
    return moves, flow - graph.unmoved, graph.surplus


@compiled
def may_free(rest: UndecidedEnergy, labels: Array, nodes: Array, left: Array, paid: Array) -> bool:
    """Whether freeing labels of their cost could pay; else :func:`free_expansion` found the best moves.

    Parameters
    ----------
    rest, labels, nodes
        As for :func:`free_expansion`.
    left : (m,) int32
        As :func:`free_expansion` returns it.
    paid : (l,) int64
        The labels that have all their pixels among the nodes.

    Returns
    -------
    bool
        False if the residual at the pixels of each label already exceeds its cost.
    """
    missing = np.zeros(rest.label_costs.size, np.int64)
    missing[paid] = rest.label_costs[paid]
    for i in range(nodes.size):
        missing[labels[nodes[i]]] -= max(left[i], 0)
    return bool((missing > 0).any())


@compiled
def freeing_expansion(
    rest: UndecidedEnergy, labels: Array, alpha: int, nodes: Array, price: Array, label: int
) -> tuple[Array, np.int64]:
    """Find the pixels that best take a label if another one is freed of its cost by losing all pixels.

    Either some of that label's pixels stay, or all move and the others follow at their best.

    Parameters
    ----------
    rest, labels, alpha, nodes, price
        As for :func:`free_expansion`.
    label : int
        The other label, with all its pixels among the nodes.

    Returns
    -------
    moves : (m,) bool
    change : int
        As :func:`free_expansion` returns it, less the label's cost if it is saved.
    """
    some, change, left = free_expansion(rest, labels, alpha, nodes, price)
    moves = labels[nodes] == label
    if np.maximum(left[moves], 0).sum() >= rest.label_costs[label]:  # more than the others could make up for
        return some, change
    taken = labels.copy()
    change_of_all = -rest.label_costs[label]
    for i in np.flatnonzero(moves):
        taken[nodes[i]] = alpha
        change_of_all += price[i]
        for k in range(8):
            q = rest.neighbour[nodes[i], k]
            if q >= 0 and labels[q] == alpha:
                change_of_all -= rest.weight[nodes[i], k]
    others = np.flatnonzero(~moves)
    if others.size:
        followers, more, _ = free_expansion(rest, taken, alpha, nodes[others], price[others])
        moves[others] = followers
        change_of_all += more
    return (moves, change_of_all) if change_of_all < change else (some, change)


def paid_expansion(
    rest: UndecidedEnergy, labels: Array, alpha: int, nodes: Array, price: Array, paid: Array
) -> tuple[Array, int]:
    """Find the pixels that best take a label if labels without pixels are freed of their cost.

    Parameters
    ----------
    rest, labels, alpha, nodes, price
        As for :func:`free_expansion`.
    paid : (l,) int64
        Those labels, with all their pixels among the nodes (:func:`paid_for`).

    Returns
    -------
    moves : (m,) bool
    change : int
        As :func:`free_expansion` returns them.
    """
    graph = _move_graph(rest, labels, alpha, nodes, price)
    rows = rest.pixels[nodes] // rest.width
    members = [np.flatnonzero(labels[nodes] == label) for label in paid]
    groups = [
        (own, rows[own], int(rest.label_costs[label])) for own, label in zip(members, paid, strict=True)
    ]
    flow, on_sink_side = _cut_with_label_costs(graph, groups)
    return on_sink_side, flow - int(graph.unmoved) - int(rest.label_costs[paid].sum())


@compiled
def paid_for(labels: Array, nodes: Array, kept: Array) -> Array:
    """Return the nodes' labels that a move could free of their cost, ascending; ``kept`` as of
    :func:`~mlbs_actors.graphcut.persistency.movable`."""
    paid = np.zeros(kept.size, np.bool_)
    for i in range(nodes.size):
        paid[labels[nodes[i]]] = not kept[labels[nodes[i]]]
    return np.flatnonzero(paid)


class _MoveGraph(NamedTuple):
    """The graph of an expansion; the nodes on the sink's side of its minimum cut move.

    The lesser of both choices at each pixel is subtracted, as no cut can change it.

    Attributes
    ----------
    surplus : (m,) int32
        Cost of moving less that of staying.
    neighbour : (m, 8) int32
        Neighbours among the nodes, −1 where there is none.
    capacity : (m, 8) int32
        Of the edges to them.
    unmoved : int
        Cost if nothing moves.
    """

    surplus: Array
    neighbour: Array
    capacity: Array
    unmoved: np.int64


def _cut_with_label_costs(graph: _MoveGraph, groups: Sequence[tuple[Array, Array, int]]) -> tuple[int, Array]:
    """Return the minimum cut where each group of nodes has a cost unless all of it is on the sink's side.

    A group is its nodes, their image rows and its cost. Its edges: member → row node → hub → sink.
    """
    surplus, neighbour, capacity, _ = graph
    general = maxflow.GraphInt(surplus.size, 4 * surplus.size)
    ids = general.add_grid_nodes(surplus.shape)
    terminal = surplus.astype(np.int64)
    general.add_grid_tedges(ids, np.maximum(terminal, 0), np.maximum(-terminal, 0))
    for k in range(4):
        tails = np.flatnonzero(neighbour[:, k] >= 0)
        heads = neighbour[tails, k]
        general.add_edges(tails, heads, capacity[tails, k], capacity[heads, k + 4])
    for members, rows, cost in groups:
        distinct, of_member = np.unique(rows, return_inverse=True)
        row_nodes = general.add_grid_nodes(distinct.shape)
        hub = general.add_nodes(1)
        for tails, heads in ((members, row_nodes[of_member]), (row_nodes, np.repeat(hub, distinct.size))):
            general.add_edges(tails, heads, np.full(tails.size, cost), np.zeros(tails.size, np.int64))
        general.add_tedge(int(hub[0]), 0, cost)
    return int(general.maxflow()), general.get_grid_segments(ids)


@compiled
def _move_graph(rest: UndecidedEnergy, labels: Array, alpha: int, nodes: Array, price: Array) -> _MoveGraph:
    """Build the graph of an expansion.

    A pair costs w unless both ends move or, if they have the same label, both stay. With the same label it is
    a plain edge; with two labels it is w for p staying, and w for q staying while p moves, a directed edge.
    """
    local = np.full(labels.size, -1, np.int32)
    for i in range(nodes.size):
        local[nodes[i]] = i
    surplus = np.empty(nodes.size, np.int32)
    neighbour = np.full((nodes.size, 8), np.int32(-1))
    capacity = np.zeros((nodes.size, 8), np.int32)
    unmoved = np.int64(0)
    for i in range(nodes.size):
        p = nodes[i]
        stay, move = np.int64(0), price[i]
        for k in range(8):
            w = rest.weight[p, k]
            if w == 0:
                continue
            q = rest.neighbour[p, k]
            apart = w if labels[q] != labels[p] else np.int32(0)
            if local[q] < 0:
                stay += apart
                move += w if labels[q] != alpha else np.int32(0)
                continue
            # The first four neighbours list each pair once.
            directed = apart if k < 4 else np.int32(0)
            neighbour[i, k], capacity[i, k] = local[q], w - directed
            stay += directed
        surplus[i] = move - stay
        unmoved += max(stay - move, np.int64(0))
    return _MoveGraph(surplus, neighbour, capacity, unmoved)
