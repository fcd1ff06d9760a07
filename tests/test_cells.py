"""Cells of pixels against loops over them."""

from __future__ import annotations

import numpy as np
import pytest

from mlbs_actors import Config
from mlbs_actors.cells import (
    aligned,
    cell_side,
    cells_won,
    in_cells,
    in_pixels,
    mean_of_cells,
    spread_over_cells,
)
from mlbs_actors.messages import Array, Region


def plain_means(values: Array, side: int) -> Array:
    """Of every cell, the border's last row and column going on past it."""
    height, width = values.shape[:2]
    rows, columns = -(-height // side), -(-width // side)
    y, x = np.minimum(np.arange(rows * side), height - 1), np.minimum(np.arange(columns * side), width - 1)
    whole = values[y][:, x].astype(np.float64)
    means: Array = whole.reshape(rows, side, columns, side, *values.shape[2:]).mean(axis=(1, 3))
    return means


@pytest.mark.parametrize("side", [1, 2, 3])
@pytest.mark.parametrize("shape", [(6, 12, 3), (7, 11, 3), (1, 5, 3), (8, 9)])
def test_a_cell_has_the_mean_of_its_pixels(side: int, shape: tuple[int, ...]) -> None:
    values = np.random.default_rng(0).integers(0, 256, shape).astype(np.uint8)
    found = mean_of_cells(values, side)
    assert found.dtype == np.uint8
    assert np.abs(found - plain_means(values, side)).max() <= 0.5
    motion = np.random.default_rng(1).normal(0, 3, (*shape[:2], 2)).astype(np.float32)
    np.testing.assert_allclose(mean_of_cells(motion, side), plain_means(motion, side), atol=1e-5)


@pytest.mark.parametrize("side", [1, 2, 3])
@pytest.mark.parametrize("region", [Region(0, 0, 23, 17), Region(12, 6, 11, 11), Region(6, 6, 0, 0)])
def test_a_layer_has_the_share_of_its_pixels_and_learns_whole_cells_that_are_trusted(
    side: int, region: Region
) -> None:
    rng = np.random.default_rng(2)
    labels = (rng.random((17, 23)) < 0.3).astype(np.uint16) * 3
    labels[:10] = 3
    cells = in_cells(region, side)
    trusted = rng.random((cells.height, cells.width)) < 0.5
    share, learnt = cells_won(labels, 3, region, side, trusted)
    expected = mean_of_cells((labels[region.slices] == 3).astype(np.uint8) * np.uint8(255), side)
    np.testing.assert_array_equal(share, expected.reshape(trusted.shape))
    np.testing.assert_array_equal(learnt, (share == 255) & trusted)


@pytest.mark.parametrize("dtype", [np.uint8, np.int8, np.bool_, np.int32])
def test_every_pixel_takes_the_value_of_its_cell(dtype: type) -> None:
    values: Array = np.random.default_rng(0).integers(-100, 100, (3, 4)).astype(dtype)
    found = spread_over_cells(values, 3, (8, 11))
    assert found.dtype == dtype
    for y in range(8):
        for x in range(11):
            assert found[y, x] == values[y // 3, x // 3]


def test_an_aligned_region_holds_whole_cells_and_ends_at_the_frame() -> None:
    shape = (11, 20)
    for region in (Region(0, 0, 20, 11), Region(3, 5, 4, 4), Region(4, 4, 2, 2), Region(19, 10, 1, 1)):
        found = aligned(region, 2, shape)
        assert found.x % 2 == found.y % 2 == 0
        assert found.x <= region.x < found.x + found.width <= shape[1]
        assert found.y <= region.y < found.y + found.height <= shape[0]
        assert found.width <= region.width + 2
        cells = in_cells(found, 2)
        assert (cells.height, cells.width) == mean_of_cells(
            np.zeros((found.height, found.width), np.uint8), 2
        ).shape
        assert in_pixels(cells, 2, shape) == found
    assert aligned(Region(3, 3, 0, 0), 2, shape).area == 0


def test_cells_grow_with_the_frame_and_less_in_large_ones() -> None:
    shapes = ((120, 160), (240, 320), (480, 640), (540, 960), (720, 1280), (1080, 1920), (2160, 3840))
    cell_px = Config().grid.cell_px
    assert [cell_side(shape, cell_px) for shape in shapes] == [1, 1, 2, 3, 3, 4, 5]
