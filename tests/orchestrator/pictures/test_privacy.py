"""What is hidden of what moves: where, for how long, and how little is left of it."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from mlbs_actors.messages import Array
from orchestrator.pictures.privacy import FRAMES_AFTER, FRAMES_BEFORE, MovingArea, blurred

SHAPE = (96, 128)  # whose margin is 2 px


def labels(*boxes: tuple[int, int, int, int]) -> Array:
    made = np.zeros(SHAPE, np.uint16)
    for number, (x, y, width, height) in enumerate(boxes, 1):
        made[y : y + height, x : x + width] = number
    return made


def box_of(mask: Array) -> tuple[int, ...]:
    return tuple(cv2.boundingRect(mask))


def test_an_object_is_hidden_with_a_margin() -> None:
    moving = MovingArea()
    moving.follow(labels((40, 30, 20, 25)), None)
    mask = moving.mask()
    assert box_of(mask) == (38, 28, 24, 29)
    assert mask.sum() == 24 * 29


def test_where_an_object_was_or_will_be_in_the_next_frames_is_hidden_too() -> None:
    moving = MovingArea()
    for step in range(20):
        moving.follow(labels((5 * step, 30, 10, 10)), None)
    begin, end = 5 * (19 - FRAMES_AFTER - FRAMES_BEFORE), 5 * 19 + 10
    assert box_of(moving.mask(FRAMES_AFTER)) == (begin - 2, 28, end - begin + 4, 14)
    assert box_of(moving.mask()) == (5 * (19 - FRAMES_BEFORE) - 2, 28, 5 * FRAMES_BEFORE + 14, 14)


def test_an_object_is_hidden_in_the_frames_before_its_first_label() -> None:
    moving = MovingArea()
    for step in range(8):
        moving.follow(labels(*([(40, 30, 20, 20)] if step >= 6 else [])), None)
    for later in range(FRAMES_AFTER + 1):
        hidden = bool(moving.mask(later)[40, 50])
        assert hidden == (7 - later + FRAMES_AFTER >= 6)


def test_places_go_with_a_camera_that_turns() -> None:
    """The ground moves 6 px to the left a frame, and a thing on it, which has a label in one frame."""
    camera = (1, 0, 6, 0, 1, 0, 0, 0, 1)  # where a pixel was in the frame before
    moving = MovingArea()
    for step in range(FRAMES_BEFORE + FRAMES_AFTER + 1):
        moving.follow(labels(*([(60, 40, 10, 10)] if step == FRAMES_BEFORE else [])), camera)
    assert box_of(moving.mask(FRAMES_AFTER)) == (58, 38, 14, 14)
    after = MovingArea()
    for step in range(2):
        after.follow(labels(*([(60, 40, 10, 10)] if step == 0 else [])), camera)
    assert box_of(after.mask()) == (52, 38, 14, 14)
    assert box_of(after.mask(1)) == (58, 38, 14, 14)
    before = MovingArea()
    for step in range(2):
        before.follow(labels(*([(60, 40, 10, 10)] if step == 1 else [])), camera)
    assert box_of(before.mask(1)) == (64, 38, 14, 14)


def test_frames_of_another_size_have_nothing_in_common() -> None:
    moving = MovingArea()
    moving.follow(labels((40, 30, 20, 25)), None)
    moving.follow(np.zeros((48, 64), np.uint16), None)
    assert not moving.mask().any()
    assert moving.mask().shape == (48, 64)
    assert box_of(moving.mask(1)) == (38, 28, 24, 29)


@pytest.mark.parametrize("size", [(1, 1), (3, 40), (60, 90), (96, 128)])
def test_of_what_is_hidden_only_a_few_colours_are_left(size: tuple[int, int]) -> None:
    rng = np.random.default_rng(2)
    image = rng.integers(0, 256, (*SHAPE, 3)).astype(np.uint8)
    mask = np.zeros(SHAPE, np.uint8)
    mask[: size[0], : size[1]] = 1
    before = image.copy()
    hidden = blurred(image, mask)
    np.testing.assert_array_equal(image, before)
    np.testing.assert_array_equal(hidden[mask == 0], image[mask == 0])
    # Two pictures whose blocks have the same mean colours cannot be told apart.
    if size == (96, 128):
        block = cv2.resize(image, (6, 4), interpolation=cv2.INTER_AREA)
        spread = float(hidden.std())
        assert spread < 2 * float(block.std()) + 1 < float(image.std())


def test_a_picture_of_fine_detail_becomes_even() -> None:
    stripes = np.zeros((*SHAPE, 3), np.uint8)
    stripes[:, ::2] = 200
    hidden = blurred(stripes, np.ones(SHAPE, np.uint8))
    assert np.ptp(hidden) <= 12
    assert abs(float(hidden.mean()) - 100) < 2


def test_each_thing_is_blurred_by_itself() -> None:
    image = np.zeros((*SHAPE, 3), np.uint8)
    image[:, 64:] = 250
    mask = np.zeros(SHAPE, np.uint8)
    mask[10:50, 5:40] = mask[20:60, 80:110] = 1
    np.testing.assert_array_equal(blurred(image, mask), image)


def test_a_narrow_gap_between_things_is_hidden_and_a_wide_one_is_not() -> None:
    moving = MovingArea()
    moving.follow(labels((10, 30, 20, 40), (36, 30, 20, 40), (80, 30, 20, 40)), None)
    mask = moving.mask()
    assert mask[50, 8:58].all()
    assert not mask[50, 62:76].any()


@pytest.mark.parametrize("shape", [(480, 640), (361, 477), (1080, 1920)])
def test_of_a_large_picture_every_pixel_within_most_of_the_margin_is_hidden(shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(4)
    image = rng.integers(0, 256, (*shape, 3)).astype(np.uint8)
    made, (height, width) = np.zeros(shape, np.uint16), shape
    made[height // 3 : height // 2, width // 4 : width // 3] = 7
    made[5, width - 3] = 2
    moving = MovingArea()
    moving.follow(made, None)
    changed = (blurred(image, moving.mask()) != image).any(axis=2)
    reach = round(min(shape) / 48 * 0.7)
    near = cv2.dilate((made > 0).view(np.uint8), np.ones((2 * reach + 1,) * 2, np.uint8)) > 0
    assert changed[near].mean() > 0.99
    reach = round(min(shape) / 48 * 2)
    far = cv2.dilate((made > 0).view(np.uint8), np.ones((2 * reach + 1,) * 2, np.uint8)) == 0
    assert not changed[far].any()
