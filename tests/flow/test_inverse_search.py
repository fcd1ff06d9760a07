"""Dense inverse search: its kernels against plain sums over patches, and known motions."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from mlbs_actors.flow import patch_search
from mlbs_actors.flow.inverse_search import (
    FlowLevel,
    SearchEffort,
    coarsest_level,
    flow_levels,
    improve_flow,
    resized_flow,
)
from mlbs_actors.flow.patch_search import MARGIN, PATCH
from mlbs_actors.messages import Array, Region

EFFORT = SearchEffort(iterations=6, refinements=1, stride=5)


def texture(height: int, width: int, seed: int = 0) -> Array:
    """Smooth random grey texture, uint8."""
    noise = np.random.default_rng(seed).normal(size=(height, width)).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), 1.5)
    return np.asarray(255 * (smooth - smooth.min()) / np.ptp(smooth), np.uint8)


def moved_patch(target: Array, y: int, x: int, u: float, v: float) -> Array:
    """The patch of a grey frame at a moved place, bilinear and continued past the sides, grey levels."""
    height, width = target.shape
    rows = min(max(y + v, 1.0 - PATCH), height - 1.0) + np.arange(PATCH)
    columns = min(max(x + u, 1.0 - PATCH), width - 1.0) + np.arange(PATCH)
    top, left = np.floor(rows).astype(int), np.floor(columns).astype(int)
    down, across = (rows - top)[:, None], columns - left

    def between_columns(row: Array) -> Array:
        one, other = (
            target[np.clip(row, 0, height - 1)[:, None], np.clip(column, 0, width - 1)].astype(float)
            for column in (left, left + 1)
        )
        return np.asarray((1 - across) * one + across * other)

    return np.asarray((1 - down) * between_columns(top) + down * between_columns(top + 1))


def test_a_pixels_motion_is_the_weighted_mean_of_the_patches_over_it() -> None:
    source, target = texture(40, 48, 1), texture(40, 48, 2)
    [before], [after] = flow_levels(source, 0), flow_levels(target, 0)
    part = Region(4, 6, 29, 23)
    across, down = (patch_search.patch_places(*one, 5) for one in ((4, 29), (6, 23)))
    motions = np.random.default_rng(0).normal(0, 3, (len(down), len(across), 2)).astype(np.float32)
    window = np.zeros((3, part.height, part.width), np.float32)
    patch_search.densify(before.gray, after.around, motions, across, down, part.x, part.y, window)
    sums = np.zeros((3, *source.shape))
    for row, y in enumerate(down):
        for column, x in enumerate(across):
            u, v = motions[row, column].tolist()
            patch = np.s_[y : y + PATCH, x : x + PATCH]
            weight = 1 / np.maximum(1, abs(moved_patch(target, y, x, u, v) - source[patch]))
            for axis, one in enumerate((u * weight, v * weight, weight)):
                sums[(axis, *patch)] += one
    inside = sums[(slice(None), *part.slices)]
    np.testing.assert_allclose(window[:2], inside[:2] / inside[2], atol=1e-3)


@pytest.mark.parametrize(("start", "length"), [(0, 8), (3, 9), (0, 13), (5, 40)])
def test_patches_cover_a_part_and_do_not_leave_it(start: int, length: int) -> None:
    places = patch_search.patch_places(start, length, 5)
    covered = {int(place) + i for place in places for i in range(PATCH)}
    assert covered == set(range(start, start + length))
    assert (np.diff(places) > 0).all()


def test_a_fractional_shift_is_found_on_the_finest_level_in_a_part_alone() -> None:
    canvas = cv2.resize(texture(120, 160), (640, 480), interpolation=cv2.INTER_CUBIC)
    # Things move by (+0.75, −0.5).
    source, target = canvas[40:424:4, 40:552:4], canvas[42:426:4, 37:549:4]
    [before], [after] = (flow_levels(np.ascontiguousarray(one), 0) for one in (source, target))
    flow = np.zeros((2, 96, 128), np.float32)
    part = Region(30, 20, 61, 47)
    improve_flow(before, after, flow, [part], EFFORT)
    inside = flow[(slice(None), *part.slices)]
    np.testing.assert_allclose(np.median(inside, axis=(1, 2)), [0.75, -0.5], atol=0.05)
    inside[:] = 0
    assert not flow.any()


def searched_one_by_one(
    source: FlowLevel, target: Array, flow: Array, across: Array, down: Array, iterations: int
) -> Array:
    """The search patch after patch, each row from its beginning to its end and then all of them back."""
    motions = np.stack([flow[:, y + PATCH // 2, across + PATCH // 2].T for y in down]).astype(float)
    for step in (1, -1):
        for row in range(len(down))[::step]:
            for column in range(len(across))[::step]:
                y, x = int(down[row]), int(across[column])
                patch = np.s_[y : y + PATCH, x : x + PATCH]
                slopes = np.stack([source.slope_x[patch], source.slope_y[patch]]).astype(float)
                here = source.gray[patch].astype(float)

                def uneven(motion: Array, y: int = y, x: int = x, here: Array = here) -> Array:
                    """What the moved patch shows more, but for the mean: brightness does not count."""
                    difference = moved_patch(target, y, x, *motion.tolist()) - here
                    return np.asarray(difference - difference.mean())

                known = [motions[row, column]]
                if 0 <= column - step < len(across):
                    known.append(motions[row, column - step])
                if 0 <= row - step < len(down):
                    known.append(motions[row - step, column])
                start = motion = min(known, key=lambda one: np.square(uneven(one)).sum())
                hessian = np.tensordot(slopes, slopes, ((1, 2), (1, 2)))
                least = np.inf
                for _ in range(iterations):
                    difference = uneven(motion)
                    gradient = np.tensordot(slopes, difference, ((1, 2), (0, 1)))
                    motion = motion - np.linalg.solve(hessian, gradient)
                    if np.square(difference).sum() >= least:
                        break
                    least = np.square(difference).sum()
                motions[row, column] = motion if np.hypot(*(motion - start)) <= PATCH else start
    return motions


@pytest.mark.parametrize(
    ("part", "spread"),  # px; the larger one leads many patches out of the frame
    [(Region(0, 0, 128, 96), 6.0), (Region(3, 5, 61, 8), 60.0), (Region(40, 2, 8, 90), 60.0)],
)
def test_patches_descend_from_the_best_known_motion_as_in_plain_array_operations(
    part: Region, spread: float
) -> None:
    source, target = texture(96, 128, 1), texture(96, 128, 2)
    [before], [after] = flow_levels(source, 0), flow_levels(target, 0)
    across = patch_search.patch_places(part.x, part.width, 5)
    down = patch_search.patch_places(part.y, part.height, 5)
    flow = np.random.default_rng(0).normal(0, spread, (2, 96, 128)).astype(np.float32)
    found = patch_search.search_patches(
        before.gray, after.around, before.slope_x, before.slope_y, flow, across, down, 3
    )
    expected = searched_one_by_one(before, target, flow, across, down, 3)
    # Where two motions are equally good, rounding decides.
    assert (np.abs(found - expected).max(axis=2) < 0.01).mean() > 0.98


def test_patches_take_over_what_their_neighbours_have_found() -> None:
    # One patch knows the motion of a pan by 12 px, which no patch finds by itself.
    canvas = texture(96, 140)
    source, target = np.ascontiguousarray(canvas[:, :128]), np.ascontiguousarray(canvas[:, 12:])
    [before], [after] = flow_levels(source, 0), flow_levels(target, 0)
    flow = np.zeros((2, 96, 128), np.float32)
    flow[0, 44:52, 60:68] = -12
    improve_flow(before, after, flow, [Region(0, 0, 128, 96)], EFFORT)
    found = flow[:, 8:-8, 24:-8]
    assert (np.hypot(found[0] + 12, found[1]) < 0.3).mean() > 0.95


@pytest.mark.parametrize("motion", [(0.0, 0.0), (1e6, -1e6), (-300.0, 300.0)])
def test_smooth_frames_and_motions_out_of_them_give_finite_flow(motion: tuple[float, float]) -> None:
    [level] = flow_levels(np.full((16, 24), 90, np.uint8), 0)
    flow = np.empty((2, 16, 24), np.float32)
    flow[0], flow[1] = motion
    improve_flow(level, level, flow, [Region(0, 0, 24, 16)], EFFORT)
    assert np.isfinite(flow).all()


def test_levels_are_halves_continued_past_their_sides() -> None:
    gray = texture(45, 66)
    fine, coarse = flow_levels(gray, 1)
    assert coarse.gray.shape == (22, 33)
    for level in (fine, coarse):
        continued = np.pad(level.gray.astype(np.float32), MARGIN, mode="edge")
        np.testing.assert_array_equal(level.around, continued)


@pytest.mark.parametrize(
    ("shape", "level"), [((16, 16), 0), ((240, 320), 3), ((480, 640), 4), ((16, 640), 1)]
)
def test_the_coarsest_level_is_a_few_patches_wide(shape: tuple[int, int], level: int) -> None:
    assert coarsest_level(shape) == level
    assert min(shape) >> level >= PATCH


def test_flow_is_stated_in_pixels_of_the_grid_it_is_resized_to() -> None:
    flow = np.stack([np.full((10, 20), 1.5, np.float32), np.full((10, 20), -2.0, np.float32)])
    finer = resized_flow(flow, (20, 40))
    assert finer.shape == (2, 20, 40)
    np.testing.assert_allclose(finer[:, 5, 5], [3.0, -4.0])
    assert resized_flow(flow, (10, 20)) is flow


def test_parts_are_improved_as_if_each_were_alone() -> None:
    [before], [after] = flow_levels(texture(48, 64, 1), 0), flow_levels(texture(48, 64, 2), 0)
    parts = [Region(2, 3, 20, 17), Region(30, 8, 25, 31), Region(4, 30, 9, 8)]
    together = np.random.default_rng(0).normal(0, 1, (2, 48, 64)).astype(np.float32)
    by_turns = together.copy()
    improve_flow(before, after, together, parts, EFFORT)
    for part in parts:
        improve_flow(before, after, by_turns, [part], EFFORT)
    np.testing.assert_array_equal(together, by_turns)
    improve_flow(before, after, by_turns, [], EFFORT)
    np.testing.assert_array_equal(together, by_turns)
