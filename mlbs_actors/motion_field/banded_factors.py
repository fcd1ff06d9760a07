"""The screened Poisson matrix of a grid, factorised exactly: A = L D Lᵀ.

The matrix is that of :mod:`mlbs_actors.motion_field.screened_poisson`. With the nodes numbered along the
grid's shorter side, all its elements, and those of L, lie within that side's length of the diagonal: the cost
is O(long side · short side³), which for the grid of a small object is less than a few iterations of any other
solver.
"""

from __future__ import annotations

import numpy as np

from mlbs_actors.kernels.jit import compiled
from mlbs_actors.messages import Array

__all__ = ["factorised", "node_place", "set_solution"]


@compiled
def factorised(screening: Array, edge: float) -> Array:
    """L and D of a grid.

    Parameters
    ----------
    screening : (rows, columns) float64
    edge : float

    Returns
    -------
    (n · w + w, w + 1) float64
        For n · w nodes with w along the shorter side. Row j holds D's element j, then those of L below the
        diagonal in column j; the last rows are padding.
    """
    (rows, columns), size, width = screening.shape, screening.size, min(screening.shape)
    lower = np.zeros((size + width, width + 1))
    for node in range(size):
        v, u = node_place(node, rows, columns)
        lower[node, 0] = screening[v, u] + edge * ((v > 0) + (v + 1 < rows) + (u > 0) + (u + 1 < columns))
        if (node + 1) % width > 0:
            lower[node, 1] = -edge
        if node + width < size:
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


@compiled
def set_solution(lower: Array, rhs: Array, solution: Array) -> None:
    """Solve A d = rhs.

    Parameters
    ----------
    lower : Array
        Of :func:`factorised`.
    rhs : (rows, columns) float64
    solution : (rows, columns) float64
        Becomes d.
    """
    (rows, columns), size, width = rhs.shape, rhs.size, min(rhs.shape)
    value = np.zeros(size + width)
    for node in range(size):
        value[node] = rhs[node_place(node, rows, columns)]
    for node in range(size):
        own, below, column = value[node], value[node + 1 :], lower[node, 1:]
        for k in range(width):
            below[k] -= own * column[k]
    for node in range(size - 1, -1, -1):
        total = value[node] / lower[node, 0]
        below, column = value[node + 1 :], lower[node, 1:]
        for k in range(width):
            total -= below[k] * column[k]
        value[node] = solution[node_place(node, rows, columns)] = total


@compiled
def node_place(node: int, rows: int, columns: int) -> tuple[int, int]:
    """Row and column of a node of a grid: they are numbered along its shorter side."""
    return (node // columns, node % columns) if rows >= columns else (node % rows, node // rows)
