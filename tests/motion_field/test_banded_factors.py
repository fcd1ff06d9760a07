"""The factors of a grid's matrix against dense algebra."""

from __future__ import annotations

import numpy as np
import pytest
from test_screened_poisson import dense_matrix, uneven_screening

from mlbs_actors.messages import Array
from mlbs_actors.motion_field.banded_factors import factorised, set_solution

SHAPES = [(1, 1), (7, 1), (2, 2), (3, 2), (8, 5), (16, 16), (1, 7), (2, 3), (5, 8)]


def dense_factors(lower: Array, size: int) -> tuple[Array, Array]:
    """L and D as full matrices."""
    unit = np.eye(size)
    for node in range(size):
        for k in range(1, lower.shape[1]):
            if node + k < size:
                unit[node + k, node] = lower[node, k]
    return unit, np.diag(lower[:size, 0])


@pytest.mark.parametrize("shape", SHAPES)
def test_the_factors_multiply_to_the_matrix(shape: tuple[int, int]) -> None:
    screening = uneven_screening(shape, 1)
    unit, diagonal = dense_factors(factorised(screening, 4.0), screening.size)
    numbered = screening if shape[0] >= shape[1] else screening.T  # along the shorter side
    np.testing.assert_allclose(unit @ diagonal @ unit.T, dense_matrix(numbered, 4.0), atol=1e-12)


@pytest.mark.parametrize("shape", SHAPES)
def test_the_solution_is_that_of_a_dense_solve(shape: tuple[int, int]) -> None:
    screening = uneven_screening(shape, 2)
    rhs = np.random.default_rng(3).normal(size=shape)
    expected = np.linalg.solve(dense_matrix(screening, 4.0), rhs.ravel()).reshape(shape)
    solution = np.empty(shape)
    set_solution(factorised(screening, 4.0), rhs, solution)
    np.testing.assert_allclose(solution, expected, rtol=1e-9, atol=1e-9)
