"""Two-way and recursive normalised cuts of a sparse affinity graph (§4; Shi & Malik, PAMI 2000).

Differs from the paper: the paper does not say how a cut is found; here the generalised eigenvectors of
the few smallest eigenvalues are thresholded at many values and the best N-cut with enough trajectories on
either side is taken. Parts that no edge joins are separate from the start (their N-cut is 0), which
keeps the eigenproblem well posed. The eigensolver starts from a fixed vector: equal graphs give equal cuts.
"""

from __future__ import annotations

from dataclasses import dataclass
from inspect import signature
from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.linalg import eigh
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import ArpackNoConvergence, LinearOperator, eigsh

from mlbs_actors.messages import Array

#: Newer versions of SciPy draw restart vectors from a generator of the caller's.
_SEED: dict[str, Any] = {"rng": 0} if "rng" in signature(eigsh).parameters else {}

__all__ = ["TwoWayCut", "best_cut", "ncut_value", "recursive_cut"]

#: Affinity below which an edge counts as absent when parts are told apart.
NO_EDGE = 1e-6
#: Up to this many nodes the dense eigensolver is the faster one.
DENSE_NODES = 128
#: Eigenvectors tried for each cut.
EIGENVECTORS = 3
#: Thresholds tried on each eigenvector (the MATLAB's 30).
THRESHOLDS = 30


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


def ncut_value(affinity: sp.csr_array, side: Array) -> float:
    """N-cut value of a given bipartition; inf if one side has no volume.

    Parameters
    ----------
    affinity : (n, n) sparse, symmetric, non-negative
    side : (n,) bool
    """
    degree = np.asarray(affinity.sum(axis=1)).ravel()
    inside = float(degree[side].sum())
    outside = float(degree[~side].sum())
    if inside <= 0 or outside <= 0:
        return float("inf")
    across = float((affinity[side] @ (~side).astype(np.float64)).sum())
    return across / inside + across / outside


def best_cut(affinity: sp.csr_array, min_side: int) -> TwoWayCut:
    """Best thresholded-eigenvector cut of one connected cluster.

    Parameters
    ----------
    affinity : (n, n) sparse, symmetric, non-negative
    min_side : int
        Least number of nodes on either side.

    Returns
    -------
    TwoWayCut
    """
    n = affinity.shape[0]
    best = TwoWayCut(float("inf"), np.zeros(n, bool))
    if n < 2 * min_side:
        return best
    degree = np.maximum(np.asarray(affinity.sum(axis=1)).ravel(), 1e-12)
    scale = 1.0 / np.sqrt(degree)
    normalised = sp.csr_array(sp.diags_array(scale) @ affinity @ sp.diags_array(scale))
    rows = np.repeat(np.arange(n), np.diff(affinity.indptr))
    for vector in _eigenvectors(normalised, degree).T:
        values = scale * vector
        order = np.argsort(values, kind="stable")
        rank = np.empty(n, np.intp)
        rank[order] = np.arange(n)
        # Cutting after position p of the order severs every edge whose ends lie on either side of p.
        low = np.minimum(rank[rows], rank[affinity.indices])
        high = np.maximum(rank[rows], rank[affinity.indices])
        weight = 0.5 * affinity.data
        across = np.cumsum(np.bincount(low, weight, n) - np.bincount(high, weight, n))
        inside = np.cumsum(degree[order])
        tried = np.unique(np.linspace(min_side - 1, n - min_side - 1, min(n, THRESHOLDS * 8)).astype(np.intp))
        severed = np.maximum(across[tried], 0.0)
        cuts = severed / inside[tried] + severed / (inside[-1] - inside[tried])
        chosen = int(np.argmin(cuts))
        if cuts[chosen] < best.value:
            best = TwoWayCut(float(cuts[chosen]), rank <= tried[chosen])
    return best


def _eigenvectors(normalised: sp.csr_array, degree: Array) -> Array:
    """Eigenvectors of D^-½ A D^-½ for its largest eigenvalues after the trivial one, (n, k)."""
    n = normalised.shape[0]
    wanted = min(EIGENVECTORS, n - 1)
    if n <= DENSE_NODES:
        _, vectors = eigh(normalised.toarray(), subset_by_index=[n - 1 - wanted, n - 2])
        return np.asarray(vectors)[:, ::-1]
    # The trivial eigenvector D^½·1 is known: shift it out of the way instead of computing it.
    trivial = np.sqrt(degree)
    trivial = trivial / np.linalg.norm(trivial)
    start = np.cos(np.arange(n) * 2.399963)  # fixed, spread over all frequencies
    start -= trivial * (trivial @ start)

    def deflated(vector: Array) -> Array:
        flat = vector.ravel()
        return np.asarray(normalised @ flat - 2.0 * trivial * (trivial @ flat))

    operator = LinearOperator((n, n), matvec=deflated, dtype=np.float64)
    try:
        values, vectors = eigsh(
            operator, k=wanted, which="LA", v0=start, tol=1e-4, maxiter=60, ncv=24, **_SEED
        )
    except ArpackNoConvergence as error:
        values, vectors = error.eigenvalues, error.eigenvectors  # those that converged
        if len(values) == 0:
            return np.zeros((n, 0))
    order = np.argsort(-values, kind="stable")
    return np.asarray(vectors)[:, order]


def recursive_cut(affinity: sp.csr_array, threshold: float, min_side: int) -> Array:
    """Split a graph into clusters while the best N-cut of a cluster is below the threshold.

    Parameters
    ----------
    affinity : (n, n) sparse, symmetric, non-negative
    threshold : float
        N-cut value below which a cluster is split.
    min_side : int
        Least number of nodes of a cluster.

    Returns
    -------
    (n,) int64
        Cluster of every node, 0 … C−1 by falling size; −1 for nodes in parts smaller than ``min_side``.
    """
    n = affinity.shape[0]
    labels = np.full(n, -1, np.int64)
    if n == 0:
        return labels
    present = affinity.copy()
    present.data = np.where(present.data >= NO_EDGE, present.data, 0.0)
    present.eliminate_zeros()
    _, part = connected_components(present, directed=False)
    waiting = [np.flatnonzero(part == p) for p in range(part.max() + 1)]
    clusters = []
    while waiting:
        nodes = waiting.pop()
        if len(nodes) < min_side:
            continue
        cut = best_cut(sp.csr_array(present[nodes][:, nodes]), min_side)
        if cut.value < threshold:
            waiting += [nodes[cut.side], nodes[~cut.side]]
        else:
            clusters.append(nodes)
    clusters.sort(key=lambda nodes: (-len(nodes), int(nodes[0])))
    for label, nodes in enumerate(clusters):
        labels[nodes] = label
    return labels
