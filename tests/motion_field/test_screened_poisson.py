"""The grid solver against dense algebra."""

from __future__ import annotations

import numpy as np
import pytest

from mlbs_actors.messages import Array
from mlbs_actors.motion_field.screened_poisson import factorised, inverse_diagonal, solved


def dense_matrix(screening: Array, edge: float) -> Array:
    """Return A by looping over nodes and their neighbours."""
    rows, columns = screening.shape
    matrix = np.diag(screening.ravel()).astype(np.float64)
    for v in range(rows):
        for u in range(columns):
            for near_v, near_u in ((v - 1, u), (v + 1, u), (v, u - 1), (v, u + 1)):
                if 0 <= near_v < rows and 0 <= near_u < columns:
                    matrix[v * columns + u, v * columns + u] += edge
                    matrix[v * columns + u, near_v * columns + near_u] -= edge
    return matrix


def uneven_screening(shape: tuple[int, int], seed: int) -> Array:
    """Strong at a few nodes, almost nothing elsewhere, as trajectories on a grid are."""
    rng = np.random.default_rng(seed)
    screening: Array = np.where(rng.random(shape) < 0.2, rng.uniform(0.1, 8.0, shape), 1e-4)
    return screening


SHAPES = [(1, 1), (1, 7), (7, 1), (2, 2), (3, 2), (5, 8), (16, 16), (13, 21), (21, 13), (5, 30)]


@pytest.mark.parametrize("shape", SHAPES)
def test_solutions_are_those_of_a_dense_solve(shape: tuple[int, int]) -> None:
    screening = uneven_screening(shape, 2)
    right = np.random.default_rng(3).normal(size=(2, *shape))
    expected = np.linalg.solve(dense_matrix(screening, 4.0), right.reshape(2, -1).T).T.reshape(right.shape)
    found = solved(factorised(screening, 4.0), right)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)


def test_evidence_in_one_corner_only_reaches_the_opposite_one() -> None:
    screening = np.full((60, 80), 1e-6)
    screening[:5, :5] = 4.0
    right = np.zeros((1, 60, 80))
    right[0, :5, :5] = 4.0 * 3.0
    np.testing.assert_allclose(solved(factorised(screening, 4.0), right)[0, -1, -1], 3.0, atol=0.01)


@pytest.mark.parametrize("shape", SHAPES)
def test_the_inverse_diagonal_is_that_of_the_dense_inverse(shape: tuple[int, int]) -> None:
    screening = uneven_screening(shape, 13)
    expected = np.diag(np.linalg.inv(dense_matrix(screening, 4.0))).reshape(shape)
    np.testing.assert_allclose(inverse_diagonal(factorised(screening, 4.0), shape), expected, rtol=1e-7)
