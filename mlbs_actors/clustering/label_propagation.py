"""Labels of the trajectories carried from frame to frame by random walks (§4).

Two walks behind one option:

* ``absorbing`` (the paper): trajectories with a label from the previous frame keep it, the others get
  Y_u = (I − P_uu)⁻¹ P_ul Y_l.
* ``soft`` (the authors' program): every trajectory is decided again, Z = r (I − (1 − r) P)⁻¹ Y, r the
  restart probability, so that a wrong label heals when its neighbourhood disagrees.

Differs from the paper: its (I − P_uu) is singular on a component without any labelled node; such nodes stay
unlabelled (−1) here, and the caller decides whether they are a new object. The soft walk drops shares of a
class that are too small to affect a decision.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from mlbs_actors.kernels.jit import compiled
from mlbs_actors.messages import Array

__all__ = ["propagate_absorbing", "propagate_soft"]

#: Affinity below which an edge is ignored.
NO_EDGE = 1e-12
#: Error of a soft walk's shares.
TOLERANCE = 1e-2
#: A walk continues to a node once a neighbour passes it at least this share of a class.
LEAST_SHARE = 1e-5


def propagate_soft(affinity: sp.csr_array, labels: Array, classes: int, restart: float) -> Array:
    """Random walk with soft restart: Z = r (I − (1−r) P)⁻¹ Y.

    Parameters
    ----------
    affinity : (n, n) sparse, symmetric, non-negative
    labels : (n,) int
        Class 0 … classes−1 of each trajectory, −1 = unlabelled.
    classes : int
    restart : float
        r in (0, 1).

    Returns
    -------
    (n, classes) float64
        Share of each node's walks that end at each class; rows sum to at most 1, up to ``TOLERANCE``.
    """
    # Chebyshev iteration: the eigenvalues of (1−r) P are real and lie within ±(1−r), so the weights and the
    # number of steps are known in advance.
    radius = 1.0 - restart
    rate = radius / (1.0 + np.sqrt(1.0 - radius**2))
    steps = int(np.ceil(np.log(TOLERANCE / 2.0) / np.log(rate)))
    return np.asarray(
        _walk(affinity.indptr, affinity.indices, affinity.data, labels, classes, restart, steps)
    )


@compiled
def _walk(
    pointers: Array,
    neighbours: Array,
    weights: Array,
    labels: Array,
    classes: int,
    restart: float,
    steps: int,
) -> Array:
    """Compute shares after some steps, (n, classes): class by class, only as far as walks from it reach."""
    count = labels.size
    come = np.empty(count)
    for node in range(count):
        degree = weights[pointers[node] : pointers[node + 1]].sum()
        come[node] = (1.0 - restart) / degree if degree > 0 else 0.0
    radius, share = 1.0 - restart, np.zeros((count, classes))
    before, now, start = np.zeros(count), np.zeros(count), np.zeros(count)
    reached, is_reached = np.empty(count, np.uint32), np.zeros(count, np.bool_)
    # The most that a node may pass to a neighbour that has not been reached: few need the exact test.
    handed = np.full(count, np.inf)
    for one in range(classes):
        found = 0
        for node in range(count):
            if labels[node] == one:
                start[node] = now[node] = restart
                reached[found], is_reached[node] = node, True
                found += 1
        weight = 2.0
        for _ in range(steps):
            weight = 1.0 / (1.0 - 0.25 * radius**2 * weight)
            place = 0
            while place < found:  # including those reached on the way
                node, total = reached[place], 0.0
                first, last = pointers[node], pointers[node + 1]
                for e in range(first, last):
                    total += weights[e] * now[np.uint32(neighbours[e])]
                # The values of two steps ago make room for the next ones.
                before[node] += weight * (come[node] * total + start[node] - before[node])
                if handed[node] * now[node] >= LEAST_SHARE:
                    most = 0.0
                    for e in range(first, last):
                        other = np.uint32(neighbours[e])
                        if is_reached[other]:
                            continue
                        passed = come[other] * weights[e]
                        if passed * now[node] >= LEAST_SHARE:
                            reached[found], is_reached[other] = other, True
                            found += 1
                        else:
                            most = max(most, passed)
                    handed[node] = most
                place += 1
            before, now = now, before
        for place in range(found):
            node = reached[place]
            share[node, one] = now[node]
            before[node], now[node], start[node] = 0.0, 0.0, 0.0
            is_reached[node], handed[node] = False, np.inf
    return share


def propagate_absorbing(affinity: sp.csr_array, labels: Array, classes: int) -> Array:
    """The paper's absorbing walk: Y_u = (I − P_uu)⁻¹ P_ul Y_l.

    Parameters
    ----------
    affinity : (n, n) sparse, symmetric, non-negative
    labels : (n,) int
        Class 0 … classes−1 of each trajectory, −1 = unlabelled.
    classes : int

    Returns
    -------
    (n, classes) float64
        Rows sum to 1, or are 0 in a component without a labelled node.
    """
    share = np.zeros((len(labels), classes))
    known = labels >= 0
    share[np.flatnonzero(known), labels[known]] = 1.0
    solved, pointers, columns, values, towards = _absorbing_system(
        affinity.indptr, affinity.indices, affinity.data, labels, classes
    )
    if len(solved):
        # Rows times their degrees: (D − A)_uu Y_u = A_ul Y_l is symmetric, so rows are columns.
        system = sp.csc_array((values, columns, pointers), shape=(len(solved), len(solved)))
        share[solved] = splu(system).solve(towards)
    return share


@compiled
def _absorbing_system(
    pointers: Array, neighbours: Array, weights: Array, labels: Array, classes: int
) -> tuple[Array, Array, Array, Array, Array]:
    """Set up the equations of the unlabelled nodes from which a labelled one can be reached.

    Returns
    -------
    solved : (m,) int64
        The nodes, ascending.
    pointers, columns, values : (m + 1,) int32, (e,) int32, (e,) float64
        Compressed rows of (D − A)_uu.
    towards : (m, classes) float64
        A_ul Y_l.
    """
    count = labels.size
    reached, waiting, left = labels >= 0, np.empty(count, np.int32), 0
    for node in range(count):
        if labels[node] >= 0:
            continue
        for e in range(pointers[node], pointers[node + 1]):
            if weights[e] >= NO_EDGE and labels[neighbours[e]] >= 0:
                reached[node], waiting[left] = True, node
                left += 1
                break
    while left > 0:
        left -= 1
        node = waiting[left]
        for e in range(pointers[node], pointers[node + 1]):
            if weights[e] >= NO_EDGE and not reached[neighbours[e]]:
                reached[neighbours[e]], waiting[left] = True, neighbours[e]
                left += 1
    solved = np.flatnonzero(reached & (labels < 0))
    place = np.full(count, -1, np.int32)
    place[solved] = np.arange(solved.size)
    starts = np.zeros(solved.size + 1, np.int32)
    columns, values = np.empty(neighbours.size + count, np.int32), np.empty(neighbours.size + count)
    towards = np.zeros((solved.size, classes))
    used = 0
    for row in range(solved.size):
        diagonal, degree = used, 0.0
        columns[used] = row
        used += 1
        for e in range(pointers[solved[row]], pointers[solved[row] + 1]):
            other = neighbours[e]
            if weights[e] >= NO_EDGE:
                degree += weights[e]
                if labels[other] >= 0:
                    towards[row, labels[other]] += weights[e]
                else:
                    columns[used], values[used] = place[other], -weights[e]
                    used += 1
        values[diagonal] = degree
        starts[row + 1] = used
    return solved, starts, columns[:used], values[:used], towards
