"""The motion field against dense algebra, message passing and known motions."""

from __future__ import annotations

import numpy as np
import pytest

from mlbs_actors.errors import SolverError
from mlbs_actors.messages import Array
from mlbs_actors.motion_field.field import MotionParameters, motion_field
from mlbs_actors.motion_field.node_grid import grid_shape, node_positions

PLAIN = MotionParameters(robust_rounds=0)
SAME_GRID = PLAIN._replace(variance_spacing_px=PLAIN.spacing_px)


def dense_model(
    positions: Array, motions: Array, shape: tuple[int, int], prior: Array, parameters: MotionParameters
) -> tuple[Array, Array, tuple[int, int]]:
    """A and b of the paper's model by plain loops over the nodes and the points."""
    spacing = parameters.spacing_px
    rows, columns = -(-shape[0] // spacing), -(-shape[1] // spacing)
    size = rows * columns
    A = np.eye(size) / (parameters.prior_std_px**2 * size)
    b = np.zeros((size, 2))
    for v in range(rows):
        for u in range(columns):
            for near_v, near_u in ((v, u + 1), (v + 1, u)):
                if near_v < rows and near_u < columns:
                    i, j = v * columns + u, near_v * columns + near_u
                    A[i, i] += 1 / parameters.smoothness_std_px**2
                    A[j, j] += 1 / parameters.smoothness_std_px**2
                    A[i, j] -= 1 / parameters.smoothness_std_px**2
                    A[j, i] -= 1 / parameters.smoothness_std_px**2
    for (x, y), motion in zip(positions, motions, strict=True):
        u = min(max((x + 0.5) / spacing - 0.5, 0), columns - 1)
        v = min(max((y + 0.5) / spacing - 0.5, 0), rows - 1)
        for near_v in range(rows):
            for near_u in range(columns):
                share = max(0.0, 1 - abs(near_v - v)) * max(0.0, 1 - abs(near_u - u))
                i = near_v * columns + near_u
                A[i, i] += share / parameters.point_std_px**2
                b[i] += share * (motion - prior) / parameters.point_std_px**2
    return A, b, (rows, columns)


def scattered(count: int, shape: tuple[int, int], seed: int) -> tuple[Array, Array]:
    rng = np.random.default_rng(seed)
    positions = rng.uniform(0, 1, (count, 2)) * [shape[1] - 1, shape[0] - 1]
    return positions, rng.normal(0, 3, (count, 2))


@pytest.mark.parametrize("shape", [(32, 48), (30, 41), (4, 4), (3, 90)])
def test_mean_and_variance_agree_with_the_dense_inverse(shape: tuple[int, int]) -> None:
    positions, motions = scattered(12, shape, 0)
    prior = np.array([1.0, -2.0])
    field = motion_field(positions, motions, shape, prior, SAME_GRID)
    A, b, grid = dense_model(positions, motions, shape, prior, SAME_GRID)
    inverse = np.linalg.inv(A)
    np.testing.assert_allclose(field.mean, (inverse @ b).reshape(*grid, 2) + prior, atol=1e-4)
    np.testing.assert_allclose(field.variance, np.diag(inverse).reshape(grid), rtol=1e-4)


def pass_messages(A: Array, b: Array, rounds: int) -> tuple[Array, Array]:
    """Gaussian belief propagation on the graph of A: means and (wrong, on a loopy graph) variances."""
    size = len(b)
    precision, potential = np.zeros((size, size)), np.zeros((size, size))
    neighbours = [[j for j in range(size) if j != i and A[i, j] != 0] for i in range(size)]
    for _ in range(rounds):
        new_precision, new_potential = precision.copy(), potential.copy()
        for i in range(size):
            for j in neighbours[i]:
                own = A[i, i] + sum(precision[k, i] for k in neighbours[i] if k != j)
                mean = b[i] + sum(potential[k, i] for k in neighbours[i] if k != j)
                new_precision[i, j] = -(A[i, j] ** 2) / own
                new_potential[i, j] = -A[i, j] * mean / own
        precision, potential = new_precision, new_potential
    total = np.diag(A) + precision.sum(axis=0)
    return (b + potential.sum(axis=0)) / total, 1 / total


def test_message_passing_converges_to_the_same_mean_but_not_to_the_same_variances() -> None:
    shape = (32, 32)
    positions, motions = scattered(40, shape, 1)
    field = motion_field(positions, motions, shape, np.zeros(2), SAME_GRID)
    A, b, grid = dense_model(positions, motions, shape, np.zeros(2), SAME_GRID)
    mean, variance = pass_messages(A, b[:, 0], 200)
    np.testing.assert_allclose(field.mean[..., 0], mean.reshape(grid), atol=1e-4)
    ratio = variance.reshape(grid) / field.variance
    assert 0.1 < ratio.min() < ratio.max() < 1.0


def test_the_model_is_walk_summable_whatever_the_evidence() -> None:
    for seed in range(3):
        positions, motions = scattered(15, (24, 24), seed)
        A, _, _ = dense_model(positions, motions, (24, 24), np.zeros(2), PLAIN)
        scale = 1 / np.sqrt(np.diag(A))
        walks = np.abs(np.eye(len(A)) - scale[:, None] * A * scale[None, :])
        assert np.abs(np.linalg.eigvalsh(walks)).max() < 1


def test_a_layer_without_evidence_moves_as_its_prior() -> None:
    nodes = node_positions((40, 60), 4)
    prior = 0.02 * nodes
    field = motion_field(np.zeros((0, 2)), np.zeros((0, 2)), (40, 60), prior, MotionParameters())
    np.testing.assert_allclose(field.mean, prior, atol=1e-6)
    assert (field.variance > 100).all()  # it knows the field as a whole to ± prior_std_px = 20 px only


def test_a_single_trajectory_moves_the_whole_layer() -> None:
    field = motion_field(np.array([[20.0, 20.0]]), np.array([[5.0, -3.0]]), (40, 60), np.zeros(2), PLAIN)
    np.testing.assert_allclose(field.dense()[35, 55], [5.0, -3.0], atol=0.05)


def test_the_camera_as_prior_reaches_where_no_trajectory_is() -> None:
    shape = (120, 160)
    rng = np.random.default_rng(2)
    positions = rng.uniform(0, 1, (100, 2)) * [79, 119]  # the left half only
    zoom = 0.03
    field = motion_field(
        positions, zoom * positions + 1.0, shape, zoom * node_positions(shape, 4), MotionParameters()
    )
    y, x = np.mgrid[:120, :160]
    inner = (slice(4, -4), slice(4, -4))
    np.testing.assert_allclose(field.dense()[inner], (zoom * np.dstack([x, y]) + 1.0)[inner], atol=0.05)


def test_a_few_wrong_trajectories_do_not_bend_the_field() -> None:
    rng = np.random.default_rng(3)
    positions = rng.uniform(0, 1, (300, 2)) * [159, 119]
    motions = np.array([2.0, 1.0]) + rng.normal(0, 0.1, (300, 2))
    motions[:24] += [12.0, -9.0]
    robust = motion_field(positions, motions, (120, 160), np.zeros(2), MotionParameters())
    plain = motion_field(positions, motions, (120, 160), np.zeros(2), MotionParameters(robust_rounds=0))
    wrong_by = np.abs(robust.dense() - [2.0, 1.0]).max()
    assert wrong_by < 0.3
    assert np.abs(plain.dense() - [2.0, 1.0]).max() > 5 * wrong_by
    assert robust.point_weights[:24].max() < 0.1
    assert robust.point_weights[24:].min() > 0.5


def test_points_outside_the_region_say_nothing() -> None:
    positions = np.array([[5.0, 5.0], [-3.0, 5.0], [5.0, 16.0]])
    motions = np.array([[1.0, 1.0], [50.0, 50.0], [-50.0, 0.0]])
    field = motion_field(positions, motions, (16, 16), np.zeros(2), MotionParameters())
    alone = motion_field(positions[:1], motions[:1], (16, 16), np.zeros(2), MotionParameters())
    np.testing.assert_array_equal(field.mean, alone.mean)
    assert list(field.point_weights[1:]) == [0.0, 0.0]


def test_a_field_linear_in_space_is_upsampled_exactly() -> None:
    prior = node_positions((41, 63), 4) * np.array([0.5, -0.25])
    field = motion_field(np.zeros((0, 2)), np.zeros((0, 2)), (41, 63), prior, MotionParameters())
    y, x = np.mgrid[:41, :63]
    inner = (slice(2, -3), slice(2, -3))  # past the outer nodes it is constant
    np.testing.assert_allclose(field.dense()[inner], np.dstack([0.5 * x, -0.25 * y])[inner], atol=1e-4)
    assert field.dense().shape == (41, 63, 2)
    assert field.dense_variance().shape == (41, 63)


@pytest.mark.parametrize(("spacing", "median", "tail"), [(8, 0.07, 0.2), (16, 0.13, 0.35), (32, 0.15, 0.4)])
def test_the_coarse_variance_is_near_that_of_the_mean_s_own_grid(
    spacing: int, median: float, tail: float
) -> None:
    for count in (20, 400):
        positions, motions = scattered(count, (160, 240), 4)
        exact = motion_field(positions, motions, (160, 240), np.zeros(2), SAME_GRID).dense_variance()
        parameters = PLAIN._replace(variance_spacing_px=spacing)
        coarse = motion_field(positions, motions, (160, 240), np.zeros(2), parameters).dense_variance()
        error = np.abs(coarse / exact - 1)
        assert np.median(error) < median
        assert np.quantile(error, 0.95) < tail


def test_a_region_without_pixels_has_an_empty_field() -> None:
    field = motion_field(np.zeros((2, 2)), np.zeros((2, 2)), (0, 0), np.zeros(2), MotionParameters())
    assert field.dense().shape == (0, 0, 2)
    assert field.dense_variance().shape == (0, 0)
    assert list(field.point_weights) == [0.0, 0.0]


def test_terms_too_far_apart_for_double_precision_are_refused() -> None:
    parameters = MotionParameters(smoothness_std_px=1e-9, prior_std_px=1e9)
    with pytest.raises(SolverError, match="closer together"):
        motion_field(np.zeros((0, 2)), np.zeros((0, 2)), (80, 80), np.zeros(2), parameters)


def test_evidence_that_is_not_finite_is_refused() -> None:
    with pytest.raises(SolverError, match="finite"):
        motion_field(np.array([[1.0, np.nan]]), np.zeros((1, 2)), (8, 8), np.zeros(2), MotionParameters())


@pytest.mark.parametrize("side", [1, 2, 3])
def test_the_field_at_cells_is_the_mean_of_their_pixels(side: int) -> None:
    rng = np.random.default_rng(4)
    positions = rng.uniform(0, 40, (30, 2))
    parameters = PLAIN._replace(spacing_px=6, variance_spacing_px=12)
    field = motion_field(positions, rng.normal(0, 1, (30, 2)), (36, 42), np.zeros(2), parameters)
    expected = field.dense().reshape(36 // side, side, 42 // side, side, 2).mean(axis=(1, 3))
    np.testing.assert_allclose(field.dense(side), expected, atol=0.1)
    expected = field.dense_variance().reshape(36 // side, side, 42 // side, side).mean(axis=(1, 3))
    np.testing.assert_allclose(field.dense_variance(side), expected, rtol=0.1)


@pytest.mark.parametrize("shape", [(0, 0), (20, 0), (0, 30)])
@pytest.mark.parametrize("side", [1, 2, 3, 5])
def test_a_region_without_pixels_has_a_field_of_no_cells(shape: tuple[int, int], side: int) -> None:
    field = motion_field(np.zeros((0, 2)), np.zeros((0, 2)), shape, np.ones(2), PLAIN)
    height, width = grid_shape(shape, side)
    assert field.dense(side).shape == (height, width, 2)
    assert field.dense_variance(side).shape == (height, width)


def test_positions_may_be_those_in_the_frame_of_a_region_in_it() -> None:
    rng = np.random.default_rng(12)
    positions, motions = rng.uniform(-5, 45, (60, 2)), rng.normal(0, 1, (60, 2))
    local = motion_field(positions, motions, (36, 42), np.zeros(2), PLAIN)
    found = motion_field(positions + np.array([30, 20]), motions, (36, 42), np.zeros(2), PLAIN, (30, 20))
    np.testing.assert_allclose(found.mean, local.mean, atol=1e-6)
    np.testing.assert_array_equal(found.point_weights, local.point_weights)
    assert (found.point_weights == 0).any()
