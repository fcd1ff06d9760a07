"""The screened Poisson matrix of a grid, factorised exactly: A = L D Lᵀ.

The matrix is that of :mod:`mlbs_actors.screened_poisson`. With the nodes numbered along the grid's shorter
side, all its elements, and those of L, lie within that side's length of the diagonal: the cost is O(long
side · short side³), which for the grid of a small object is less than a few iterations of any other solver.
"""

from __future__ import annotations

import numpy as np

from mlbs_actors.compilation import compiled
from mlbs_actors.messages import Array

__all__ = ["factorised", "solved"]


@compiled()
def factorised(screening: Array, edge: float) -> Array:
    """L and D of a grid that has at least as many rows as columns.

    Parameters
    ----------
    screening : (rows, columns) float64
    edge : float

    Returns
    -------
    (rows · columns + columns, columns + 1) float64
        Row j holds D's element j, then those of L below the diagonal in column j; the last rows are padding.
    """
    rows, columns = screening.shape
    size, width = rows * columns, columns
    lower = np.zeros((size + width, width + 1))
    for node in range(size):
        v, u = node // columns, node % columns
        lower[node, 0] = screening[v, u] + edge * ((v > 0) + (v + 1 < rows) + (u > 0) + (u + 1 < columns))
        if u + 1 < columns:
            lower[node, 1] = -edge
        if v + 1 < rows:
            lower[node, width] = -edge  # the very element beside the diagonal where a line is one node
    # Places in a flat array, without a sign: thousands of slices of a dozen elements would take longer.
    flat, factor, line = lower.reshape(-1), np.empty(width + 1), np.uint64(width + 1)
    for node in range(size):
        own = np.uint64(node) * line
        for k in range(width + 1):
            factor[k] = flat[own + np.uint64(k)] / flat[own]
        for k in range(1, width + 1):
            change, row = flat[own + np.uint64(k)], own + np.uint64(k) * line
            for i in range(width + 1 - k):
                flat[row + np.uint64(i)] -= change * factor[np.uint64(k + i)]
        for k in range(1, width + 1):
            flat[own + np.uint64(k)] = factor[k]
    return lower


@compiled()
def solved(lower: Array, rhs: Array) -> Array:
    """The d of A d = rhs.

    Parameters
    ----------
    lower : Array
        Of :func:`factorised`.
    rhs : (rows, columns) float64

    Returns
    -------
    (rows, columns) float64
    """
    rows, columns = rhs.shape
    size, width = rows * columns, columns
    value = np.zeros(size + width)
    value[:size] = rhs.copy().reshape(-1)
    for node in range(size):
        own, below, column = value[node], value[node + 1 :], lower[node, 1:]
        for k in range(width):
            below[k] -= own * column[k]
    for node in range(size - 1, -1, -1):
        total = value[node] / lower[node, 0]
        below, column = value[node + 1 :], lower[node, 1:]
        for k in range(width):
            total -= below[k] * column[k]
        value[node] = total
    return value[:size].copy().reshape(rows, columns)
