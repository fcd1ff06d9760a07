"""The nodes' values at pixels, against those that cv2 has between them."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from mlbs_actors.messages import Array
from mlbs_actors.node_grid import to_pixels


def by_cv2(values: Array, spacing: int) -> Array:
    size = (values.shape[1] * spacing, values.shape[0] * spacing)
    shape = (size[1], size[0], values.shape[2])
    return np.asarray(cv2.resize(values, size, interpolation=cv2.INTER_LINEAR)).reshape(shape)


@pytest.mark.parametrize("grid", [(9, 7), (1, 6), (5, 1), (1, 1), (2, 30)])
@pytest.mark.parametrize(("components", "spacing"), [(2, 1), (2, 3), (2, 6), (2, 8), (1, 2), (1, 16)])
def test_between_nodes_values_are_those_of_cv2_to_the_last_bit(
    grid: tuple[int, int], components: int, spacing: int
) -> None:
    values = np.random.default_rng(0).normal(0, 3, (*grid, components)).astype(np.float32)
    expected = by_cv2(values, spacing)
    height, width = expected.shape[0] - spacing // 2, expected.shape[1] - spacing // 3
    found = to_pixels(values, spacing, height, width)
    assert found.tobytes() == expected[:height, :width].tobytes()


def test_a_region_without_pixels_has_none() -> None:
    assert to_pixels(np.zeros((0, 0, 2), np.float32), 4, 0, 0).shape == (0, 0, 2)
