"""The diagonal of the inverse of a screened Poisson matrix, exactly: selected inversion of a banded matrix.

It is the marginal variance of each node of :mod:`mlbs_actors.motion_field.field`; loopy message passing would
not give it. The matrix is that of :mod:`mlbs_actors.motion_field.screened_poisson`.
"""

from __future__ import annotations

import numpy as np

from mlbs_actors.kernels.jit import compiled
from mlbs_actors.messages import Array
from mlbs_actors.motion_field.banded_factors import factorised, node_place

__all__ = ["inverse_diagonal"]


@compiled
def inverse_diagonal(screening: Array, edge: float) -> Array:
    """Diagonal of A⁻¹, exactly.

    With the nodes numbered along the grid's shorter side, A = L D Lᵀ has its elements within that side's
    length w of the diagonal, and so have those of Z = A⁻¹ that the diagonal needs (Takahashi, Fagan and Chen
    1973):
    Z_ij = −Σ_k Z_ik L_kj for j < i ≤ j + w and Z_jj = 1/D_j − Σ_k Z_jk L_kj, k = j + 1 … j + w, from the last
    column to the first. The cost is O(long side · short side³).

    Parameters
    ----------
    screening : (rows, columns) float64
    edge : float

    Returns
    -------
    (rows, columns) float64
    """
    (rows, columns), size, width = screening.shape, screening.size, min(screening.shape)
    lower = factorised(screening, edge)
    # inverse[i, width + k] is Z's element (i, i + k), on both sides of the diagonal.
    inverse = np.zeros((size + width, 2 * width + 1))
    # Places in a flat array, without a sign, as in the factorisation.
    flat, column, line = inverse.reshape(-1), np.empty(width), np.uint64(2 * width + 1)
    diagonal = np.empty(screening.shape)
    for node in range(size - 1, -1, -1):
        column[:] = 0.0
        own = np.uint64(node) * line + np.uint64(width)
        for k in range(1, width + 1):
            weight, row = lower[node, k], own + np.uint64(k) * line - np.uint64(k - 1)
            for i in range(width):
                column[i] -= weight * flat[row + np.uint64(i)]
        corner = 1.0 / lower[node, 0]
        for k in range(1, width + 1):
            corner -= lower[node, k] * column[k - 1]
            flat[own + np.uint64(k)] = column[k - 1]
            flat[own + np.uint64(k) * (line - np.uint64(1))] = column[k - 1]
        flat[own] = diagonal[node_place(node, rows, columns)] = corner
    return diagonal
