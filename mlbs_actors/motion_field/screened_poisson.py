"""Solves the screened Poisson equation of a rectangular grid.

The matrix is A = e·L + diag(s): L the Laplacian of the grid's 4-neighbour graph (no edges across the border),
e > 0 the weight of an edge, s ≥ 0 the screening of each node, positive somewhere. It is the precision matrix
of the Gaussian Markov random field of :mod:`mlbs_actors.motion_field.field`.

:func:`solve` runs conjugate gradients with one multigrid V-cycle as the preconditioner; the cost a node
does not grow with the grid, nor with the unevenness of s (preconditioners that replace s by its mean suffer
from it). The V-cycle runs in single precision, which a preconditioner can do, the iterations in double. The
residual they return with is computed anew; where it misses the tolerance the matrix is factorised
(:mod:`mlbs_actors.motion_field.banded_factors`), and so it is at once where the grid is small.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mlbs_actors.kernels.jit import compiled
from mlbs_actors.messages import Array
from mlbs_actors.motion_field.banded_factors import factorised, set_solution

__all__ = ["Solution", "solve"]

#: Grids whose shorter side has at most so many nodes are solved directly: there that takes no longer.
SMALL = 16


class Solution(NamedTuple):
    """What :func:`solve` found.

    Attributes
    ----------
    value : (k, rows, columns) float64
    residual : float
        |b − A d| / |b| over all components.
    iterations : int
        Conjugate-gradient iterations of the slowest component.
    """

    value: Array
    residual: float
    iterations: int


@compiled
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
        Its residual is above the tolerance if the arithmetic allows no less.
    """
    squares = 0.0
    for part in range(rhs.shape[0]):
        for v in range(rhs.shape[1]):
            for u in range(rhs.shape[2]):
                squares += rhs[part, v, u] * rhs[part, v, u]
    size = np.sqrt(squares)
    if size == 0.0:
        return Solution(np.zeros(rhs.shape), 0.0, 0)
    value = np.zeros((rhs.shape[0], rhs.shape[1] + 2, rhs.shape[2] + 2))
    iterations = 0
    if min(screening.shape) > SMALL:
        value[:, 1:-1, 1:-1] = start
        target = 0.5 * tolerance * size / rhs.shape[0] ** 0.5
        iterations = _conjugate_gradients(screening, rhs, edge, target, max_iterations, value)
        residual = _residual(screening, rhs, edge, value) / size
        if residual <= tolerance:
            return Solution(value[:, 1:-1, 1:-1].copy(), residual, iterations)
    lower = factorised(screening, edge)
    for part in range(rhs.shape[0]):
        set_solution(lower, rhs[part], value[part, 1:-1, 1:-1])
    residual = _residual(screening, rhs, edge, value) / size
    return Solution(value[:, 1:-1, 1:-1].copy(), residual, iterations)


@compiled
def _residual(screening: Array, rhs: Array, edge: float, value: Array) -> float:
    """|b − A d| for d with a border of zeros, (k, rows + 2, columns + 2)."""
    rows, columns = screening.shape
    total = 0.0
    for part in range(rhs.shape[0]):
        d = value[part]
        for v in range(1, rows + 1):
            vertical = edge * ((v > 1) + (v < rows))
            for u in range(1, columns + 1):
                own = screening[v - 1, u - 1] + vertical + edge * ((u > 1) + (u < columns))
                near = d[v - 1, u] + d[v + 1, u] + d[v, u - 1] + d[v, u + 1]
                total += (rhs[part, v - 1, u - 1] - own * d[v, u] + edge * near) ** 2
    return float(np.sqrt(total))


# The multigrid pyramid. Level 0 is the grid, each next level joins 2×2 nodes, down to a single one. Joined
# nodes sum their screening and their edges, which is the Galerkin operator of constant interpolation, and the
# edges are then halved: constant interpolation makes a smooth function's gradient twice too steep. Every
# array has a border of zeros, so that no loop asks for the grid's edge; all levels of a quantity lie in one
# array, and the tables say where each starts, its rows and columns, and its edge weights (vertical,
# horizontal). A sweep writes into a second array: in place it could not run in vector registers.


@compiled
def _pyramid(rows: int, columns: int, edge: float) -> tuple[Array, Array]:
    count, longer = 1, max(rows, columns)
    while longer > 1:
        count, longer = count + 1, (longer + 1) // 2
    levels, edges = np.empty((count, 3), np.int64), np.empty((count, 2), np.float32)
    start, vertical, horizontal = 0, edge, edge
    for level in range(count):
        levels[level, 0], levels[level, 1], levels[level, 2] = start, rows, columns
        edges[level, 0], edges[level, 1] = vertical, horizontal
        start += (rows + 2) * (columns + 2)
        vertical *= 1.0 if columns > 1 else 0.5
        horizontal *= 1.0 if rows > 1 else 0.5
        rows, columns = (rows + 1) // 2, (columns + 1) // 2
    return levels, edges


@compiled
def _level(buffer: Array, levels: Array, level: int) -> Array:
    start, rows, columns = levels[level, 0], levels[level, 1], levels[level, 2]
    return buffer[start : start + (rows + 2) * (columns + 2)].reshape(rows + 2, columns + 2)


@compiled
def _sweep(
    value: Array,
    rhs: Array,
    diagonal: Array,
    inverse: Array,
    vertical: float,
    horizontal: float,
    swept: Array,
) -> None:
    """Gauss–Seidel on the nodes of one colour of the checkerboard: they depend on the other colour only.

    ``inverse`` is the diagonal's reciprocal on that colour and 0 elsewhere, so that the others stay.
    """
    inner = value.shape[1] - 2
    for v in range(1, value.shape[0] - 1):
        above, below, b = value[v - 1, 1:], value[v + 1, 1:], rhs[v, 1:]
        left, own, right = value[v], value[v, 1:], value[v, 2:]
        d, i, result = diagonal[v, 1:], inverse[v, 1:], swept[v, 1:]
        for u in range(inner):
            misfit = (
                b[u] - d[u] * own[u] + vertical * (above[u] + below[u]) + horizontal * (left[u] + right[u])
            )
            result[u] = own[u] + i[u] * misfit


@compiled
def _v_cycle(
    value: Array, half: Array, rhs: Array, diagonal: Array, inverse: Array, levels: Array, edges: Array
) -> None:
    """Set value ≈ A⁻¹ rhs on level 0. Colours 0, 1 on the way down, 1, 0 up, which makes it symmetric."""
    last = len(levels) - 1
    for level in range(last):
        vertical, horizontal = edges[level, 0], edges[level, 1]
        x, y, b = _level(value, levels, level), _level(half, levels, level), _level(rhs, levels, level)
        d, i = _level(diagonal, levels, level), _level(inverse[0], levels, level)
        for v in range(1, x.shape[0] - 1):
            for u in range(x.shape[1]):
                y[v, u] = i[v, u] * b[v, u]
        _sweep(y, b, d, _level(inverse[1], levels, level), vertical, horizontal, x)
        coarse = _level(rhs, levels, level + 1)
        coarse[:] = 0.0
        # The residual of colour 1 is zero: it was swept last. That of colour 0 was: its neighbours are left.
        for v in range(1, x.shape[0] - 1):
            for u in range(1, x.shape[1] - 1):
                y[v, u] = vertical * (x[v - 1, u] + x[v + 1, u]) + horizontal * (x[v, u - 1] + x[v, u + 1])
            first = 1 + v % 2
            for j in range((x.shape[1] - first) // 2):
                coarse[(v + 1) // 2, j + 1] += y[v, first + 2 * j]
    x, b, d = _level(value, levels, last), _level(rhs, levels, last), _level(diagonal, levels, last)
    x[1, 1] = b[1, 1] / d[1, 1]
    for level in range(last - 1, -1, -1):
        vertical, horizontal = edges[level, 0], edges[level, 1]
        x, y, b = _level(value, levels, level), _level(half, levels, level), _level(rhs, levels, level)
        d, coarse = _level(diagonal, levels, level), _level(value, levels, level + 1)
        for v in range(1, x.shape[0] - 1):
            own, joined, columns = x[v, 1:], coarse[(v + 1) // 2, 1:], x.shape[1] - 2
            for j in range(columns // 2):
                own[2 * j] += joined[j]
                own[2 * j + 1] += joined[j]
            if columns % 2:
                own[columns - 1] += joined[columns // 2]
        _sweep(x, b, d, _level(inverse[1], levels, level), vertical, horizontal, y)
        _sweep(y, b, d, _level(inverse[0], levels, level), vertical, horizontal, x)


@compiled
def _set_operators(screening: Array, diagonal: Array, inverse: Array, levels: Array, edges: Array) -> None:
    """Diagonal of every level's operator, and its reciprocal on either colour."""
    summed = np.zeros_like(diagonal)
    _level(summed, levels, 0)[1:-1, 1:-1] = screening
    for level in range(len(levels)):
        s, d = _level(summed, levels, level), _level(diagonal, levels, level)
        rows, columns = levels[level, 1], levels[level, 2]
        for v in range(1, rows + 1):
            vertical = edges[level, 0] * ((v > 1) + (v < rows))
            for u in range(1, columns + 1):
                d[v, u] = s[v, u] + vertical + edges[level, 1] * ((u > 1) + (u < columns))
        for colour in range(2):
            i = _level(inverse[colour], levels, level)
            for v in range(1, rows + 1):
                for u in range(1 + (v + colour) % 2, columns + 1, 2):
                    i[v, u] = np.float32(1) / d[v, u]
        if level + 1 < len(levels):
            coarse = _level(summed, levels, level + 1)
            for v in range(1, rows + 1):
                for u in range(1, columns + 1):
                    coarse[(v + 1) // 2, (u + 1) // 2] += s[v, u]


@compiled
def _product(a: Array, b: Array, sums: Array) -> float:
    """Scalar product of two fields; summed by columns, which can run in vector registers."""
    sums[:] = 0.0
    for v in range(1, a.shape[0] - 1):
        first, second = a[v], b[v]
        for u in range(sums.size):
            sums[u] += first[u] * second[u]
    total = 0.0
    for one in sums:
        total += one
    return total


@compiled
def _conjugate_gradients(
    screening: Array, rhs: Array, edge: float, target: float, limit: int, value: Array
) -> int:
    """Improve value (k, rows + 2, columns + 2) until each component's residual norm is ≤ target."""
    levels, edges = _pyramid(screening.shape[0], screening.shape[1], edge)
    total = levels[-1, 0] + 9
    diagonal, inverse = np.zeros(total, np.float32), np.zeros((2, total), np.float32)
    right, half, result = (
        np.zeros(total, np.float32),
        np.zeros(total, np.float32),
        np.zeros(total, np.float32),
    )
    _set_operators(screening, diagonal, inverse, levels, edges)
    z, b = _level(result, levels, 0), _level(right, levels, 0)
    rows, columns = screening.shape
    own = np.zeros((rows + 2, columns + 2))
    for v in range(1, rows + 1):
        for u in range(1, columns + 1):
            own[v, u] = screening[v - 1, u - 1] + edge * ((v > 1) + (v < rows) + (u > 1) + (u < columns))
    residual, direction, product = np.zeros_like(own), np.zeros_like(own), np.zeros_like(own)
    sums = np.empty(columns + 2)
    longest = 0
    for part in range(rhs.shape[0]):
        x = value[part]
        _apply(own, edge, x, product)
        residual[1:-1, 1:-1] = rhs[part] - product[1:-1, 1:-1]
        previous = 1.0
        for step in range(limit):
            if np.sqrt(_product(residual, residual, sums)) <= target:
                break
            for v in range(1, rows + 1):
                for u in range(columns + 2):
                    b[v, u] = residual[v, u]
            _v_cycle(result, half, right, diagonal, inverse, levels, edges)
            descent = _product(residual, z, sums)
            ratio = descent / previous if step > 0 else 0.0
            previous = descent
            for v in range(1, rows + 1):
                for u in range(columns + 2):
                    direction[v, u] = z[v, u] + ratio * direction[v, u]
            _apply(own, edge, direction, product)
            length = descent / _product(direction, product, sums)
            for v in range(1, rows + 1):
                for u in range(columns + 2):
                    x[v, u] += length * direction[v, u]
                    residual[v, u] -= length * product[v, u]
            longest = max(longest, step + 1)
    return longest


@compiled
def _apply(own: Array, edge: float, x: Array, product: Array) -> None:
    """Set product = A x; ``own`` is A's diagonal."""
    inner = x.shape[1] - 2
    for v in range(1, x.shape[0] - 1):
        above, below, diagonal = x[v - 1, 1:], x[v + 1, 1:], own[v, 1:]
        left, centre, right, result = x[v], x[v, 1:], x[v, 2:], product[v, 1:]
        for u in range(inner):
            result[u] = diagonal[u] * centre[u] - edge * (above[u] + below[u] + left[u] + right[u])
