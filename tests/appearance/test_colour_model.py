"""The sample stacks: moving, learning, forgetting, against plain loops."""

from __future__ import annotations

import numpy as np
import pytest

from mlbs_actors.appearance.colour_model import (
    SPREAD_STEP,
    AppearanceModel,
    empty_model,
    median_colours,
    update,
    warp_model,
)
from mlbs_actors.appearance.warp import nearest_sources
from mlbs_actors.kernels.image_rows import padded_planes, read_row, row_room
from mlbs_actors.messages import Array, Region

REGION = Region(4, 6, 14, 11)
EVERYWHERE = np.ones((REGION.height, REGION.width), bool)


def random_image(seed: int) -> Array:
    return np.random.default_rng(seed).integers(0, 256, (REGION.height, REGION.width, 3)).astype(np.uint8)


def learnt_model(frames: int, capacity: int = 5) -> AppearanceModel:
    model = empty_model(REGION, capacity)
    for seed in range(frames):
        update(model, random_image(seed), np.random.default_rng(100 + seed).random(EVERYWHERE.shape) < 0.7)
    return model


def test_a_stack_keeps_the_newest_samples_of_its_own_pixel() -> None:
    model = empty_model(REGION, 5)
    kept: dict[tuple[int, int], list[Array]] = {}
    for seed in range(12):
        image = random_image(seed)
        mask = np.random.default_rng(50 + seed).random(EVERYWHERE.shape) < 0.6
        update(model, image, mask)
        for y, x in np.argwhere(mask):
            kept.setdefault((y, x), []).append(image[y, x])
    for (y, x), colours in kept.items():
        newest = np.array(colours[-5:])
        assert model.count[y, x] == len(newest)
        stack = model.samples[y, x, :, : model.count[y, x]].T
        np.testing.assert_array_equal(np.sort(stack, axis=0), np.sort(newest, axis=0))
        np.testing.assert_array_equal(model.samples[y, x, :, model.newest[y, x]], colours[-1])
    never = np.array([[(y, x) not in kept for x in range(REGION.width)] for y in range(REGION.height)])
    assert (model.count[never] == 0).all()


@pytest.mark.parametrize("capacity", [5, 8, 16, 20])
def test_a_move_takes_whole_stacks_along(capacity: int) -> None:
    model = learnt_model(9, capacity)
    target = Region(2, 7, 15, 12)
    motion = np.random.default_rng(1).normal(0, 1, (target.height, target.width, 2)).astype(np.float32)
    moved = warp_model(model, target, motion)
    source, residual = nearest_sources(model.residual, target.x - REGION.x, target.y - REGION.y, motion)
    assert (source < 0).any()
    np.testing.assert_array_equal(moved.residual, residual)
    for y in range(target.height):
        for x in range(target.width):
            if source[y, x] < 0:
                assert moved.count[y, x] == 0
                assert not moved.samples[y, x].any()
                continue
            place = divmod(int(source[y, x]), REGION.width)
            np.testing.assert_array_equal(moved.samples[y, x], model.samples[place])
            assert moved.count[y, x] == model.count[place]
            assert moved.newest[y, x] == model.newest[place]
            assert moved.spread[y, x] == model.spread[place]


def test_a_move_leaves_the_old_model_as_it_is() -> None:
    model = learnt_model(3)
    before = model.samples.copy(), model.count.copy()
    moved = warp_model(model, REGION, np.zeros((REGION.height, REGION.width, 2), np.float32))
    update(moved, random_image(9), EVERYWHERE)
    np.testing.assert_array_equal(model.samples, before[0])
    np.testing.assert_array_equal(model.count, before[1])


def test_a_model_of_no_region_moves_to_an_unknown_one() -> None:
    moved = warp_model(empty_model(Region(0, 0, 0, 0), 5), REGION, np.zeros((11, 14, 2), np.float32))
    assert moved.samples.shape == (11, 14, 3, 5)
    assert not moved.count.any()


def test_the_frame_is_learnt_at_the_point_the_stack_describes() -> None:
    ramp = np.repeat((10 * np.arange(REGION.width))[None, :, None], REGION.height, axis=0)
    image = np.repeat(ramp, 3, axis=2).astype(np.uint8)
    model = empty_model(REGION, 5)
    update(model, image, EVERYWHERE)
    moved = warp_model(model, REGION, np.full((REGION.height, REGION.width, 2), (0.3, 0.0), np.float32))
    np.testing.assert_allclose(moved.residual[:, :-1, 0], -0.3, atol=1e-6)
    update(moved, image, EVERYWHERE)
    inner = (slice(None), slice(1, -1))
    newest = np.take_along_axis(moved.samples, moved.newest[..., None, None].astype(np.int64), axis=3)[..., 0]
    np.testing.assert_array_equal(newest[inner], image[inner] - 3)


def test_the_spread_follows_the_noise_and_ignores_single_outliers() -> None:
    rng = np.random.default_rng(2)
    model = empty_model(Region(0, 0, 40, 30), 20)
    mask = np.ones((30, 40), bool)
    for frame in range(150):
        noisy = 120 + rng.normal(0, 6, (30, 40, 3))
        if frame % 25 == 24:
            noisy += 90
        update(model, np.clip(np.rint(noisy), 0, 255).astype(np.uint8), mask)
    bandwidth = float(np.median(model.spread)) * SPREAD_STEP
    assert 5.0 < bandwidth < 8.5


def test_the_median_colours_are_the_lower_medians_of_the_samples() -> None:
    model = learnt_model(9)
    found = median_colours(model)
    for (y, x), known in np.ndenumerate(model.count):
        samples = np.sort(model.samples[y, x, :, :known], axis=1)
        expected = samples[:, (known - 1) // 2] if known else np.zeros(3)
        assert found[y, x].tolist() == expected.tolist()
    assert len(np.unique(model.count)) > 2


@pytest.mark.parametrize("shape", [(7, 9), (1, 1), (2, 2), (1, 5), (5, 1), (6, 2)])
def test_a_row_is_read_as_by_bilinear_interpolation_held_inside_the_image(shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(sum(shape))
    image = rng.integers(0, 256, (*shape, 3)).astype(np.uint8)
    residual = rng.uniform(-0.99, 0.99, (*shape, 2)).astype(np.float32)
    found = row_room(shape[1])
    for y in range(shape[0]):
        read_row(padded_planes(image), y, residual, 0, shape[1], found)
        for x in range(shape[1]):
            right, down = x + float(residual[y, x, 0]), y + float(residual[y, x, 1])
            left, top = int(np.floor(right)), int(np.floor(down))
            expected = np.zeros(3)
            for row, row_share in ((top, 1 - (down - top)), (top + 1, down - top)):
                for column, share in ((left, 1 - (right - left)), (left + 1, right - left)):
                    inside = image[np.clip(row, 0, shape[0] - 1), np.clip(column, 0, shape[1] - 1)]
                    expected += row_share * share * inside
            np.testing.assert_allclose(found[:3, x], expected, atol=1e-3)


def test_a_part_of_a_picture_may_be_given_and_one_without_rows() -> None:
    picture = random_image(3)
    part, whole = (
        empty_model(Region(2, 0, 5, REGION.height), 4),
        empty_model(Region(2, 0, 5, REGION.height), 4),
    )
    update(part, picture[:, 2:7], np.ones((REGION.height, 5), bool))
    update(whole, picture[:, 2:7].copy(), np.ones((REGION.height, 5), bool))
    np.testing.assert_array_equal(part.samples, whole.samples)
    assert padded_planes(np.zeros((0, 5, 3), np.uint8)).shape == (3, 2, 7)
