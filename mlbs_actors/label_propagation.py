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
#: Largest change of a soft label at which the iteration ends.
TOLERANCE = 1e-5


def _transition(affinity: sp.csr_array) -> sp.csr_array:
    degree = np.asarray(affinity.sum(axis=1)).ravel()
    inverse = np.divide(1.0, degree, out=np.zeros_like(degree), where=degree > 0)
    return sp.csr_array(sp.diags_array(inverse) @ affinity)


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
        Share of the walks of each node that ended at each class, rows sum to ≤ 1.
    """
    P = _transition(affinity)
    Y = np.zeros((len(labels), classes))
    known = labels >= 0
    Y[np.flatnonzero(known), labels[known]] = restart
    Z = Y.copy()
    steps = int(np.ceil(np.log(TOLERANCE) / np.log(1.0 - restart)))
    for _ in range(steps):  # contraction by 1 − r a step, so the number of steps is known
        Z = Y + (1.0 - restart) * (P @ Z)
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
    Y = np.zeros((len(labels), classes))
    known = labels >= 0
    Y[np.flatnonzero(known), labels[known]] = 1.0
    affinity = affinity.copy()
    affinity.data[affinity.data < NO_EDGE] = 0.0
    affinity.eliminate_zeros()  # it would count as a connection and make the system singular
    _, component = connected_components(affinity, directed=False)
    reached = np.isin(component, component[known]) & ~known
    unknown = np.flatnonzero(reached)
    if len(unknown) == 0:
        return Y
    P = _transition(affinity)[unknown]
    system = sp.csc_array(sp.identity(len(unknown), format="csr") - P[:, unknown])
    Y[unknown] = splu(system).solve(np.asarray(P[:, np.flatnonzero(known)] @ Y[known]))
    return Y
