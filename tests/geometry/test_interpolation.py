"""Flow and maps read between their pixels, against the plain formula and OpenCV."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from opencv_sampling import exact_opencv

from mlbs_actors.geometry.interpolation import sample_flow, sample_map
from mlbs_actors.messages import Array

SIDE = 2
FIELD = np.random.default_rng(0).normal(size=(6, 9, 2)).astype(np.float32)


def bilinear(field: Array, point: Array) -> Array:
    """The plain formula, inside; pixel centres are at whole numbers."""
    x, y = (point + 0.5) / SIDE - 0.5
    left, top = int(np.floor(x)), int(np.floor(y))
    right, down = x - left, y - top
    upper = (1 - right) * field[top, left] + right * field[top, left + 1]
    lower = (1 - right) * field[top + 1, left] + right * field[top + 1, left + 1]
    return np.asarray((1 - down) * upper + down * lower)


def test_flow_and_maps_are_read_bilinearly_between_the_centres_of_their_pixels() -> None:
    points = np.random.default_rng(1).uniform((1, 1), (15, 10), (50, 2)).astype(np.float32)
    expected = np.array([bilinear(FIELD, point) for point in points])
    np.testing.assert_allclose(sample_flow(FIELD, points, SIDE), expected, atol=0.15)  # 1/32 px of it
    values = np.ascontiguousarray(FIELD[..., 0])
    np.testing.assert_allclose(sample_map(values, points, SIDE), expected[:, 0], atol=1e-5)
    centres = np.array([[0.5, 0.5], [16.5, 10.5]], np.float32)  # of the first and the last pixel
    np.testing.assert_allclose(sample_flow(FIELD, centres, SIDE), [FIELD[0, 0], FIELD[5, 8]], atol=1e-6)


@exact_opencv
@pytest.mark.parametrize("side", [1, 2, 3])
def test_inside_and_outside_of_the_frame_both_are_what_opencv_reads(side: int) -> None:
    points = np.random.default_rng(2).uniform(-6, 30, (500, 2)).astype(np.float32)
    x, y = (((points + np.float32(0.5)) / np.float32(side)) - np.float32(0.5)).T
    read = [
        cv2.remap(one, x[None], y[None], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)[0]
        for one in (FIELD, np.ascontiguousarray(FIELD[..., 0]))
    ]
    np.testing.assert_array_equal(sample_flow(FIELD, points, side), read[0])
    np.testing.assert_allclose(sample_map(FIELD[..., 0].copy(), points, side), read[1], atol=1e-5)


def test_at_no_points_there_is_nothing() -> None:
    nowhere = np.zeros((0, 2), np.float32)
    assert sample_flow(FIELD, nowhere, SIDE).shape == (0, 2)
    assert sample_map(FIELD[..., 0].copy(), nowhere, SIDE).shape == (0,)
