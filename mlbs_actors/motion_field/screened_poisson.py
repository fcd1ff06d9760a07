"""The screened Poisson matrix of a grid: its factor, its solutions, and the diagonal of its inverse.

The matrix is A = e·L + diag(s): L the Laplacian of the grid's 4-neighbour graph (no edges across the border),
e > 0 the weight of an edge, s ≥ 0 the screening of each node, positive somewhere. It is the precision matrix
of the Gaussian Markov random field of :mod:`mlbs_actors.motion_field.field`.

With the nodes numbered along the grid's shorter side, all its elements, and those of its Cholesky factor, lie
within that side's length w of the diagonal: a factor takes O(long side · w³). The marginal variances, which
loopy message passing would not give exactly, are the diagonal of A⁻¹, by selected inversion.

Kernels, as an object has some dozens of nodes: LAPACK's calls took four times as long as their work.
"""

from __future__ import annotations

import numpy as np

from mlbs_actors.kernels.jit import compiled
from mlbs_actors.messages import Array

__all__ = ["factorised", "inverse_diagonal", "solved"]


@compiled
def factorised(screening: Array, edge: float) -> Array:
    """Compute the Cholesky factor C of A = C Cᵀ.

    Parameters
    ----------
    screening : (rows, columns) float64
    edge : float

    Returns
    -------
    (n, w + 1) float64
        Row j holds C's elements (j, j) … (j + w, j). Empty if A is not positive definite in double precision.
    """
    band = _banded(_along_shorter_side(screening), edge)
    size, width = band.shape[0], band.shape[1] - 1
    for node in range(size):
        column = band[node]
        if not column[0] > 0.0:
            return band[:0]
        column /= np.sqrt(column[0])
        for k in range(1, min(width, size - 1 - node) + 1):
            weight, later = column[k], band[node + k]
            for i in range(width + 1 - k):
                later[np.uint64(i)] -= weight * column[np.uint64(k + i)]
    return band


@compiled
def solved(factor: Array, right: Array) -> Array:
    """Solve A d = b for some right-hand sides.

    Parameters
    ----------
    factor : (n, w + 1) float64
        Of :func:`factorised`.
    right : (k, rows, columns) float64
        b.

    Returns
    -------
    (k, rows, columns) float64
        d.
    """
    size, width = factor.shape[0], factor.shape[1] - 1
    solution = np.empty_like(right)
    for one in range(right.shape[0]):
        values = _along_shorter_side(right[one]).copy().reshape(-1)
        for node in range(size):
            column = factor[node]
            values[node] /= column[0]
            for k in range(1, min(width, size - 1 - node) + 1):
                values[np.uint64(node + k)] -= column[np.uint64(k)] * values[node]
        for node in range(size - 1, -1, -1):
            column, total = factor[node], values[node]
            for k in range(1, min(width, size - 1 - node) + 1):
                total -= column[np.uint64(k)] * values[np.uint64(node + k)]
            values[node] = total / column[0]
        solution[one] = _as_before(values, right.shape[1], right.shape[2])
    return solution


@compiled
def inverse_diagonal(factor: Array, shape: tuple[int, int]) -> Array:
    """Compute the diagonal of A⁻¹.

    With A = L D Lᵀ, the elements of Z = A⁻¹ that the diagonal needs lie within w of it, too (Takahashi, Fagan
    and Chen 1973): Z_ij = −Σ_k Z_ik L_kj for j < i ≤ j + w and Z_jj = 1/D_j − Σ_k Z_jk L_kj, for
    k = j + 1 … j + w, from the last column to the first.

    Parameters
    ----------
    factor : (n, w + 1) float64
        Of :func:`factorised`.
    shape : (rows, columns)
        Of the grid.

    Returns
    -------
    (rows, columns) float64
    """
    lower = np.empty_like(factor)
    for node in range(len(factor)):
        lower[node] = factor[node] / factor[node, 0]
    return _as_before(_inverse_diagonal(lower, factor[:, 0] ** 2), shape[0], shape[1])


@compiled
def _along_shorter_side(values: Array) -> Array:
    """Orient a map so that its rows are the grid's shorter side."""
    return values if values.shape[0] >= values.shape[1] else np.ascontiguousarray(values.T)


@compiled
def _as_before(values: Array, rows: int, columns: int) -> Array:
    """Return values (n,) of nodes along the shorter side as a map of the grid."""
    if rows >= columns:
        return values.reshape(rows, columns)
    return np.ascontiguousarray(values.reshape(columns, rows).T)


@compiled
def _banded(screening: Array, edge: float) -> Array:
    """Return A's diagonal and what is below it, as :func:`factorised`, of a grid whose rows are its shorter
    side."""
    rows, width = screening.shape
    band = np.zeros((rows * width, width + 1))
    for v in range(rows):
        for u in range(width):
            node = v * width + u
            neighbours = (v > 0) + (v + 1 < rows) + (u > 0) + (u + 1 < width)
            band[node, 0] = screening[v, u] + edge * neighbours
            if u + 1 < width:
                band[node, 1] = -edge
            if v + 1 < rows:
                band[node, width] = -edge  # the same element where a row has one node
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
