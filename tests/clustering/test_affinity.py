"""The trajectories' graph: neighbours, max-over-time motion distances and affinities against plain loops."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from mlbs_actors.clustering.affinity import TrajectoryGraph, displacement_spread, trajectory_graph
from mlbs_actors.config import AffinityConfig, TrajectoriesConfig, length_scale
from mlbs_actors.messages import Array
from mlbs_actors.tracking.trajectories import TrajectoryState, empty_trajectories

SHAPE = (240, 320)
HISTORY = 6
CONFIG = AffinityConfig(
    neighbours=5,
    radius_px=67.0,
    motion_floor_px=1.5,
    motion_relative=0.1,
    object_relative=0.15,
    motion_factor=0.5,
    forgetting=0.005,
)


def trajectories(positions: Array, residuals: Array, ages: Array) -> TrajectoryState:
    count = len(positions)
    known = np.arange(HISTORY)[None, :, None] < np.asarray(ages)[:, None, None]
    residuals = np.where(known, residuals, 0.0).astype(np.float32)
    return replace(
        empty_trajectories(TrajectoriesConfig(history_frames=HISTORY)),
        ids=np.arange(count, dtype=np.int64),
        positions=np.ascontiguousarray(positions, np.float32),
        motions=residuals[:, 0].copy(),
        residuals=residuals,
        ages=np.ascontiguousarray(ages, np.int32),
        evidence=np.zeros(count, np.float32),
        next_id=count,
    )


def random_trajectories(count: int, seed: int = 0) -> TrajectoryState:
    rng = np.random.default_rng(seed)
    return trajectories(
        rng.uniform((0, 0), (319, 239), (count, 2)),
        rng.normal(0, 2, (count, HISTORY, 2)),
        rng.integers(0, HISTORY + 1, count),
    )


def spreads(value: float = 2.0) -> Array:
    return value + 0.25 * np.arange(HISTORY)


def reference_distance(
    one: TrajectoryState, i: int, j: int, units: Array, config: AffinityConfig = CONFIG
) -> float:
    """Max over the common life of the squared difference of two-frame displacements over the noise."""
    common = min(int(one.ages[i]), int(one.ages[j]))
    if common == 0:
        return 0.0
    spans = [(age, age + 1) for age in range(common - 1)] or [(0, 0)]  # one motion counts twice
    distances = []
    for age, before in spans:
        of_i = one.residuals[i, age].astype(float) + one.residuals[i, before]
        of_j = one.residuals[j, age].astype(float) + one.residuals[j, before]
        mean_length = (np.linalg.norm(of_i) + np.linalg.norm(of_j)) / 2
        noise = (config.motion_factor * units[age]) ** 2 + (config.object_relative * mean_length) ** 2
        distances.append((1 - config.forgetting) ** age * np.sum((of_i - of_j) ** 2) / noise)
    return float(max(distances))


def edge(graph: TrajectoryGraph) -> tuple[float, float]:
    """Motion distance and affinity of a graph of two trajectories."""
    assert graph.first.tolist() == [0]
    assert graph.second.tolist() == [1]
    return float(graph.motion_distance[0]), float(graph.affinity[0])


def pair(residuals: list[list[float]], ages: tuple[int, int] = (HISTORY, HISTORY)) -> TrajectoryState:
    """Two neighbours; the first stands still, the second has these residuals, newest first."""
    second = np.zeros((HISTORY, 2))
    second[: len(residuals)] = residuals
    return trajectories(
        np.array([[100, 100], [104, 100]]), np.stack([np.zeros((HISTORY, 2)), second]), np.array(ages)
    )


@pytest.mark.parametrize("seed", range(3))
def test_motion_distances_are_those_of_plain_loops(seed: int) -> None:
    state = random_trajectories(120, seed)
    graph = trajectory_graph(state, spreads(), SHAPE, CONFIG)
    assert len(graph.first) > 100
    expected = [
        reference_distance(state, int(i), int(j), spreads())
        for i, j in zip(graph.first, graph.second, strict=True)
    ]
    np.testing.assert_allclose(graph.motion_distance, expected, rtol=1e-4, atol=1e-6)


def test_every_trajectory_is_joined_to_its_nearest_ones_within_the_radius_and_to_no_other() -> None:
    state = random_trajectories(150)
    radius = CONFIG.radius_px * length_scale(*SHAPE)
    graph = trajectory_graph(state, spreads(), SHAPE, CONFIG)
    expected = set()
    for i in range(len(state)):
        gaps = np.linalg.norm(state.positions - state.positions[i], axis=1)
        nearest = [int(j) for j in np.argsort(gaps) if j != i][: CONFIG.neighbours]
        expected |= {(min(i, j), max(i, j)) for j in nearest if gaps[j] < radius}
    pairs = list(zip(graph.first.tolist(), graph.second.tolist(), strict=True))
    assert pairs == sorted(expected)


def test_an_affinity_falls_with_motion_and_with_place() -> None:
    state = random_trajectories(80)
    radius = CONFIG.radius_px * length_scale(*SHAPE)
    graph = trajectory_graph(state, spreads(), SHAPE, CONFIG)
    gaps = np.linalg.norm(state.positions[graph.first] - state.positions[graph.second], axis=1)
    expected = np.exp(-graph.motion_distance.astype(float) - (gaps / radius) ** 2)
    np.testing.assert_allclose(graph.affinity, expected, rtol=1e-4, atol=1e-30)


def test_the_matrix_is_symmetric_and_holds_every_edge_twice() -> None:
    graph = trajectory_graph(random_trajectories(60), spreads(), SHAPE, CONFIG)
    dense = graph.matrix().toarray()
    assert dense.shape == (60, 60)
    np.testing.assert_array_equal(dense, dense.T)
    assert not np.diag(dense).any()
    for i, j, value in zip(graph.first, graph.second, graph.affinity, strict=True):
        assert dense[i, j] == value
    assert np.count_nonzero(dense) == 2 * np.count_nonzero(graph.affinity)


def test_what_moves_alike_is_near_and_what_moves_apart_is_far() -> None:
    together = edge(trajectory_graph(pair([[0.0, 0.0]] * HISTORY), spreads(), SHAPE, CONFIG))
    apart = edge(trajectory_graph(pair([[5.0, 0.0]] * HISTORY), spreads(), SHAPE, CONFIG))
    assert together[0] == 0.0
    assert together[1] > 0.9
    assert apart[0] > 5.0
    assert apart[1] < 0.01


def test_what_moved_apart_once_stays_apart_but_is_slowly_forgiven() -> None:
    distances = []
    for frames_ago in range(HISTORY - 1):
        residuals = [[0.0, 0.0]] * frames_ago + [[6.0, 0.0]]
        distances.append(edge(trajectory_graph(pair(residuals), np.full(HISTORY, 2.0), SHAPE, CONFIG))[0])
    assert distances[0] > 5.0
    assert all(later <= earlier for earlier, later in pairwise(distances))
    assert 0.9 * distances[0] < distances[-1] < distances[0]


def test_only_the_common_life_counts() -> None:
    residuals = [[0.0, 0.0], [0.0, 0.0], [0.0, 0.0], [9.0, 0.0]]
    old = edge(trajectory_graph(pair(residuals), spreads(), SHAPE, CONFIG))
    young = edge(trajectory_graph(pair(residuals, ages=(3, HISTORY)), spreads(), SHAPE, CONFIG))
    assert old[0] > 5.0
    assert young[0] == 0.0


def test_the_distance_does_not_depend_on_the_order_of_a_pair() -> None:
    state = random_trajectories(40, seed=4)
    turned = trajectories(state.positions[::-1], state.residuals[::-1], state.ages[::-1])
    forward = trajectory_graph(state, spreads(), SHAPE, CONFIG).matrix().toarray()
    backward = trajectory_graph(turned, spreads(), SHAPE, CONFIG).matrix().toarray()
    np.testing.assert_allclose(forward, backward[::-1, ::-1], rtol=1e-5, atol=1e-30)


@pytest.mark.parametrize("count", [0, 1])
def test_fewer_than_two_trajectories_have_no_edge(count: int) -> None:
    graph = trajectory_graph(random_trajectories(count), spreads(), SHAPE, CONFIG)
    assert len(graph.first) == 0
    assert graph.matrix().shape == (count, count)


def test_trajectories_at_one_place_have_finite_affinities() -> None:
    state = trajectories(np.full((4, 2), 50.0), np.zeros((4, HISTORY, 2)), np.full(4, HISTORY))
    graph = trajectory_graph(state, spreads(), SHAPE, CONFIG)
    assert len(graph.first) == 6
    np.testing.assert_allclose(graph.affinity, 1.0)


def test_the_spread_grows_with_the_camera_but_not_with_a_fast_minority_and_has_a_floor() -> None:
    def spread(camera: float, object_motion: float, scale: float = 1.0) -> float:
        motions = np.full((100, 2), (camera, 0.0), np.float32)
        motions[:20] += (0.0, object_motion)
        state = trajectories(np.zeros((100, 2)), np.zeros((100, HISTORY, 2)), np.full(100, 3))
        return displacement_spread(replace(state, motions=motions), CONFIG, scale)

    assert spread(0.0, 0.0) == CONFIG.motion_floor_px
    assert spread(0.0, 0.0, scale=2.0) == 2 * CONFIG.motion_floor_px
    assert spread(60.0, 0.0) > 2 * spread(20.0, 0.0) > 2 * CONFIG.motion_floor_px
    assert spread(20.0, 50.0) == pytest.approx(spread(20.0, 0.0))
    for count in (1, 6, 7):
        motions = np.random.default_rng(count).normal(0, 30, (count + 2, 2)).astype(np.float32)
        ages = np.array([0, *[2] * count, 0])
        state = trajectories(np.zeros((len(ages), 2)), np.zeros((len(ages), HISTORY, 2)), ages)
        some = replace(state, motions=motions)
        median = float(np.median(np.hypot(*motions[1:-1].T)))
        assert displacement_spread(some, CONFIG, 0.0) == 2 * CONFIG.motion_relative * median
    unknown = trajectories(np.zeros((5, 2)), np.zeros((5, HISTORY, 2)), np.zeros(5))
    assert displacement_spread(unknown, CONFIG, 1.0) == CONFIG.motion_floor_px
