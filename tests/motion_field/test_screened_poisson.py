"""The grid solver against dense algebra."""

from __future__ import annotations

import numpy as np
import pytest

from mlbs_actors.messages import Array
from mlbs_actors.motion_field.screened_poisson import SMALL, solve
from mlbs_actors.motion_field.selected_inversion import inverse_diagonal


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
@pytest.mark.parametrize("iterations", [0, 60])
def test_both_solvers_agree_with_a_dense_solve(shape: tuple[int, int], iterations: int) -> None:
    screening = uneven_screening(shape, 2)
    rhs = np.random.default_rng(3).normal(size=(2, *shape))
    solution = solve(screening, rhs, 4.0, np.zeros_like(rhs), 1e-10, iterations)
    assert solution.residual <= 1e-10
    # Small grids are solved without an iteration.
    assert (solution.iterations > 0) == (iterations > 0 and min(shape) > SMALL)
    expected = np.linalg.solve(dense_matrix(screening, 4.0), rhs.reshape(2, -1).T).T.reshape(rhs.shape)
    np.testing.assert_allclose(solution.value, expected, rtol=1e-6, atol=1e-6 * np.abs(expected).max())


def test_the_number_of_iterations_does_not_grow_with_the_grid() -> None:
    iterations = []
    for shape in ((15, 20), (30, 40), (120, 160)):
        screening = uneven_screening(shape, 4)
        rhs = np.random.default_rng(5).normal(size=(2, *shape))
        iterations.append(solve(screening, rhs, 4.0, np.zeros_like(rhs), 1e-6, 60).iterations)
    assert max(iterations) <= 12


def test_evidence_in_one_corner_only_still_converges() -> None:
    screening = np.full((60, 80), 1e-6)
    screening[:5, :5] = 4.0
    rhs = np.zeros((1, 60, 80))
    rhs[0, :5, :5] = 4.0 * 3.0
    solution = solve(screening, rhs, 4.0, np.zeros_like(rhs), 1e-8, 60)
    assert solution.iterations > 0
    np.testing.assert_allclose(solution.value[0, -1, -1], 3.0, atol=0.01)


def test_a_good_first_guess_saves_iterations() -> None:
    screening = uneven_screening((40, 40), 6)
    rhs = np.random.default_rng(7).normal(size=(2, 40, 40))
    cold = solve(screening, rhs, 4.0, np.zeros_like(rhs), 1e-8, 60)
    warm = solve(screening, rhs, 4.0, cold.value, 1e-6, 60)
    assert warm.iterations == 0
    assert cold.iterations > 0


def test_the_direct_solver_takes_over_when_iterations_run_out() -> None:
    screening = uneven_screening((22, 19), 8)
    rhs = np.random.default_rng(9).normal(size=(2, 22, 19))
    solution = solve(screening, rhs, 4.0, np.zeros_like(rhs), 1e-9, 1)
    assert solution.iterations == 1
    assert solution.residual <= 1e-9
    expected = np.linalg.solve(dense_matrix(screening, 4.0), rhs.reshape(2, -1).T).T.reshape(rhs.shape)
    np.testing.assert_allclose(solution.value, expected, rtol=1e-6, atol=1e-6)


def test_nothing_on_the_right_gives_nothing() -> None:
    rhs = np.zeros((2, 5, 5))
    solution = solve(uneven_screening((5, 5), 12), rhs, 4.0, np.ones_like(rhs), 1e-6, 10)
    assert not solution.value.any()
    assert solution.residual == 0.0


@pytest.mark.parametrize("shape", SHAPES)
def test_the_inverse_diagonal_is_that_of_the_dense_inverse(shape: tuple[int, int]) -> None:
    screening = uneven_screening(shape, 13)
    expected = np.diag(np.linalg.inv(dense_matrix(screening, 4.0))).reshape(shape)
    np.testing.assert_allclose(inverse_diagonal(screening, 4.0), expected, rtol=1e-7)
