"""One expansion: of some pixels, those that best take a label (§7).

It is a minimum cut: of pixels alone by ``min_cut`` where all labels stay paid for (:func:`free_expansion`).
Where one label could be got rid of, it is the better of two such cuts (:func:`freeing_expansion`); several
need a general graph (:func:`paid_expansion`).

Differs from the construction of Delong et al., in which one node a label cost has an edge to each of
thousands of pixels: on such a star the Boykov–Kolmogorov algorithm crawls. Here the pixels of one image row
meet in a row node first; the minimum is the same.
"""

from __future__ import annotations

from collections.abc import Sequence

import maxflow
import numpy as np

from mlbs_actors.graphcut.energy import UndecidedEnergy
from mlbs_actors.graphcut.min_cut import min_cut
from mlbs_actors.kernels.jit import compiled
from mlbs_actors.kernels.simd import (
    broadcast,
    gathered,
    load_int32,
    shifted,
    store,
    sum_of_lanes,
    where_equal,
)
from mlbs_actors.messages import Array

__all__ = ["free_expansion", "freeing_expansion", "may_free", "paid_expansion", "paid_for"]


@compiled
def free_expansion(
    neighbour: Array, weight: Array, labels: Array, alpha: int, nodes: Array, price: Array
) -> tuple[Array, np.int64, Array]:
    """Find the pixels that best take a label, no label being freed of its cost.

    Parameters
    ----------
    neighbour, weight : (n, 8) int32
        As of :class:`~mlbs_actors.graphcut.energy.UndecidedEnergy`.
    labels : (n,) intp
        The labelling to expand in.
    alpha : int
        Label position.
    nodes : (m,) intp
        Positions of the pixels that may take it.
    price : (m,) int64
        What alpha costs each of them more than its own label.

    Returns
    -------
    moves : (m,) bool
        Which of the nodes take it.
    change : int
        Of the energy; the cost of alpha itself is not in the graph: it is the same for all moves that move
        anything.
    left : (m,) int32
        No set of nodes changes the energy by less than ``change`` and what of this is positive at its nodes.
    """
    surplus, near, capacity, unmoved = _move_graph(neighbour, weight, labels, alpha, nodes, price)
    flow, moves = min_cut(surplus, near, capacity)
    return moves, flow - unmoved, surplus


@compiled
def may_free(labels: Array, nodes: Array, left: Array, paid: Array, label_costs: Array) -> bool:
    """Whether it could pay to free labels of their cost; else :func:`free_expansion` found the best moves.

    Parameters
    ----------
    labels, nodes
        As for :func:`free_expansion`.
    left : (m,) int32
        As it returns it.
    paid : (l,) int64
        The labels, of which all pixels are among the nodes.
    label_costs : (K,) int64

    Returns
    -------
    bool
        False if already what is left at its pixels makes up for the cost of each of them.
    """
    missing = np.zeros(label_costs.size, np.int64)
    missing[paid] = label_costs[paid]
    for i in range(nodes.size):
        missing[labels[nodes[i]]] -= max(left[i], 0)
    return bool((missing > 0).any())


@compiled
def freeing_expansion(
    neighbour: Array,
    weight: Array,
    labels: Array,
    alpha: int,
    nodes: Array,
    price: Array,
    label: int,
    label_cost: int,
) -> tuple[Array, np.int64]:
    """Find the pixels that best take a label, where one other label costs nothing any more without pixels.

    Either not all of that label's pixels move, or all do and the others follow as they like.

    Parameters
    ----------
    neighbour, weight, labels, alpha, nodes, price
        As for :func:`free_expansion`.
    label, label_cost : int
        The label, of which all pixels are among the nodes, and what it costs.

    Returns
    -------
    moves : (m,) bool
    change : int
        As :func:`free_expansion` returns them, with the label's cost if it is saved.
    """
    some, change, left = free_expansion(neighbour, weight, labels, alpha, nodes, price)
    moves = labels[nodes] == label
    if np.maximum(left[moves], 0).sum() >= label_cost:  # more than the others could ever pay back
        return some, change
    taken = labels.copy()
    change_of_all = -np.int64(label_cost)
    for i in np.flatnonzero(moves):
        taken[nodes[i]] = alpha
        change_of_all += price[i]
        for k in range(8):
            q = neighbour[nodes[i], k]
            if q >= 0 and labels[q] == alpha:
                change_of_all -= weight[nodes[i], k]
    others = np.flatnonzero(~moves)
    if others.size:
        followers, more, _ = free_expansion(neighbour, weight, taken, alpha, nodes[others], price[others])
        moves[others] = followers
        change_of_all += more
    return (moves, change_of_all) if change_of_all < change else (some, change)


def paid_expansion(
    rest: UndecidedEnergy, labels: Array, alpha: int, nodes: Array, price: Array, paid: Array
) -> tuple[Array, int]:
    """Find the pixels that best take a label, where labels that lose all their pixels cost nothing any more.

    Parameters
    ----------
    rest : UndecidedEnergy
    labels, alpha, nodes, price
        As for :func:`free_expansion`.
    paid : (l,) int64
        Those labels, of which all pixels are among the nodes (:func:`paid_for`).

    Returns
    -------
    moves : (m,) bool
    change : int
        As :func:`free_expansion` returns them.
    """
    surplus, neighbour, residual, unmoved = _move_graph(
        rest.neighbour, rest.weight, labels, alpha, nodes, price
    )
    members = [np.flatnonzero(labels[nodes] == label) for label in paid]
    groups = [
        (own, rest.row[nodes[own]], int(rest.label_costs[k])) for own, k in zip(members, paid, strict=True)
    ]
    flow, on_sink_side = _cut_with_label_costs(surplus, neighbour, residual, groups)
    return on_sink_side, int(flow - unmoved) - int(rest.label_costs[paid].sum())


@compiled
def paid_for(labels: Array, nodes: Array, kept: Array) -> Array:
    """The nodes' labels that a move could free of their cost, ascending; ``kept`` as of
    :func:`~mlbs_actors.graphcut.persistency.movable`."""
    paid = np.zeros(kept.size, np.bool_)
    for i in range(nodes.size):
        paid[labels[nodes[i]]] = not kept[labels[nodes[i]]]
    return np.flatnonzero(paid)


def _cut_with_label_costs(
    surplus: Array, neighbour: Array, residual: Array, groups: Sequence[tuple[Array, Array, int]]
) -> tuple[np.int64, Array]:
    """The minimum cut where each group of nodes is charged for unless all of it is on the sink's side.

    A group's nodes, their image rows and its cost are given. Its edges: member → row node → hub → sink.
    """
    graph = maxflow.GraphInt(surplus.size, 4 * surplus.size)
    ids = graph.add_grid_nodes(surplus.shape)
    terminal = surplus.astype(np.int64)
    graph.add_grid_tedges(ids, np.maximum(terminal, 0), np.maximum(-terminal, 0))
    for k in range(4):
        tails = np.flatnonzero(neighbour[:, k] >= 0)
        heads = neighbour[tails, k]
        graph.add_edges(tails, heads, residual[tails, k], residual[heads, k + 4])
    for members, rows, cost in groups:
        distinct, of_member = np.unique(rows, return_inverse=True)
        row_nodes = graph.add_grid_nodes(distinct.shape)
        hub = graph.add_nodes(1)
        for tails, heads in ((members, row_nodes[of_member]), (row_nodes, np.repeat(hub, distinct.size))):
            graph.add_edges(tails, heads, np.full(tails.size, cost), np.zeros(tails.size, np.int64))
        graph.add_tedge(int(hub[0]), 0, cost)
    return np.int64(graph.maxflow()), graph.get_grid_segments(ids)


@compiled
def _move_graph(
    neighbour: Array, weight: Array, labels: Array, alpha: int, nodes: Array, price: Array
) -> tuple[Array, Array, Array, np.int64]:
    """What moving costs over staying (m,), neighbours among the m nodes and capacities to them (m, 8), and
    the cost if nothing moves.

    That cost leaves out the least of both choices at each pixel, which no cut can change. A pair costs w
    unless both ends move or, if they have the same label, both stay. With the same label it is a plain edge;
    with two labels it is w for p staying, and w for q staying while p moves, a directed edge.
    """
    local = np.full(labels.size, -1, np.int32)
    for i in range(nodes.size):
        local[nodes[i]] = i
    surplus = np.empty(nodes.size, np.int32)
    near, capacity = np.empty((nodes.size, 8), np.int32), np.empty((nodes.size, 8), np.int32)
    ends, weights = neighbour.reshape(-1), weight.reshape(-1)
    near_of, capacity_of = near.reshape(-1), capacity.reshape(-1)
    nothing, outside = broadcast(np.int32(0), 8), broadcast(np.int32(-1), 8)
    moving = broadcast(np.int32(alpha), 8)
    naming = shifted(broadcast(np.int32(1), 8), nothing, 4)  # the first four neighbours name each pair once
    unmoved = np.int64(0)
    # All neighbours of a pixel at once: which of them are nodes or have its label, nobody can foretell.
    for i in range(nodes.size):
        p = np.uint64(nodes[i])
        first, to = np.uint64(8) * p, np.uint64(8 * i)
        w = load_int32(weights, first, 8)
        others = where_equal(w, nothing, nothing, load_int32(ends, first, 8))
        beside = gathered(labels, others)
        inside = where_equal(w, nothing, outside, gathered(local, others))
        apart = where_equal(beside, broadcast(np.int32(labels[p]), 8), nothing, w)
        directed = apart * naming
        store(near_of, to, inside)
        store(capacity_of, to, where_equal(inside, outside, nothing, w - directed))
        stay = np.int64(sum_of_lanes(where_equal(inside, outside, apart, directed)))
        alone = where_equal(inside, outside, where_equal(beside, moving, nothing, w), nothing)
        move = price[i] + sum_of_lanes(alone)
        surplus[i] = move - stay
        unmoved += max(stay - move, 0)
    return surplus, near, capacity, unmoved
