"""Distances to trajectories, and to what they enclose, against plain loops and array operations."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from read_only import read_only

from mlbs_actors.geometry.distance import (
    closed_distance,
    occupied_cells,
    occupy,
    to_occupied,
    trajectory_distance,
)
from mlbs_actors.messages import Array, Region

CELLS = Region(5, 3, 24, 17)


def scattered(count: int, side: int) -> Array:
    """Inside the region and around it."""
    places = np.random.default_rng(count).uniform(0, 1, (count, 2)) * [34 * side, 25 * side]
    return read_only(places.astype(np.float32))


@pytest.mark.parametrize("side", [1, 2, 3])
def test_a_cells_distance_is_that_to_the_nearest_cell_with_a_trajectory(side: int) -> None:
    positions = scattered(13, side)
    found = trajectory_distance(positions, CELLS, side)
    places = np.rint(positions).astype(int) // side - [CELLS.x, CELLS.y]
    inside = [(x, y) for x, y in places if 0 <= x < CELLS.width and 0 <= y < CELLS.height]
    assert 0 < len(inside) < len(places)
    for y in range(CELLS.height):
        for x in range(CELLS.width):
            nearest = min(np.hypot(x - own_x, y - own_y) for own_x, own_y in inside)
            assert found[y, x] == pytest.approx(side * nearest, rel=0.03)  # it is made of steps


@pytest.mark.parametrize("positions", [np.zeros((0, 2), np.float32), np.ones((3, 2), np.float32)])
def test_without_a_trajectory_in_the_region_it_is_infinite(positions: Array) -> None:
    found = trajectory_distance(read_only(positions), CELLS, 2)
    assert (found == np.full((CELLS.height, CELLS.width), np.inf, np.float32)).all()
    assert (closed_distance(found, np.float32(3.0), 2) == found).all()


def test_positions_occupy_cells_one_after_the_other_as_together() -> None:
    positions = scattered(40, 2)
    cells = (2, CELLS.x, CELLS.y, CELLS.width, CELLS.height)
    occupied = occupied_cells(positions[:20], *cells)
    occupy(occupied, positions[20:], *cells[:3])
    np.testing.assert_array_equal(occupied, occupied_cells(positions, *cells))
    np.testing.assert_array_equal(occupied, trajectory_distance(positions, CELLS, 2) == 0)


@pytest.mark.parametrize("share", [0.002, 0.02, 0.3])
@pytest.mark.parametrize("shape", [(40, 57), (3, 90), (61, 1), (1, 1)])
def test_distances_are_those_of_cv2(shape: tuple[int, int], share: float) -> None:
    rng = np.random.default_rng(shape[0])
    occupied = rng.random(shape) < share
    occupied[rng.integers(shape[0]), rng.integers(shape[1])] = True
    expected = 3 * cv2.distanceTransform((~occupied).view(np.uint8), cv2.DIST_L2, 5)
    np.testing.assert_allclose(to_occupied(occupied, 3), expected, rtol=1e-6)


@pytest.mark.parametrize("side", [1, 2])
def test_the_closing_is_that_of_array_operations(side: int) -> None:
    distance, radius = trajectory_distance(scattered(30, side), CELLS, side), 2.5 * side
    outside = cv2.distanceTransform((distance <= radius).astype(np.uint8), cv2.DIST_L2, 5)
    to_closed = cv2.distanceTransform((outside <= radius / side).astype(np.uint8), cv2.DIST_L2, 5)
    expected = np.minimum(distance, side * to_closed)
    found = closed_distance(distance, np.float32(radius), side)
    np.testing.assert_allclose(found, expected, rtol=1e-6)
    assert ((found == 0) & (distance > 0)).any()
