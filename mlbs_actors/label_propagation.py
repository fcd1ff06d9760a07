"""Labels of the trajectories carried from frame to frame by random walks (§4).

Two walks behind one option:

* ``absorbing`` (the paper): labelled = the trajectories as labelled in the previous frame, unlabelled = the
  ones without a label, Y_u = (I − P_uu)⁻¹ P_ul Y_l. A live trajectory is one node and keeps its label.
* ``soft`` (the authors' program): every trajectory is decided again, Z = r (I − (1 − r) P)⁻¹ Y, r the
  restart probability, so that a wrong label heals when its neighbourhood disagrees.

Differs from the paper: its (I − P_uu) is singular on a component without any labelled node; such nodes
stay unlabelled (−1) here, and the caller decides whether they are a new object.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu

from mlbs_actors.messages import Array

__all__ = ["propagate_absorbing", "propagate_soft"]

#: Affinity below which an edge leads nowhere.
NO_EDGE = 1e-12
#: Error of a soft walk's shares.
TOLERANCE = 1e-2


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
        Share of the walks of each node that ended at each class, rows sum to 1 at most (and errors of
        ``TOLERANCE``).
    """
    degree = np.asarray(affinity.sum(axis=1)).ravel()
    inverse = np.divide(1.0 - restart, degree, out=np.zeros_like(degree), where=degree > 0)[:, None]
    Y = np.zeros((len(labels), classes))
    known = labels >= 0
    Y[np.flatnonzero(known), labels[known]] = restart
    # Chebyshev iteration: the eigenvalues of (1−r) P are real and lie within ±(1−r), so the weights and the
    # number of steps are known beforehand.
    radius = 1.0 - restart
    rate = radius / (1.0 + np.sqrt(1.0 - radius**2))
    weight = 2.0
    before, Z = np.zeros_like(Y), Y
    for _ in range(int(np.ceil(np.log(TOLERANCE / 2.0) / np.log(rate)))):
        weight = 1.0 / (1.0 - 0.25 * radius**2 * weight)
        before, Z = Z, weight * (inverse * (affinity @ Z) + Y - before) + before
    return Z


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
    unknown = np.flatnonzero(~known)
    edges = sp.csr_array(affinity[unknown])
    edges.data = np.where(edges.data >= NO_EDGE, edges.data, 0.0)
    edges.eliminate_zeros()  # they would count as connections and make the system singular
    among = sp.csr_array(edges[:, unknown])
    _, component = connected_components(among, directed=False)
    to_known = edges @ known.astype(np.float64) > 0
    reached = np.isin(component, component[to_known])
    if not reached.any():
        return share
    solved = unknown[reached]
    degree = np.asarray(edges.sum(axis=1)).ravel()[reached]
    inverse = sp.diags_array(1.0 / degree)
    system = sp.identity(len(solved), format="csc") - inverse @ among[reached][:, reached]
    share[solved] = splu(sp.csc_array(system)).solve(np.asarray(inverse @ (edges[reached] @ share)))
    return share
