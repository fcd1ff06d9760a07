"""A small graph that stands for a large one: nodes that belong together anyway are joined, pair by pair.

Each round joins every node with the neighbour that it shares most of its affinity with, if both are tied to
each other about as closely as to their closest neighbours. Joined nodes sum their edges, so that a cut of
the small graph costs what it costs in the large one. Multilevel graph partitioning works alike (Dhillon,
Guan, Kulis, PAMI 2007), but it also joins across weak edges where nothing better is left; here that would
hide the borders that are looked for.
"""

from __future__ import annotations

import numpy as np

from mlbs_actors.compilation import compiled
from mlbs_actors.messages import Array

__all__ = ["coarsen"]

#: Two nodes are joined if the mean affinity between them is at least this share of the best that either has;
#: when that joins no more, the next.
CLOSENESS = (0.7, 0.5, 0.3)
#: A round that leaves more than this share of the nodes is the last of its closeness.
WORTHWHILE = 0.95


def coarsen(pointers: Array, neighbours: Array, weights: Array, most: int) -> tuple[Array, Array]:
    """Join nodes as long as some belong together.

    Parameters
    ----------
    pointers, neighbours, weights : (n + 1,) int32, (e,) int32, (e,) float64
        Compressed rows of the affinities, a symmetric matrix without a diagonal, none of them negative.
    most : int
        Most nodes that one may stand for, ≥ 1.

    Returns
    -------
    group : (n,) int32
        Node of the small graph that each belongs to, 0 … m−1.
    joined : (m, m) float64
        Sums of the affinities between the groups; on the diagonal within them, every edge twice.
    """
    count = len(pointers) - 1
    group = np.arange(count, dtype=np.int32)
    sizes, within = np.ones(count, np.int32), np.zeros(count)
    edges = np.ones(len(weights), np.int32)
    for closeness in CLOSENESS:
        while most > 1:
            parent, left = _match(pointers, neighbours, weights, edges, sizes, most, closeness)
            if left > WORTHWHILE * len(sizes):
                break
            pointers, neighbours, weights, edges, sizes, within = _contract(
                pointers, neighbours, weights, edges, sizes, within, parent, left
            )
            group = parent[group]
    return group, _dense(pointers, neighbours, weights, within)


@compiled()
def _dense(pointers: Array, neighbours: Array, weights: Array, within: Array) -> Array:
    matrix = np.zeros((within.size, within.size))
    for node in range(within.size):
        matrix[node, node] = within[node]
        for e in range(pointers[node], pointers[node + 1]):
            matrix[node, neighbours[e]] = weights[e]
    return matrix


@compiled()
def _match(
    pointers: Array, neighbours: Array, weights: Array, edges: Array, sizes: Array, most: int,
    closeness: float,
) -> tuple[Array, int]:  # fmt: skip
    """Node of the next graph for each node, and their number; ``edges`` says how many an edge stands for."""
    count = sizes.size
    closest, volume = np.zeros(count), np.zeros(count)
    for node in range(count):
        for e in range(pointers[node], pointers[node + 1]):
            closest[node] = max(closest[node], weights[e] / edges[e])
            volume[node] += weights[e]
    parent = np.full(count, -1, np.int32)
    left = 0
    for node in range(count):
        if parent[node] >= 0:
            continue
        best, partner = 0.0, -1
        for e in range(pointers[node], pointers[node + 1]):
            other = neighbours[e]
            mean = weights[e] / edges[e]
            if (
                parent[other] < 0
                and sizes[node] + sizes[other] <= most
                and mean >= closeness * max(closest[node], closest[other])
            ):
                share = weights[e] / volume[node] + weights[e] / volume[other]
                if share > best:
                    best, partner = share, other
        parent[node] = left
        if partner >= 0:
            parent[partner] = left
        left += 1
    return parent, left


@compiled()
def _contract(
    pointers: Array, neighbours: Array, weights: Array, edges: Array, sizes: Array, within: Array,
    parent: Array, left: int,
) -> tuple[Array, Array, Array, Array, Array, Array]:  # fmt: skip
    """The next graph: parallel edges summed, those inside a node added to ``within``."""
    members = np.full((left, 2), -1, np.int32)
    new_sizes, new_within = np.zeros(left, np.int32), np.zeros(left)
    for node in range(sizes.size):
        joined = parent[node]
        members[joined, 1 if members[joined, 0] >= 0 else 0] = node
        new_sizes[joined] += sizes[node]
        new_within[joined] += within[node]
    new_pointers = np.zeros(left + 1, pointers.dtype)
    new_neighbours = np.empty(neighbours.size, neighbours.dtype)
    new_weights, new_edges = np.empty(neighbours.size), np.empty(neighbours.size, np.int32)
    place = np.full(left, -1, np.int64)
    used = 0
    for joined in range(left):
        start = used
        for member in range(2):
            node = members[joined, member]
            if node < 0:
                continue
            for e in range(pointers[node], pointers[node + 1]):
                other = parent[neighbours[e]]
                if other == joined:
                    new_within[joined] += weights[e]
                elif place[other] >= start:
                    new_weights[place[other]] += weights[e]
                    new_edges[place[other]] += edges[e]
                else:
                    place[other] = used
                    new_neighbours[used], new_weights[used], new_edges[used] = other, weights[e], edges[e]
                    used += 1
        new_pointers[joined + 1] = used
    return new_pointers, new_neighbours[:used], new_weights[:used], new_edges[:used], new_sizes, new_within
