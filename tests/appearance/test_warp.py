"""The warps against plain loops, and what the sub-pixel residual is for."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mlbs_actors.appearance.warp import MAX_MISS_PX, nearest_sources, warp_map
from mlbs_actors.messages import Array, Region

OLD = Region(10, 20, 23, 17)
NEW = Region(8, 22, 25, 19)
EVERYWHERE = np.ones((NEW.height, NEW.width), bool)


def rough_motion(region: Region, seed: int) -> Array:
    rng = np.random.default_rng(seed)
    motion: Array = rng.normal(0, 1.5, (region.height, region.width, 2)).astype(np.float32)
    return motion


def plain_warp(values: Array, old: Region, new: Region, motion: Array, neutral: float) -> Array:
    result = np.empty((new.height, new.width))
    for y in range(new.height):
        for x in range(new.width):
            source_x = new.x + x + float(motion[y, x, 0]) - old.x
            source_y = new.y + y + float(motion[y, x, 1]) - old.y
            result[y, x] = 0
            for row in range(math.floor(source_y), math.floor(source_y) + 2):
                for column in range(math.floor(source_x), math.floor(source_x) + 2):
                    share = (1 - abs(row - source_y)) * (1 - abs(column - source_x))
                    inside = 0 <= row < old.height and 0 <= column < old.width
                    result[y, x] += share * (float(values[row, column]) if inside else neutral)
    return result


def test_a_map_is_warped_as_by_plain_loops_and_neutral_outside() -> None:
    values = np.random.default_rng(0).random((OLD.height, OLD.width)).astype(np.float32)
    motion = rough_motion(NEW, 1)
    value, share = warp_map(values, OLD, NEW, motion, EVERYWHERE)
    warped = value + (1 - share) * np.float32(0.4)
    np.testing.assert_allclose(warped, plain_warp(values, OLD, NEW, motion, 0.4), atol=1e-5)
    np.testing.assert_allclose(value, plain_warp(values, OLD, NEW, motion, 0.0), atol=1e-5)
    assert 0 < np.count_nonzero((share > 0) & (share < 1)) < share.size  # the border is met


def test_a_map_is_warped_only_where_it_is_needed() -> None:
    values = np.random.default_rng(2).random((OLD.height, OLD.width)).astype(np.float32)
    motion, needed = rough_motion(NEW, 3), np.random.default_rng(4).random(EVERYWHERE.shape) < 0.4
    everywhere, partly = (warp_map(values, OLD, NEW, motion, where) for where in (EVERYWHERE, needed))
    for whole, part in zip(everywhere, partly, strict=True):
        np.testing.assert_array_equal(part, np.where(needed, whole, 0))


def test_a_map_of_no_region_is_neutral() -> None:
    nowhere = np.zeros((0, 0), np.float32)
    _, share = warp_map(nowhere, Region(0, 0, 0, 0), NEW, rough_motion(NEW, 4), EVERYWHERE)
    assert not share.any()


def plain_sources(residual: Array, old: Region, new: Region, motion: Array) -> tuple[Array, Array]:
    """The rule of the module's docstring, word by word."""
    source = np.full((new.height, new.width), -1)
    new_residual = np.zeros((new.height, new.width, 2))

    def miss(row: int, column: int, q: Array) -> Array:
        difference: Array = np.array([column, row]) + residual[row, column].astype(np.float64) - q
        return difference

    def inside(row: int, column: int) -> bool:
        return 0 <= row < old.height and 0 <= column < old.width

    for y in range(new.height):
        for x in range(new.width):
            q = np.array([new.x + x - old.x, new.y + y - old.y]) + motion[y, x].astype(np.float64)
            column, row = (math.floor(value + 0.5) for value in q)
            if not inside(row, column):
                continue
            guess_column, guess_row = (math.floor(value + 0.5) for value in q - residual[row, column])
            if inside(guess_row, guess_column) and np.abs(miss(guess_row, guess_column, q)).max() <= 0.5:
                best = (guess_row, guess_column)
            else:
                around = [
                    (near_row, near_column)
                    for near_row in range(row - 1, row + 2)
                    for near_column in range(column - 1, column + 2)
                    if inside(near_row, near_column)
                ]
                best = min(around, key=lambda place: float(np.sum(miss(place[0], place[1], q) ** 2)))
                if np.sum(miss(best[0], best[1], q) ** 2) >= MAX_MISS_PX**2:
                    continue
            source[y, x] = best[0] * old.width + best[1]
            new_residual[y, x] = miss(best[0], best[1], q)
    return source, new_residual


@pytest.mark.parametrize("spread", [0.0, 0.2, 0.6])
def test_sources_are_those_of_the_plain_rule(spread: float) -> None:
    rng = np.random.default_rng(5)
    residual = rng.uniform(-spread, spread, (OLD.height, OLD.width, 2)).astype(np.float32)
    motion = rough_motion(NEW, 6)
    source, new_residual = nearest_sources(residual, NEW.x - OLD.x, NEW.y - OLD.y, motion)
    expected_source, expected_residual = plain_sources(residual, OLD, NEW, motion)
    np.testing.assert_array_equal(source, expected_source)
    np.testing.assert_allclose(new_residual, expected_residual, atol=1e-6)
    assert (source >= 0).any()
    assert (source < 0).any()


def carried_positions(steps: int, motion: Array, with_residual: bool) -> tuple[Array, Array]:
    """Where (x, y) in frame 0 each pixel's stack comes from after some frames, and the residual."""
    region = Region(0, 0, motion.shape[1], motion.shape[0])
    y, x = np.mgrid[: region.height, : region.width]
    origin = np.dstack([x, y]).astype(np.float64)
    residual = np.zeros((region.height, region.width, 2), np.float32)
    for _ in range(steps):
        source, moved = nearest_sources(residual, 0, 0, motion)
        origin = np.where(source[..., None] >= 0, origin.reshape(-1, 2)[np.maximum(source, 0)], np.nan)
        residual = moved if with_residual else np.zeros_like(moved)
    return origin, residual


def test_under_a_slow_pan_stacks_stay_within_half_a_pixel_of_their_points() -> None:
    motion = np.full((8, 60, 2), (0.3, 0.0), np.float32)
    origin, residual = carried_positions(50, motion, with_residual=True)
    drift = origin[:, :40, 0] + residual[:, :40, 0] - (np.arange(40) + 50 * 0.3)
    assert np.abs(drift).max() < 1e-3
    assert np.abs(residual[:, :40]).max() <= 0.5 + 1e-6


def test_without_the_residual_the_same_pan_would_be_lost() -> None:
    motion = np.full((8, 60, 2), (0.3, 0.0), np.float32)
    origin, _ = carried_positions(50, motion, with_residual=False)
    assert np.nanmin(np.arange(60) + 15.0 - origin[..., 0]) == 15.0  # every frame rounds to no motion


def test_under_zoom_and_rotation_the_drift_stays_bounded() -> None:
    y, x = np.mgrid[:61, :61] - 30.0
    motion = np.dstack([-0.01 * x + 0.02 * y, -0.01 * y - 0.02 * x]).astype(np.float32)
    _, residual = carried_positions(80, motion, with_residual=True)
    assert np.hypot(residual[..., 0], residual[..., 1]).max() < MAX_MISS_PX
    assert np.abs(residual).mean() < 0.4


def test_what_enters_at_the_border_is_unknown_and_never_smeared() -> None:
    motion = np.full((6, 40, 2), (0.5, 0.0), np.float32)
    origin, _ = carried_positions(20, motion, with_residual=True)
    known = ~np.isnan(origin[0, :, 0])
    assert known[:29].all()
    assert not known[31:].any()
