"""Two-way and recursive normalised cuts of a sparse affinity graph (§4; Shi & Malik, PAMI 2000).

Differs from the paper: the paper does not say how a cut is found; here the generalised eigenvectors of the
few smallest eigenvalues are thresholded everywhere and the best N-cut with enough trajectories on either side
is taken. Components are separate from the start (their N-cut is 0), which keeps the eigenproblem well posed.
A large component is coarsened first, by joining trajectories that clearly belong together
(:mod:`mlbs_actors.clustering.graph_coarsening`): a cut of the small graph has exactly the same cost in the
large one, only cuts through joined trajectories are not considered. The dense solver then takes milliseconds
and is deterministic. Most components hold together: no cut is below the second eigenvalue of the normalised
Laplacian, and a factorisation finds in a tenth of the time whether that is above the threshold.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.linalg.lapack import spotrf, ssyevr, ssyevr_lwork

from mlbs_actors.clustering.graph_coarsening import coarsen
from mlbs_actors.kernels.jit import compiled
from mlbs_actors.messages import Array

__all__ = ["TwoWayCut", "best_cut", "holds_together", "recursive_cut"]

#: Affinity below which an edge counts as absent.
NO_EDGE = 1e-6
#: A component of more nodes is coarsened, to about one and a half times as many.
EXACT_NODES = 64
#: Rounding in single precision moves the least eigenvalue that a factorisation of n nodes sees by less than
#: this · n (n + 1), of a matrix with at most 2 on its diagonal (Higham, Accuracy and Stability, §10.1).
ROUNDING = 1.2e-7
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


def holds_together(affinity: Array, threshold: float) -> bool:
    """Whether no cut of a cluster can have an N-cut value below the threshold.

    The least N-cut is at least the second smallest eigenvalue of L = I − D^-½ A D^-½ (Shi & Malik). With the
    smallest, 0, shifted away, L − threshold · I is positive definite exactly if that eigenvalue is larger.

    Parameters
    ----------
    affinity : (n, n) float64, symmetric, non-negative
        The diagonal adds to the volume.
    threshold : float
    """
    # Single precision takes half the time; what its rounding could hide counts as uncertain.
    margin = ROUNDING * len(affinity) * (len(affinity) + 1)
    shifted = _shifted_laplacian(affinity, np.float32(threshold + margin))
    # A symmetric matrix is its own transpose, so LAPACK takes it without a copy.
    *_, failed = spotrf(shifted.T, overwrite_a=True, clean=False)
    return not failed


@compiled
def _degrees(affinity: Array) -> tuple[Array, Array]:
    """Return the diagonal of D, (n,), and that of D^-½."""
    degree, scale = np.empty(len(affinity)), np.empty(len(affinity))
    for node in range(len(affinity)):
        degree[node] = max(affinity[node].sum(), 1e-12)
        scale[node] = 1.0 / np.sqrt(degree[node])
    return degree, scale


@compiled
def _shifted_laplacian(affinity: Array, threshold: np.float32) -> Array:
    """Return the normalised Laplacian with its least eigenvalue shifted from 0 to 2, less threshold · I."""
    count = len(affinity)
    (degree, scale), trivial = _degrees(affinity), np.empty(count, np.float32)
    volume = degree.sum()
    for node in range(count):
        trivial[node] = np.sqrt(degree[node] * (2.0 / volume))
    shifted = np.empty((count, count), np.float32)
    for one in range(count):
        own, row = affinity[one], shifted[one]
        for other in range(count):
            row[other] = trivial[one] * trivial[other] - np.float32(own[other] * (scale[one] * scale[other]))
        row[one] += np.float32(1) - threshold
    return shifted


def best_cut(affinity: Array, sizes: Array, min_side: int) -> TwoWayCut:
    """Find the best thresholded-eigenvector cut of one connected cluster.

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
    if n < 2 or sizes.sum() < 2 * min_side:
        return TwoWayCut(float("inf"), np.zeros(n, bool))
    normalised, degree = _normalised(affinity)
    # The largest eigenvalue of D^-½ A D^-½ has the trivial eigenvector.
    wanted = min(EIGENVECTORS, n - 1)
    work, whole_work, _ = ssyevr_lwork(n, lower=True)
    _, vectors, *_ = ssyevr(
        normalised.T, range="I", il=n - wanted, iu=n - 1, lower=True, lwork=int(work), liwork=whole_work,
        overwrite_a=True,
    )  # fmt: skip
    return TwoWayCut(*_best_threshold(affinity, degree, sizes, vectors.T, min_side))


@compiled
def _normalised(affinity: Array) -> tuple[Array, Array]:
    """Return the transpose of D^-½ A D^-½, as LAPACK wants it, and the diagonal of D.

    Single precision is enough, as only the order of an eigenvector's entries counts.
    """
    count, (degree, scale) = len(affinity), _degrees(affinity)
    normalised = np.empty((count, count), np.float32)
    for one in range(count):
        for other in range(count):
            normalised[one, other] = affinity[other, one] * (scale[other] * scale[one])
    return normalised, degree


@compiled
def _best_threshold(
    affinity: Array, degree: Array, sizes: Array, vectors: Array, min_side: int
) -> tuple[float, Array]:
    """Return the least N-cut, and its side, among all thresholds along some vectors, (k, n)."""
    best, side = np.inf, np.zeros(degree.size, np.bool_)
    volume, trajectories = degree.sum(), sizes.sum()
    for which in range(len(vectors) - 1, -1, -1):
        order = np.argsort(1.0 / np.sqrt(degree) * vectors[which], kind="mergesort")
        severed = _severed(affinity, order)
        inside, within, last = 0.0, 0, -1
        for position in range(order.size):
            inside += degree[order[position]]
            within += sizes[order[position]]
            if min_side <= within <= trajectories - min_side:
                cut = severed[position] / inside + severed[position] / (volume - inside)
                if cut < best:
                    best, last = cut, position
        if last >= 0:
            side[:] = False
            side[order[: last + 1]] = True
    return best, side


@compiled
def _severed(affinity: Array, order: Array) -> Array:
    """Sum the edges that a cut after each position of the order severs."""
    across = np.zeros(order.size)
    now = 0.0
    for position in range(order.size):
        node = order[position]
        for other in range(order.size):  # edges to earlier ones are rejoined, to later ones severed
            if other != position:
                edge = affinity[node, order[other]]
                now += edge if other > position else -edge
        across[position] = max(now, 0.0)
    return across


def recursive_cut(
    affinity: sp.csr_array,
    threshold: float,
    min_side: int,
    apart: Array | None = None,
    firm_factor: float = 1.0,
) -> tuple[Array, Array]:
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
        Only nodes of the same value can share a cluster, and those below 0 are in none.
    firm_factor : float
        At least 1.

    Returns
    -------
    clusters : (n,) int64
        Cluster of every node, 0 … C−1 by falling size; −1 for nodes in parts smaller than ``min_side``.
    firm : (C,) bool
        Clusters in which certainly no cut has an N-cut value below ``firm_factor`` times the threshold; not
        tested for the larger side of a cut.
    """
    pointers, neighbours, weights = affinity.indptr, affinity.indices, affinity.data
    labels = np.full(affinity.shape[0], -1, np.int64)
    apart = np.zeros(len(labels), np.int64) if apart is None else apart
    ordered, starts = _parts(pointers, neighbours, weights, apart)
    ends = starts[1:].tolist()
    waiting: list[tuple[Array, _SmallGraph | None]] = [
        (ordered[start:end], None)
        for start, end in zip(starts.tolist(), ends, strict=False)
        if end - start >= min_side
    ]
    clusters: list[tuple[Array, bool]] = []
    while waiting:
        nodes, small = waiting.pop()
        if len(nodes) < min_side:
            continue
        firm = False
        if small is None:
            most = max(len(nodes) // EXACT_NODES, 1)
            edges = _kept_edges(pointers, neighbours, weights, nodes)
            small = _SmallGraph(*coarsen(*edges, most), len(nodes))
            firm = holds_together(small.joined, firm_factor * threshold)
        if not firm and not holds_together(small.joined, threshold):
            cut = best_cut(small.joined, np.bincount(small.group), min_side)
            if cut.value < threshold:
                waiting += [_one_side(nodes, small, side) for side in (cut.side, ~cut.side)]
                continue
        clusters.append((nodes, firm))
    clusters.sort(key=lambda cluster: (-len(cluster[0]), int(cluster[0][0])))
    for label, (nodes, _) in enumerate(clusters):
        labels[nodes] = label
    return labels, np.array([firm for _, firm in clusters], bool)


@dataclass(frozen=True, slots=True)
class _SmallGraph:
    """The result of :func:`coarsen` for a component, and the component's number of nodes."""

    group: Array
    joined: Array
    made_for: int


def _one_side(nodes: Array, small: _SmallGraph, side: Array) -> tuple[Array, _SmallGraph | None]:
    """Return one side of a cut: it keeps its small graph, or is coarsened anew if at most half is left."""
    inside = side[small.group]
    if 2 * np.count_nonzero(inside) <= small.made_for:
        return nodes[inside], None
    return nodes[inside], _SmallGraph(*_within(side, small.group[inside], small.joined), small.made_for)


def _within(side: Array, group: Array, joined: Array) -> tuple[Array, Array]:
    """Restrict the small graph to one side of a cut: groups renumbered from 0, and their affinities."""
    return (np.cumsum(side) - 1)[group], joined[np.ix_(side, side)]


@compiled
def _kept_edges(
    pointers: Array, neighbours: Array, weights: Array, nodes: Array
) -> tuple[Array, Array, Array]:
    """Return row pointers, columns and values of the edges that count between some ascending nodes."""
    position = np.full(pointers.size - 1, -1, np.int32)
    most = 0
    for i in range(nodes.size):
        position[nodes[i]] = i
        most += pointers[nodes[i] + 1] - pointers[nodes[i]]
    kept_pointers = np.zeros(nodes.size + 1, np.int32)
    kept_neighbours, kept_weights = np.empty(most, np.int32), np.empty(most)
    kept = 0
    for i in range(nodes.size):
        for e in range(pointers[nodes[i]], pointers[nodes[i] + 1]):
            other = position[neighbours[e]]
            if weights[e] >= NO_EDGE and other >= 0:
                kept_neighbours[kept], kept_weights[kept] = other, weights[e]
                kept += 1
        kept_pointers[i + 1] = kept
    return kept_pointers, kept_neighbours[:kept], kept_weights[:kept]


@compiled
def _parts(pointers: Array, neighbours: Array, weights: Array, apart: Array) -> tuple[Array, Array]:
    """Find the components of a symmetric graph, by their first nodes; ``apart`` as of :func:`recursive_cut`.

    Returns
    -------
    ordered : (m,) int32
        The nodes, component by component, ascending in each.
    starts : (p + 1,) int32
        Where each component starts in them.
    """
    count = apart.size
    part, waiting = np.full(count, -1, np.int32), np.empty(count, np.int32)
    starts = np.zeros(count + 1, np.int32)
    parts = 0
    for first in range(count):
        if part[first] >= 0 or apart[first] < 0:
            continue
        part[first], waiting[0], left = parts, first, 1
        while left > 0:
            left -= 1
            node = waiting[left]
            starts[parts + 1] += 1
            for e in range(pointers[node], pointers[node + 1]):
                other = neighbours[e]
                if part[other] < 0 and weights[e] >= NO_EDGE and apart[node] == apart[other]:
                    part[other], waiting[left] = parts, other
                    left += 1
        parts += 1
    for one in range(parts):
        starts[one + 1] += starts[one]
    ordered, place = np.empty(starts[parts], np.int32), starts[:parts].copy()
    for node in range(count):
        if part[node] >= 0:
            ordered[place[part[node]]] = node
            place[part[node]] += 1
    return ordered, starts[: parts + 1]
