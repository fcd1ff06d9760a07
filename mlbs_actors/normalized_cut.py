"""Two-way and recursive normalised cuts of a sparse affinity graph (§4; Shi & Malik, PAMI 2000).

Differs from the paper: the paper does not say how a cut is found; here the generalised eigenvectors of
the few smallest eigenvalues are thresholded everywhere and the best N-cut with enough trajectories on either
side is taken. Parts that no edge joins are separate from the start (their N-cut is 0), which keeps the
eigenproblem well posed. A large part is made small first, by joining trajectories that belong together
anyway (:mod:`mlbs_actors.graph_coarsening`): a cut of the small graph costs exactly what it costs in the
large one, only cuts through joined trajectories are not looked for. The dense solver then takes
milliseconds, and always gives the same. Most parts hold together: no cut is below the second eigenvalue of
the normalised Laplacian, and a factorisation tells in a tenth of the time whether that is above the
threshold.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.linalg import eigh
from scipy.linalg.lapack import dpotrf

from mlbs_actors.compilation import compiled
from mlbs_actors.graph_coarsening import coarsen
from mlbs_actors.messages import Array

__all__ = ["TwoWayCut", "best_cut", "holds_together", "ncut_value", "recursive_cut"]

#: Affinity below which an edge counts as absent.
NO_EDGE = 1e-6
#: A part of more nodes is made smaller, to about one and a half times as many.
EXACT_NODES = 64
#: Eigenvectors tried for each cut.
EIGENVECTORS = 3


@dataclass(frozen=True, slots=True)
class TwoWayCut:
    """The best cut of one cluster.

    Attributes
    ----------
    value : float
        N-cut = cut/vol(side) + cut/vol(rest), in [0, 2]; inf if the cluster is too small to cut.
    side : (n,) bool
        True on one side.
    """

    value: float
    side: Array


def ncut_value(affinity: Array, side: Array) -> float:
    """N-cut value of a given bipartition; inf if one side has no volume.

    Parameters
    ----------
    affinity : (n, n) float64, symmetric, non-negative
    side : (n,) bool
    """
    degree = affinity.sum(axis=1)
    inside, outside = float(degree[side].sum()), float(degree[~side].sum())
    if inside <= 0 or outside <= 0:
        return float("inf")
    across = float(affinity[np.ix_(side, ~side)].sum())
    return across / inside + across / outside


def holds_together(affinity: Array, threshold: float) -> bool:
    """Whether it is certain that no cut of a cluster has an N-cut value below the threshold.

    The least N-cut is at least the second smallest eigenvalue of L = I − D^-½ A D^-½ (Shi & Malik). With its
    smallest, 0, moved away, L − threshold · I is positive definite exactly if that eigenvalue is larger.

    Parameters
    ----------
    affinity : (n, n) float64, symmetric, non-negative
        The diagonal adds to the volume.
    threshold : float
    """
    # A symmetric matrix is its transpose, which LAPACK takes as it is.
    *_, failed = dpotrf(
        _shifted_laplacian(affinity, threshold * (1.0 + 1e-6)).T, overwrite_a=True, clean=False
    )
    return not failed


@compiled()
def _shifted_laplacian(affinity: Array, threshold: float) -> Array:
    """The normalised Laplacian with its smallest eigenvalue moved from 0 to 2, less threshold · I."""
    count = len(affinity)
    root = np.empty(count)
    for node in range(count):
        root[node] = np.sqrt(max(affinity[node].sum(), 1e-12))
    volume = (root * root).sum()
    shifted = np.empty((count, count))
    for one in range(count):
        for other in range(count):
            joint = root[one] * root[other]
            shifted[one, other] = 2.0 * joint / volume - affinity[one, other] / joint
        shifted[one, one] += 1.0 - threshold
    return shifted


def best_cut(affinity: Array, sizes: Array, min_side: int) -> TwoWayCut:
    """Best thresholded-eigenvector cut of one connected cluster.

    Parameters
    ----------
    affinity : (n, n) float64, symmetric, non-negative
        The diagonal adds to the volume.
    sizes : (n,) int
        How many trajectories each node stands for.
    min_side : int
        Least number of trajectories on either side.

    Returns
    -------
    TwoWayCut
    """
    n = len(affinity)
    best = TwoWayCut(float("inf"), np.zeros(n, bool))
    if n < 2 or sizes.sum() < 2 * min_side:
        return best
    degree = np.maximum(affinity.sum(axis=1), 1e-12)
    scale = 1.0 / np.sqrt(degree)
    # The largest eigenvalue of D^-½ A D^-½ has the trivial eigenvector.
    wanted = min(EIGENVECTORS, n - 1)
    # Only the order of a vector's entries counts, so single precision does.
    normalised = (affinity * np.outer(scale, scale)).astype(np.float32)
    _, vectors = eigh(
        normalised, subset_by_index=[n - 1 - wanted, n - 2], overwrite_a=True, check_finite=False
    )
    for vector in vectors.T[::-1]:
        order = np.argsort(scale * vector, kind="stable")
        severed = _severed(affinity, order)
        inside, trajectories = np.cumsum(degree[order]), np.cumsum(sizes[order])
        tried = np.flatnonzero((trajectories >= min_side) & (trajectories <= trajectories[-1] - min_side))
        if len(tried) == 0:
            continue
        cuts = severed[tried] / inside[tried] + severed[tried] / (inside[-1] - inside[tried])
        chosen = int(np.argmin(cuts))
        if cuts[chosen] < best.value:
            side = np.zeros(n, bool)
            side[order[: tried[chosen] + 1]] = True
            best = TwoWayCut(float(cuts[chosen]), side)
    return best


@compiled()
def _severed(affinity: Array, order: Array) -> Array:
    """Sum of the edges that a cut after each position of the order severs."""
    across = np.zeros(order.size)
    now = 0.0
    for position in range(order.size):
        node = order[position]
        for other in range(order.size):  # those before are rejoined, those after are severed
            if other != position:
                edge = affinity[node, order[other]]
                now += edge if other > position else -edge
        across[position] = max(now, 0.0)
    return across


def recursive_cut(
    affinity: sp.csr_array, threshold: float, min_side: int, apart: Array | None = None
) -> Array:
    """Split a graph into clusters while the best N-cut of a cluster is below the threshold.

    Parameters
    ----------
    affinity : (n, n) sparse, symmetric, non-negative
        Edges below ``NO_EDGE`` count as absent.
    threshold : float
        N-cut value below which a cluster is split.
    min_side : int
        Least number of nodes of a cluster.
    apart : (n,) int, optional
        Only nodes of the same value can be in one cluster, and those below 0 are in none.

    Returns
    -------
    (n,) int64
        Cluster of every node, 0 … C−1 by falling size; −1 for nodes in parts smaller than ``min_side``.
    """
    n = affinity.shape[0]
    labels = np.full(n, -1, np.int64)
    apart = np.zeros(n, np.int64) if apart is None else apart
    eligible = np.flatnonzero(apart >= 0)
    if len(eligible) == 0:
        return labels
    present = _kept_edges(affinity.indptr, affinity.indices, affinity.data, eligible, apart)
    part = _components(*present[:2])
    parts = np.split(np.argsort(part, kind="stable"), np.cumsum(np.bincount(part))[:-1])
    waiting: list[tuple[Array, _SmallGraph | None]] = [(nodes, None) for nodes in parts]
    alike = np.zeros(len(eligible), np.int64)
    clusters = []
    while waiting:
        nodes, small = waiting.pop()
        if len(nodes) < min_side:
            continue
        if small is None:
            most = max(len(nodes) // EXACT_NODES, 1)
            small = _SmallGraph(*coarsen(*_kept_edges(*present, nodes, alike), most), len(nodes))
        if not holds_together(small.joined, threshold):
            cut = best_cut(small.joined, np.bincount(small.group), min_side)
            if cut.value < threshold:
                waiting += [_one_side(nodes, small, side) for side in (cut.side, ~cut.side)]
                continue
        clusters.append(eligible[nodes])
    clusters.sort(key=lambda nodes: (-len(nodes), int(nodes[0])))
    for label, nodes in enumerate(clusters):
        labels[nodes] = label
    return labels


@dataclass(frozen=True, slots=True)
class _SmallGraph:
    """What :func:`coarsen` gives for a part, and how many nodes the part had."""

    group: Array
    joined: Array
    made_for: int


def _one_side(nodes: Array, small: _SmallGraph, side: Array) -> tuple[Array, _SmallGraph | None]:
    """A side of a cut part: what is left of it keeps its small graph, half or less gets a finer one."""
    inside = side[small.group]
    if 2 * np.count_nonzero(inside) <= small.made_for:
        return nodes[inside], None
    return nodes[inside], _SmallGraph(*_within(side, small.group[inside], small.joined), small.made_for)


def _within(side: Array, group: Array, joined: Array) -> tuple[Array, Array]:
    """The small graph of one side of a cut: groups anew from 0 on, and the affinities between them."""
    return (np.cumsum(side) - 1)[group], joined[np.ix_(side, side)]


@compiled()
def _kept_edges(
    pointers: Array, neighbours: Array, weights: Array, nodes: Array, apart: Array
) -> tuple[Array, Array, Array]:
    """Row pointers, columns and values of the edges that count between some of the nodes, which ascend."""
    position = np.full(apart.size, -1, neighbours.dtype)
    position[nodes] = np.arange(nodes.size)
    kept_pointers = np.zeros(nodes.size + 1, pointers.dtype)
    kept_neighbours, kept_weights = np.empty_like(neighbours), np.empty_like(weights)
    kept = 0
    for i in range(nodes.size):
        node = nodes[i]
        for e in range(pointers[node], pointers[node + 1]):
            other = neighbours[e]
            if weights[e] >= NO_EDGE and position[other] >= 0 and apart[node] == apart[other]:
                kept_neighbours[kept], kept_weights[kept] = position[other], weights[e]
                kept += 1
        kept_pointers[i + 1] = kept
    return kept_pointers, kept_neighbours[:kept], kept_weights[:kept]


@compiled()
def _components(pointers: Array, neighbours: Array) -> Array:
    """Number of the connected part of each node of a symmetric graph, by their first nodes, (n,) int64."""
    count = pointers.size - 1
    part = np.full(count, -1, np.int64)
    waiting = np.empty(count, np.int64)
    parts = 0
    for first in range(count):
        if part[first] >= 0:
            continue
        part[first], waiting[0], left = parts, first, 1
        while left > 0:
            left -= 1
            node = waiting[left]
            for e in range(pointers[node], pointers[node + 1]):
                other = neighbours[e]
                if part[other] < 0:
                    part[other], waiting[left] = parts, other
                    left += 1
        parts += 1
    return part
