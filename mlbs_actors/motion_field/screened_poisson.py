"""The screened Poisson matrix of a grid: its factor, its solutions, and the diagonal of its inverse.

The matrix is A = e·L + diag(s): L the Laplacian of the grid's 4-neighbour graph (no edges across the border),
e > 0 the weight of an edge, s ≥ 0 the screening of each node, positive somewhere. It is the precision matrix
of the Gaussian Markov random field of :mod:`mlbs_actors.motion_field.field`.

With the nodes numbered along the grid's shorter side, all its elements, and those of its Cholesky factor, lie
within that side's length w of the diagonal: LAPACK factorises it in O(long side · w³). The marginal
variances, which loopy message passing would not give exactly, are the diagonal of A⁻¹, by selected inversion.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg.lapack import dpbtrf, dpbtrs

from mlbs_actors.errors import SolverError
from mlbs_actors.kernels.jit import compiled
from mlbs_actors.messages import Array

__all__ = ["factorised", "inverse_diagonal", "solved"]


def factorised(screening: Array, edge: float) -> Array:
    """Compute the Cholesky factor C of A = C Cᵀ.

    Parameters
    ----------
    screening : (rows, columns) float64
    edge : float

    Returns
    -------
    (w + 1, n) float64
        In LAPACK's lower banded form: element (k, j) is C's element (j + k, j).

    Raises
    ------
    SolverError
        If A is not positive definite in double precision.
    """
    factor: Array
    factor, failed = dpbtrf(_banded(_along_shorter_side(screening), edge), lower=1, overwrite_ab=1)
    if failed:
        raise SolverError(
            "A motion field could not be solved; bring the standard deviations of its terms closer together."
        )
    return factor


def solved(factor: Array, right: Array) -> Array:
    """Solve A d = b for some right-hand sides.

    Parameters
    ----------
    factor : (w + 1, n) float64
        Of :func:`factorised`.
    right : (k, rows, columns) float64
        b.

    Returns
    -------
    (k, rows, columns) float64
        d.
    """
    count, rows, columns = right.shape
    numbered = right if rows >= columns else right.transpose(0, 2, 1)
    solution = dpbtrs(factor, numbered.reshape(count, -1).T, lower=1)[0].T
    if rows >= columns:
        return np.ascontiguousarray(solution).reshape(right.shape)
    return np.ascontiguousarray(solution.reshape(count, columns, rows).transpose(0, 2, 1))


def inverse_diagonal(factor: Array, shape: tuple[int, int]) -> Array:
    """Compute the diagonal of A⁻¹.

    With A = L D Lᵀ, the elements of Z = A⁻¹ that the diagonal needs lie within w of it, too (Takahashi, Fagan
    and Chen 1973): Z_ij = −Σ_k Z_ik L_kj for j < i ≤ j + w and Z_jj = 1/D_j − Σ_k Z_jk L_kj, for
    k = j + 1 … j + w, from the last column to the first.

    Parameters
    ----------
    factor : (w + 1, n) float64
        Of :func:`factorised`.
    shape : (rows, columns)
        Of the grid.

    Returns
    -------
    (rows, columns) float64
    """
    diagonal = _inverse_diagonal(np.ascontiguousarray((factor / factor[0]).T), factor[0] ** 2)
    rows, columns = shape
    return (
        diagonal.reshape(shape)
        if rows >= columns
        else np.ascontiguousarray(diagonal.reshape(columns, rows).T)
    )


def _along_shorter_side(values: Array) -> Array:
    """Orient a map so that its rows are the grid's shorter side."""
    return values if values.shape[0] >= values.shape[1] else np.ascontiguousarray(values.T)


@compiled
def _banded(screening: Array, edge: float) -> Array:
    """Return A in LAPACK's lower banded form, of a grid whose rows are its shorter side."""
    rows, width = screening.shape
    band = np.zeros((rows * width, width + 1)).T  # Fortran order, as LAPACK takes it
    for v in range(rows):
        for u in range(width):
            node = v * width + u
            neighbours = (v > 0) + (v + 1 < rows) + (u > 0) + (u + 1 < width)
            band[0, node] = screening[v, u] + edge * neighbours
            if u + 1 < width:
                band[1, node] = -edge
            if v + 1 < rows:
                band[width, node] = -edge  # the same element where a row has one node
    return band


@compiled
def _inverse_diagonal(lower: Array, pivots: Array) -> Array:
    """Compute the diagonal of (L D Lᵀ)⁻¹; row j of ``lower`` (n, w + 1) holds L's (j, j) … (j + w, j)."""
    size, width = lower.shape[0], lower.shape[1] - 1
    # inverse[i, width + k] is Z's element (i, i + k), on both sides of the diagonal.
    inverse = np.zeros((size + width, 2 * width + 1))
    # Unsigned offsets into a flat array: thousands of slices of a dozen elements would take longer.
    flat, column, line = inverse.reshape(-1), np.empty(width), np.uint64(2 * width + 1)
    diagonal = np.empty(size)
    for node in range(size - 1, -1, -1):
        column[:] = 0.0
        own = np.uint64(node) * line + np.uint64(width)
        for k in range(1, width + 1):
            weight, row = lower[node, k], own + np.uint64(k) * line - np.uint64(k - 1)
            for i in range(width):
                column[i] -= weight * flat[row + np.uint64(i)]
        corner = 1.0 / pivots[node]
        for k in range(1, width + 1):
            corner -= lower[node, k] * column[k - 1]
            flat[own + np.uint64(k)] = column[k - 1]
            flat[own + np.uint64(k) * (line - np.uint64(1))] = column[k - 1]
        flat[own] = diagonal[node] = corner
    return diagonal
