"""One expansion: of some pixels, those that best take a label (§7).

It is a minimum cut, of pixels alone by ``min_cut``; a label that could be got rid of needs a general graph.

Differs from the construction of Delong et al., in which one node a label cost has an edge to each of
thousands of pixels: on such a star the Boykov–Kolmogorov algorithm crawls. Here the pixels of one image row
meet in a row node first; the minimum is the same.
"""

from __future__ import annotations

from collections.abc import Sequence

import maxflow
import numpy as np
from numba import njit

from mlbs_actors.label_cost_energy import UndecidedEnergy
from mlbs_actors.messages import Array
from mlbs_actors.min_cut import min_cut

__all__ = ["expansion"]


def expansion(
    rest: UndecidedEnergy, labels: Array, alpha: int, nodes: Array, kept: Array
) -> tuple[Array, int]:
    """Find the pixels that best take a label.

    Parameters
    ----------
    rest : UndecidedEnergy
    labels : (n,) intp
        The labelling to expand in.
    alpha : int
        Label position.
    nodes : (m,) intp
        Positions of the pixels that may take it.
    kept : (K,) bool
        Labels that stay in use whatever moves, or cost nothing (:func:`~mlbs_actors.cut_pruning.movable`).

    Returns
    -------
    moved : (k,) intp
        Those of the nodes that take it.
    change : int
        Of the energy; the cost of alpha itself is not in the graph: it is the same for all moves that move
        anything.
    """
    if nodes.size == 0:
        return nodes, 0
    paid = _paid_for(labels, nodes, kept)
    if paid.size:
        surplus, neighbour, residual, unmoved = _move_graph(
            rest.unary, rest.neighbour, rest.weight, labels, alpha, nodes
        )
        members = [np.flatnonzero(labels[nodes] == label) for label in paid]
        groups = [
            (own, rest.row[nodes[own]], int(rest.label_costs[k]))
            for own, k in zip(members, paid, strict=True)
        ]
        flow, on_sink_side = _cut_with_label_costs(surplus, neighbour, residual, groups)
        moved = nodes[on_sink_side]
        change = int(flow - unmoved) - int(rest.label_costs[paid].sum())
    else:
        moved, difference = _cut(rest.unary, rest.neighbour, rest.weight, labels, alpha, nodes)
        change = int(difference)
    if not (rest.elsewhere[alpha] or (labels == alpha).any()):
        change += int(rest.label_costs[alpha])
    return moved, change


@njit(cache=True)
def _paid_for(labels: Array, nodes: Array, kept: Array) -> Array:
    """The nodes' labels that a move could free of their cost, ascending."""
    paid = np.zeros(kept.size, np.bool_)
    for i in range(nodes.size):
        paid[labels[nodes[i]]] = True
    return np.flatnonzero(paid & ~kept)


@njit(cache=True)
def _cut(
    unary: Array, neighbour: Array, weight: Array, labels: Array, alpha: int, nodes: Array
) -> tuple[Array, np.int64]:
    """The nodes that best take alpha, no label being freed, and the change of the energy."""
    surplus, near, capacity, unmoved = _move_graph(unary, neighbour, weight, labels, alpha, nodes)
    flow, moved = min_cut(surplus, near, capacity)
    return nodes[moved], flow - unmoved


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


@njit(cache=True)
def _move_graph(
    unary: Array, neighbour: Array, weight: Array, labels: Array, alpha: int, nodes: Array
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
    near, capacity = np.full((nodes.size, 8), -1, np.int32), np.zeros((nodes.size, 8), np.int32)
    unmoved = np.int64(0)
    for i in range(nodes.size):
        p = nodes[i]
        stay, move = unary[labels[p], p], unary[alpha, p]
        for k in range(8):
            q = neighbour[p, k]
            if q < 0:
                continue
            w = weight[p, k]
            same = labels[q] == labels[p]
            near[i, k] = local[q]
            if local[q] < 0:
                stay += 0 if same else w
                move += w if labels[q] != alpha else 0
            elif k < 4:
                capacity[i, k] = w if same else 0
                stay += 0 if same else w
            else:
                capacity[i, k] = w
        surplus[i] = move - stay
        unmoved += max(stay - move, 0)
    return surplus, near, capacity, unmoved
