"""The nearest neighbours of points, against a k-d tree and against all distances."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from mlbs_actors.clustering.nearest_neighbours import nearest, neighbour_pairs
from mlbs_actors.messages import Array

RNG = np.random.default_rng(4)
CLOUDS = {
    "even": RNG.uniform(0, 100, (400, 2)),
    "two clumps": np.concatenate([RNG.normal(0, 1, (200, 2)), RNG.normal(80, 5, (100, 2))]),
    "a line": np.stack([np.linspace(0, 300, 150), np.full(150, 7.0)], axis=1),
    "a grid": np.stack(np.meshgrid(np.arange(15.0), np.arange(20.0)), axis=2).reshape(-1, 2) * 8,
    "one place": np.full((30, 2), 5.0),
    "a pair": np.array([[0.0, 0.0], [3.0, 4.0]]),
    "alone": np.array([[1.0, 2.0]]),
}


@pytest.mark.parametrize("cloud", CLOUDS)
@pytest.mark.parametrize("radius", [4.0, 25.0, 1000.0])
def test_the_nearest_are_as_far_as_those_of_a_tree(cloud: str, radius: float) -> None:
    points = CLOUDS[cloud].astype(np.float32)
    found = nearest(points, 6, radius)
    distance = np.asarray(cKDTree(points).query(points, k=7, distance_upper_bound=radius * (1 + 1e-6))[0])
    for i, row in enumerate(found):
        known = row[row >= 0]
        assert i not in known
        assert len(set(known.tolist())) == len(known)
        gaps = np.sort(np.hypot(*(points[known] - points[i]).T))
        np.testing.assert_allclose(gaps, distance[i][np.isfinite(distance[i])][1:], atol=1e-4)


def test_equally_far_points_come_by_their_index() -> None:
    points = np.array([[0, 0], [1, 0], [0, 1], [-1, 0], [0, -1]], np.float32)
    np.testing.assert_array_equal(nearest(points, 3, 10.0)[0], [1, 2, 3])


def all_pairs(points: Array, wanted: int, radius: float) -> list[tuple[int, int]]:
    rows = nearest(points, wanted, radius)
    pairs = {(min(i, int(j)), max(i, int(j))) for i, row in enumerate(rows) for j in row if j >= 0}
    return sorted(pairs)


@pytest.mark.parametrize("cloud", CLOUDS)
def test_pairs_are_sorted_and_each_comes_once(cloud: str) -> None:
    points = CLOUDS[cloud].astype(np.float32)
    first, second = neighbour_pairs(points, 5, 30.0)
    assert list(zip(first.tolist(), second.tolist(), strict=True)) == all_pairs(points, 5, 30.0)


@pytest.mark.parametrize("wanted", [1, 4, 7])
def test_distances_that_differ_in_their_last_bits_are_told_apart(wanted: int) -> None:
    x = np.full(9, 3.0, np.float32)
    for i in range(1, 9):
        x[i] = np.nextafter(x[i - 1], np.float32(4))
    points = np.stack([np.r_[np.float32(0), x], np.zeros(10, np.float32)], axis=1)
    assert set(nearest(points, wanted, 50.0)[0].tolist()) == set(range(1, wanted + 1))
