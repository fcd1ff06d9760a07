"""The nodes' values at pixels, against plain loops."""

from __future__ import annotations

import numpy as np
import pytest

from mlbs_actors.messages import Array
from mlbs_actors.motion_field.node_grid import to_pixels


def one_by_one(values: Array, spacing: int, height: int, width: int) -> Array:
    def between(nodes: Array, place: float) -> Array:
        place = min(max((place + 0.5) / spacing - 0.5, 0.0), len(nodes) - 1.0)
        before = int(place)
        after = min(before + 1, len(nodes) - 1)
        return np.asarray(nodes[before] + (place - before) * (nodes[after] - nodes[before]))

    exact = values.astype(np.float64)
    rows = [between(exact, y) for y in range(height)]
    return np.array([[between(row, x) for x in range(width)] for row in rows])


@pytest.mark.parametrize("grid", [(9, 7), (1, 6), (5, 1), (1, 1), (2, 30)])
@pytest.mark.parametrize(("components", "spacing"), [(2, 1), (2, 3), (2, 6), (2, 8), (1, 2), (1, 16)])
def test_values_at_pixels_lie_between_those_of_the_nodes_around(
    grid: tuple[int, int], components: int, spacing: int
) -> None:
    values = np.random.default_rng(0).normal(0, 3, (*grid, components)).astype(np.float32)
    height, width = grid[0] * spacing - spacing // 2, grid[1] * spacing - spacing // 3
    found = to_pixels(values, spacing, height, width)
    np.testing.assert_allclose(found, one_by_one(values, spacing, height, width), atol=2e-5)


def test_a_region_without_pixels_has_none() -> None:
    assert to_pixels(np.zeros((0, 0, 2), np.float32), 4, 0, 0).shape == (0, 0, 2)
