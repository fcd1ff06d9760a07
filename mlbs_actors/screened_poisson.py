"""Solves the screened Poisson equation of a rectangular grid, and gives the diagonal of its inverse.

The matrix is A = e·L + diag(s): L the Laplacian of the grid's 4-neighbour graph (no edges across the border),
e > 0 the weight of an edge, s ≥ 0 the screening of each node, positive somewhere. It is the precision matrix
of the Gaussian Markov random field of :mod:`mlbs_actors.gabp`.

:func:`solve` runs conjugate gradients with one multigrid V-cycle as the preconditioner; the cost a node
does not grow with the grid, nor with the unevenness of s (preconditioners that replace s by its mean suffer
from it). The residual it returns with is computed anew; where it misses the tolerance a direct sparse solve
takes over. :func:`inverse_diagonal` is exact: selected inversion with the grid's rows as blocks.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import scipy.sparse
import scipy.sparse.linalg
from numba import njit

from mlbs_actors.errors import SolverError
from mlbs_actors.messages import Array

__all__ = ["Solution", "assemble", "inverse_diagonal", "solve"]


@dataclass(frozen=True, slots=True)
class Solution:
    """What :func:`solve` found.

    Attributes
    ----------
    value : (k, rows, columns) float64
    residual : float
        |b − A d| / |b| over all components.
    iterations : int
        Conjugate-gradient iterations of the slowest component.
    solver : {"multigrid", "direct"}
        What found the value.
    """

    value: Array
    residual: float
    iterations: int
    solver: Literal["multigrid", "direct"]


def solve(
    screening: Array, rhs: Array, edge: float, start: Array, tolerance: float, max_iterations: int
) -> Solution:
    """Solve (edge·L + diag(screening)) d = rhs.

    Parameters
    ----------
    screening : (rows, columns) float64
        ≥ 0, positive somewhere.
    rhs : (k, rows, columns) float64
        Right-hand sides that share the matrix.
    edge : float
        Weight of an edge, > 0.
    start : (k, rows, columns) float64
        First guess.
    tolerance : float
        Largest relative residual to accept.
    max_iterations : int
        Iterations before the direct solver takes over.

    Returns
    -------
    Solution

    Raises
    ------
    SolverError
        If the direct solver misses the tolerance too.
    """
    size = float(np.sqrt(np.sum(rhs * rhs)))
    if size == 0.0:
        return Solution(np.zeros_like(rhs), 0.0, 0, "multigrid")
    levels, edges = _pyramid(screening.shape[0], screening.shape[1], edge)
    value = np.zeros((rhs.shape[0], rhs.shape[1] + 2, rhs.shape[2] + 2))
    value[:, 1:-1, 1:-1] = start
    iterations = _conjugate_gradients(
        screening, rhs, levels, edges, 0.5 * tolerance * size / rhs.shape[0] ** 0.5, max_iterations, value
    )
    value = np.ascontiguousarray(value[:, 1:-1, 1:-1])
    matrix = assemble(screening, edge)
    residual = _residual(matrix, rhs, value) / size
    if residual <= tolerance:
        return Solution(value, residual, iterations, "multigrid")
    factors = scipy.sparse.linalg.splu(matrix.tocsc())
    value = np.stack([factors.solve(part.ravel()) for part in rhs]).reshape(rhs.shape)
    residual = _residual(matrix, rhs, value) / size
    if not residual <= tolerance:
        raise SolverError(
            f"The field could be solved to a relative residual of {residual:.1e} only and {tolerance:.1e} is "
            "wanted; raise the tolerance, or bring the standard deviations of its terms closer together."
        )
    return Solution(value, residual, iterations, "direct")


def assemble(screening: Array, edge: float) -> scipy.sparse.dia_array:
    """Return A as a sparse matrix, nodes in raster order."""
    rows, columns = screening.shape
    beside = np.full((rows, columns), -edge)
    beside[:, -1] = 0.0  # the last node of a row and the first of the next are no neighbours
    beside_flat = beside.ravel()
    below = np.full(rows * columns, -edge)
    diagonal = screening.ravel() + edge * _degree(rows, columns).ravel()
    offsets = [0, 1, -1, columns, -columns]
    data = np.stack(
        [
            diagonal,
            np.roll(beside_flat, 1),
            beside_flat,
            below,
            below,
        ]  # dia format: column j of each diagonal
    )
    if columns == 1:
        offsets, data = [0, 1, -1], np.stack([diagonal, below, below])
    return scipy.sparse.dia_array((data, offsets), shape=(rows * columns, rows * columns))


def inverse_diagonal(screening: Array, edge: float) -> Array:
    """Diagonal of A⁻¹, exactly.

    With the grid's lines as blocks, A has D_i (tridiagonal) on its diagonal and −e·I beside it. Elimination
    gives S_i = D_i − e² S_{i−1}⁻¹, and backwards the diagonal blocks of the inverse are
    G_i = S_i⁻¹ + e² S_i⁻¹ G_{i+1} S_i⁻¹. The cost is O(long side · short side³).

    Parameters
    ----------
    screening : (rows, columns) float64
    edge : float

    Returns
    -------
    (rows, columns) float64
    """
    if screening.shape[0] < screening.shape[1]:  # blocks as long as the shorter side
        return np.ascontiguousarray(inverse_diagonal(screening.T, edge).T)
    rows, columns = screening.shape
    tridiagonal = -edge * (np.eye(columns, k=1) + np.eye(columns, k=-1))
    diagonal = screening + edge * _degree(rows, columns)
    eliminated = np.empty((rows, columns, columns))
    for row in range(rows):
        block = tridiagonal + np.diag(diagonal[row])
        if row > 0:
            block -= edge**2 * eliminated[row - 1]
        eliminated[row] = np.linalg.inv(block)
    result = np.empty((rows, columns))
    inverse = eliminated[-1]
    result[-1] = np.diag(inverse)
    for row in range(rows - 2, -1, -1):
        inverse = eliminated[row] + edge**2 * (eliminated[row] @ inverse @ eliminated[row])
        result[row] = np.diag(inverse)
    return result


def _degree(rows: int, columns: int) -> Array:
    """Number of neighbours of each node."""
    degree = np.zeros((rows, columns))
    degree[1:] += 1
    degree[:-1] += 1
    degree[:, 1:] += 1
    degree[:, :-1] += 1
    return degree


def _residual(matrix: scipy.sparse.dia_array, rhs: Array, value: Array) -> float:
    difference = rhs.reshape(len(rhs), -1).T - matrix @ value.reshape(len(rhs), -1).T
    return float(np.sqrt(np.sum(difference**2)))


# The multigrid pyramid. Level 0 is the grid, each next level joins 2×2 nodes, down to a single one. Joined
# nodes sum their screening and their edges, which is the Galerkin operator of constant interpolation, and the
# edges are then halved: constant interpolation makes a smooth function's gradient twice too steep. Every
# array has a border of zeros, so that no loop asks for the grid's edge; all levels of a quantity lie in one
# array, and the tables say where each starts, its rows and columns, and its edge weights (vertical,
# horizontal).


def _pyramid(rows: int, columns: int, edge: float) -> tuple[Array, Array]:
    levels, edges = [], []
    start, vertical, horizontal = 0, edge, edge
    while True:
        levels.append((start, rows, columns))
        edges.append((vertical, horizontal))
        start += (rows + 2) * (columns + 2)
        if rows == columns == 1:
            return np.array(levels, np.int64), np.array(edges)
        vertical *= 1.0 if columns > 1 else 0.5
        horizontal *= 1.0 if rows > 1 else 0.5
        rows, columns = (rows + 1) // 2, (columns + 1) // 2


@njit(cache=True)
def _level(buffer: Array, levels: Array, level: int) -> Array:
    start, rows, columns = levels[level, 0], levels[level, 1], levels[level, 2]
    return buffer[start : start + (rows + 2) * (columns + 2)].reshape(rows + 2, columns + 2)


@njit(cache=True)
def _sweep(value: Array, rhs: Array, inverse: Array, vertical: float, horizontal: float, colour: int) -> None:
    """Gauss–Seidel on the nodes of one colour of the checkerboard: they depend on the other colour only."""
    for v in range(1, value.shape[0] - 1):
        for u in range(1 + (v + colour) % 2, value.shape[1] - 1, 2):
            value[v, u] = inverse[v, u] * (
                rhs[v, u]
                + vertical * (value[v - 1, u] + value[v + 1, u])
                + horizontal * (value[v, u - 1] + value[v, u + 1])
            )


@njit(cache=True)
def _v_cycle(value: Array, rhs: Array, diagonal: Array, inverse: Array, levels: Array, edges: Array) -> None:
    """Set value ≈ A⁻¹ rhs on level 0. Colours 0, 1 on the way down, 1, 0 up, which makes it symmetric."""
    last = len(levels) - 1
    for level in range(last):
        vertical, horizontal = edges[level, 0], edges[level, 1]
        x, b = _level(value, levels, level), _level(rhs, levels, level)
        d, i = _level(diagonal, levels, level), _level(inverse, levels, level)
        x[:] = 0.0
        _sweep(x, b, i, vertical, horizontal, 0)
        _sweep(x, b, i, vertical, horizontal, 1)
        coarse = _level(rhs, levels, level + 1)
        coarse[:] = 0.0
        for v in range(1, x.shape[0] - 1):
            # The residual of colour 1 is zero: it was swept last.
            for u in range(1 + v % 2, x.shape[1] - 1, 2):
                coarse[(v + 1) // 2, (u + 1) // 2] += (
                    b[v, u]
                    - d[v, u] * x[v, u]
                    + vertical * (x[v - 1, u] + x[v + 1, u])
                    + horizontal * (x[v, u - 1] + x[v, u + 1])
                )
    x, b, i = _level(value, levels, last), _level(rhs, levels, last), _level(inverse, levels, last)
    x[1, 1] = b[1, 1] * i[1, 1]
    for level in range(last - 1, -1, -1):
        x, coarse = _level(value, levels, level), _level(value, levels, level + 1)
        for v in range(1, x.shape[0] - 1):
            for u in range(1, x.shape[1] - 1):
                x[v, u] += coarse[(v + 1) // 2, (u + 1) // 2]
        b, i = _level(rhs, levels, level), _level(inverse, levels, level)
        _sweep(x, b, i, edges[level, 0], edges[level, 1], 1)
        _sweep(x, b, i, edges[level, 0], edges[level, 1], 0)


@njit(cache=True)
def _set_operators(screening: Array, diagonal: Array, inverse: Array, levels: Array, edges: Array) -> None:
    """Diagonal of every level's operator and its reciprocal."""
    summed = np.zeros_like(diagonal)
    _level(summed, levels, 0)[1:-1, 1:-1] = screening
    for level in range(len(levels)):
        s, d, i = (
            _level(summed, levels, level),
            _level(diagonal, levels, level),
            _level(inverse, levels, level),
        )
        rows, columns = levels[level, 1], levels[level, 2]
        for v in range(1, rows + 1):
            vertical = edges[level, 0] * ((v > 1) + (v < rows))
            for u in range(1, columns + 1):
                d[v, u] = s[v, u] + vertical + edges[level, 1] * ((u > 1) + (u < columns))
                i[v, u] = 1.0 / d[v, u]
        if level + 1 < len(levels):
            coarse = _level(summed, levels, level + 1)
            for v in range(1, rows + 1):
                for u in range(1, columns + 1):
                    coarse[(v + 1) // 2, (u + 1) // 2] += s[v, u]


@njit(cache=True)
def _conjugate_gradients(
    screening: Array, rhs: Array, levels: Array, edges: Array, target: float, limit: int, value: Array
) -> int:
    """Improve value (k, rows + 2, columns + 2) until each component's residual norm is ≤ target."""
    total = levels[-1, 0] + 9
    diagonal, inverse, right, result = np.zeros(total), np.zeros(total), np.zeros(total), np.zeros(total)
    _set_operators(screening, diagonal, inverse, levels, edges)
    a, z, edge = _level(diagonal, levels, 0), _level(result, levels, 0), edges[0, 0]
    rows, columns = screening.shape
    residual, direction, product = np.zeros_like(a), np.zeros_like(a), np.zeros_like(a)
    longest = 0
    for part in range(rhs.shape[0]):
        x = value[part]
        for v in range(1, rows + 1):
            for u in range(1, columns + 1):
                near = x[v - 1, u] + x[v + 1, u] + x[v, u - 1] + x[v, u + 1]
                residual[v, u] = rhs[part, v - 1, u - 1] - a[v, u] * x[v, u] + edge * near
        previous = 1.0
        for step in range(limit):
            norm = 0.0
            for v in range(1, rows + 1):
                for u in range(1, columns + 1):
                    norm += residual[v, u] * residual[v, u]
            if np.sqrt(norm) <= target:
                break
            _level(right, levels, 0)[:] = residual
            _v_cycle(result, right, diagonal, inverse, levels, edges)
            descent = 0.0
            for v in range(1, rows + 1):
                for u in range(1, columns + 1):
                    descent += residual[v, u] * z[v, u]
            ratio = descent / previous if step > 0 else 0.0
            previous = descent
            for v in range(1, rows + 1):
                for u in range(1, columns + 1):
                    direction[v, u] = z[v, u] + ratio * direction[v, u]
            curvature = 0.0
            for v in range(1, rows + 1):
                for u in range(1, columns + 1):
                    near = (
                        direction[v - 1, u] + direction[v + 1, u] + direction[v, u - 1] + direction[v, u + 1]
                    )
                    product[v, u] = a[v, u] * direction[v, u] - edge * near
                    curvature += direction[v, u] * product[v, u]
            length = descent / curvature
            for v in range(1, rows + 1):
                for u in range(1, columns + 1):
                    x[v, u] += length * direction[v, u]
                    residual[v, u] -= length * product[v, u]
            longest = max(longest, step + 1)
    return longest
