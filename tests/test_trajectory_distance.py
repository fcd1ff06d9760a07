"""Distances to trajectories, and to what they enclose, against plain loops and array operations."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from mlbs_actors.messages import Array, LayerEvidence, Region
from mlbs_actors.trajectory_distance import closed_distance, trajectory_distance

CELLS = Region(5, 3, 24, 17)


def of_positions(positions: Array) -> LayerEvidence:
    positions = positions.astype(np.float32)
    return LayerEvidence(1, "object", -1, positions, np.zeros_like(positions))


def scattered(count: int, side: int) -> Array:
    """Inside the region and around it."""
    return np.random.default_rng(count).uniform(0, 1, (count, 2)) * [34 * side, 25 * side]


@pytest.mark.parametrize("side", [1, 2, 3])
def test_a_cells_distance_is_that_to_the_nearest_cell_with_a_trajectory(side: int) -> None:
    positions = scattered(9, side), scattered(4, side)
    found = trajectory_distance([of_positions(one) for one in positions], CELLS, side)
    places = np.rint(np.concatenate(positions)).astype(int) // side - [CELLS.x, CELLS.y]
    inside = [(x, y) for x, y in places if 0 <= x < CELLS.width and 0 <= y < CELLS.height]
    assert 0 < len(inside) < len(places)
    for y in range(CELLS.height):
        for x in range(CELLS.width):
            nearest = min(np.hypot(x - own_x, y - own_y) for own_x, own_y in inside)
            assert found[y, x] == pytest.approx(side * nearest, rel=0.03)  # cv2's is made of steps


@pytest.mark.parametrize("layers", [[], [of_positions(np.zeros((0, 2)))], [of_positions(np.ones((3, 2)))]])
def test_without_a_trajectory_in_the_region_it_is_infinite(layers: list[LayerEvidence]) -> None:
    found = trajectory_distance(layers, CELLS, 2)
    assert (found == np.full((CELLS.height, CELLS.width), np.inf, np.float32)).all()
    assert closed_distance(found, 3.0, 2) is found


@pytest.mark.parametrize("side", [1, 2])
def test_the_closing_is_that_of_array_operations(side: int) -> None:
    distance, radius = trajectory_distance([of_positions(scattered(30, side))], CELLS, side), 2.5 * side
    outside = cv2.distanceTransform((distance <= radius).astype(np.uint8), cv2.DIST_L2, 5)
    to_closed = cv2.distanceTransform((outside <= radius / side).astype(np.uint8), cv2.DIST_L2, 5)
    expected = np.minimum(distance, side * to_closed)
    found = closed_distance(distance, radius, side)
    np.testing.assert_array_equal(found, expected)
    assert ((found == 0) & (distance > 0)).any()
