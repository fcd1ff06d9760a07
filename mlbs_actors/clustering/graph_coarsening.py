"""A small graph that stands for a large one: nodes that clearly belong together are joined, pair by pair.

Each round joins every node with the neighbour that it shares most of its affinity with, if both are tied to
each other about as closely as to their closest neighbours. Joined nodes sum their edges, so a cut of the
small graph has the same cost in the large one. Multilevel graph partitioning (Dhillon, Guan, Kulis, PAMI
2007) is similar, but also joins across weak edges where nothing better is left; here that would hide the
borders that are searched for.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mlbs_actors.kernels.jit import compiled
from mlbs_actors.messages import Array

__all__ = ["coarsen"]

#: Two nodes are joined if the mean affinity between them is at least this share of the best that either has;
#: when no more are joined, the next share applies.
CLOSENESS = (0.7, 0.5, 0.3)
#: A round that keeps more than this share of the nodes is the last at its share.
WORTHWHILE = 0.95


class _Level(NamedTuple):
    """A graph during coarsening, as compressed rows.

    Attributes
    ----------
    pointers, neighbours, weights : (n + 1,) int32, (e,) int32, (e,) float64
        Sums of the affinities between nodes.
    edges, means : (e,) int32, (e,) float64
        How many edges each stands for, and their mean affinity.
    closest, volume : (n,) float64
        The largest mean of each node, and the sum of its affinities to others.
    sizes, within : (n,) int32, (n,) float64
        How many nodes each stands for, and the sum of the affinities within.
    """

    pointers: Array
    neighbours: Array
    weights: Array
    edges: Array
    means: Array
    closest: Array
    volume: Array
    sizes: Array
    within: Array


@compiled
def coarsen(pointers: Array, neighbours: Array, weights: Array, most: int) -> tuple[Array, Array]:
    """Join nodes as long as some clearly belong together.

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
    count = pointers.size - 1
    group = np.arange(count).astype(np.int32)
    sizes, within = np.ones(count, np.int32), np.zeros(count)
    closest, volume = np.zeros(count), np.zeros(count)
    for node in range(count):
        for e in range(pointers[node], pointers[node + 1]):
            closest[node] = max(closest[node], weights[e])
            volume[node] += weights[e]
    single = np.ones(weights.size, np.int32)
    level = _Level(pointers, neighbours, weights, single, weights, closest, volume, sizes, within)
    for closeness in CLOSENESS:
        while most > 1:
            parent, left = _match(level, most, closeness)
            if left > WORTHWHILE * level.sizes.size:
                break
            level = _contract(level, parent, left)
            for node in range(count):
                group[node] = parent[group[node]]
    return group, _dense(level)


@compiled
def _dense(level: _Level) -> Array:
    matrix = np.zeros((level.sizes.size, level.sizes.size))
    for node in range(level.sizes.size):
        matrix[node, node] = level.within[node]
        for e in range(level.pointers[node], level.pointers[node + 1]):
            matrix[node, level.neighbours[e]] = level.weights[e]
    return matrix


@compiled
def _match(level: _Level, most: int, closeness: float) -> tuple[Array, int]:
    """Return the node of the next graph for each node, and their number."""
    pointers, neighbours, weights, sizes = level.pointers, level.neighbours, level.weights, level.sizes
    means, closest, volume = level.means, level.closest, level.volume
    count = sizes.size
    parent = np.full(count, -1, np.int32)
    left = 0
    for node in range(count):
        if parent[node] >= 0:
            continue
        best, partner = 0.0, -1
        for e in range(pointers[node], pointers[node + 1]):
            other = neighbours[e]
            if (
                parent[other] < 0
                and sizes[node] + sizes[other] <= most
                and means[e] >= closeness * max(closest[node], closest[other])
            ):
                share = weights[e] / volume[node] + weights[e] / volume[other]
                if share > best:
                    best, partner = share, other
        parent[node] = left
        if partner >= 0:
            parent[partner] = left
        left += 1
    return parent, left


@compiled
def _contract(level: _Level, parent: Array, left: int) -> _Level:
    """Build the next graph: parallel edges summed, those inside a node added to ``within``."""
    pointers, neighbours, weights, edges = level.pointers, level.neighbours, level.weights, level.edges
    members = np.full((left, 2), -1, np.int32)
    new_sizes, new_within = np.zeros(left, np.int32), np.zeros(left)
    for node in range(parent.size):
        joined = parent[node]
        members[joined, 1 if members[joined, 0] >= 0 else 0] = node
        new_sizes[joined] += level.sizes[node]
        new_within[joined] += level.within[node]
    new_pointers = np.zeros(left + 1, np.int32)
    new_neighbours, new_edges = np.empty(neighbours.size, np.int32), np.empty(neighbours.size, np.int32)
    new_weights, means = np.empty(neighbours.size), np.empty(neighbours.size)
    closest, volume = np.zeros(left), np.zeros(left)
    # Affinity and edges from the current node to each other one, and for which node those were computed.
    affinity, tied, found_for = np.zeros(left), np.zeros(left, np.int32), np.full(left, -1, np.int32)
    used = 0
    for joined in range(left):
        start, found_for[joined], affinity[joined] = used, joined, new_within[joined]
        for member in range(2):
            node = members[joined, member]
            if node < 0:
                continue
            for e in range(pointers[node], pointers[node + 1]):
                other = np.uint32(parent[np.uint32(neighbours[e])])
                affinity[other] += weights[e]
                tied[other] += edges[e]
                new_neighbours[used] = other
                used += found_for[other] != joined
                found_for[other] = joined
        new_within[joined], affinity[joined], tied[joined] = affinity[joined], 0.0, 0
        nearest = total = 0.0
        for e in range(start, used):
            other = new_neighbours[e]
            new_weights[e], new_edges[e] = affinity[other], tied[other]
            means[e] = affinity[other] / tied[other]
            nearest = max(nearest, means[e])
            total += affinity[other]
            affinity[other], tied[other] = 0.0, 0
        closest[joined], volume[joined], new_pointers[joined + 1] = nearest, total, used
    return _Level(
        new_pointers, new_neighbours[:used], new_weights[:used], new_edges[:used], means[:used],
        closest, volume, new_sizes, new_within,
    )  # fmt: skip
