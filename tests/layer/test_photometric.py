"""Which motion explains the image: an object's texture, its surroundings, and what says nothing."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
import pytest
from opencv_sampling import exact_opencv
from read_only import read_only

from mlbs_actors.config import PosteriorConfig
from mlbs_actors.geometry.homography import homography_of_cells
from mlbs_actors.layer.photometric import PhotometricRules, photometric_advantage
from mlbs_actors.messages import Array, Region

SHAPE = (90, 120)
WHOLE = Region(0, 0, SHAPE[1], SHAPE[0])
#: The car at frame t−1, and its motion forwards.
CAR, MOVE = Region(40, 30, 36, 30), (6, 2)
#: Well inside the car at frame t, and ground well away from it before and now.
ON_CAR, GROUND = np.s_[38:56, 52:76], np.s_[5:24, 8:112]
LARGEST = 3.0


def texture(seed: int, height: int = 200, width: int = 200) -> Array:
    noise = np.random.default_rng(seed).normal(size=(height, width, 3)).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), 1.5)
    return np.asarray(255 * (smooth - smooth.min()) / np.ptp(smooth), np.uint8)


def frames(ground: Array, car: Array) -> tuple[Array, Array]:
    pictures = []
    for t in range(2):
        picture = ground[: SHAPE[0], : SHAPE[1]].copy()
        top, left = CAR.y + MOVE[1] * t, CAR.x + MOVE[0] * t
        picture[top : top + CAR.height, left : left + CAR.width] = car[: CAR.height, : CAR.width]
        pictures.append(picture)
    return pictures[0], pictures[1]


#: A camera that stands.
STILL = np.eye(3)


def backward(motion: tuple[float, float], region: Region = WHOLE) -> Array:
    return np.full((region.height, region.width, 2), (-motion[0], -motion[1]), np.float32)


class FramePart(NamedTuple):
    """The colours of a region of a frame."""

    region: Region
    image: Array


def compared(
    before: FramePart, now: FramePart, side: int, motion: Array, camera: Array, own: Array, largest: float
) -> Array:
    corners = (now.region.x, now.region.y), (before.region.x, before.region.y)
    images = np.ascontiguousarray(before.image), np.ascontiguousarray(now.image)
    rules = PhotometricRules.configured(PosteriorConfig(photometric_cap=largest))
    found = photometric_advantage(*images, motion, read_only(camera), side, corners, own, rules)
    return np.asarray(found)


def advantage(before: Array, now: Array, own: Array | None = None, largest: float = LARGEST) -> Array:
    """Of the car's motion over a camera that stands."""
    everywhere = np.ones(SHAPE, bool)
    found = compared(
        FramePart(WHOLE, before),
        FramePart(WHOLE, now),
        1,
        backward(MOVE),
        STILL,
        everywhere if own is None else own,
        largest,
    )
    assert found.shape == SHAPE
    assert found.dtype == np.float32
    return found


def test_an_objects_own_texture_speaks_for_it() -> None:
    found = advantage(*frames(texture(0), texture(1)))
    assert (found[ON_CAR] > 0).all()
    assert found[ON_CAR].mean() > 0.8 * LARGEST


def test_static_textured_ground_in_the_objects_region_speaks_against_it() -> None:
    found = advantage(*frames(texture(0), texture(1)))
    assert (found[GROUND] < 0).mean() > 0.95
    assert found[GROUND].mean() < -0.8 * LARGEST


def test_smooth_ground_says_nothing() -> None:
    found = advantage(*frames(np.full((200, 200, 3), 110, np.uint8), texture(1)))
    np.testing.assert_array_equal(found[GROUND], 0.0)


def test_a_smooth_object_says_nothing_of_its_inside() -> None:
    found = advantage(*frames(texture(0), np.full((200, 200, 3), 110, np.uint8)))
    np.testing.assert_array_equal(found[40:54, 54:70], 0.0)


def test_where_its_motion_does_not_lead_back_to_itself_nothing_speaks_for_an_object() -> None:
    before, now = frames(texture(0), texture(1))
    found = advantage(before, now, np.zeros(SHAPE, bool))
    assert found.max() == 0.0
    np.testing.assert_array_equal(found[GROUND], advantage(before, now)[GROUND])


def test_what_neither_motion_explains_says_nothing() -> None:
    before, now = frames(texture(0), texture(1))
    now[ON_CAR] = 255 - texture(2)[ON_CAR]
    inner = np.s_[42:52, 56:72]
    assert np.abs(advantage(before, now)[inner]).mean() < 0.1 * LARGEST


@pytest.mark.parametrize("largest", [1.0, 3.0])
def test_it_counts_no_more_than_its_bound(largest: float) -> None:
    found = advantage(*frames(texture(0), texture(1)), largest=largest)
    assert found.max() == pytest.approx(largest)
    assert found.min() == pytest.approx(-largest)


def test_out_of_the_frame_before_nothing_is_said() -> None:
    found = advantage(*frames(texture(0), texture(1)))
    np.testing.assert_array_equal(found[:, : MOVE[0]], 0.0)
    np.testing.assert_array_equal(found[: MOVE[1]], 0.0)


def test_where_the_cameras_horizon_lies_in_the_frame_nothing_is_said() -> None:
    image = FramePart(WHOLE, texture(0)[: SHAPE[0], : SHAPE[1]])
    horizon = np.array([[1.0, 0, 0], [0, 1, 0], [-0.01, 0, 1]])  # a depth of exactly 0 at x = 100
    found = compared(image, image, 1, backward(MOVE), horizon, np.ones(SHAPE, bool), LARGEST)
    np.testing.assert_array_equal(found[:, 100:], 0.0)
    assert np.isfinite(found).all()


def test_the_regions_of_the_two_frames_may_differ() -> None:
    before, now = frames(texture(0), texture(1))
    then, region = Region(20, 10, 80, 70), Region(34, 22, 60, 50)
    found = compared(
        FramePart(then, before[then.slices]),
        FramePart(region, np.ascontiguousarray(now[region.slices])),
        1,
        backward(MOVE, region),
        STILL,
        np.ones((region.height, region.width), bool),
        LARGEST,
    )
    full = np.zeros(SHAPE, np.float32)
    full[region.slices] = found
    assert (full[ON_CAR] > 0).all()
    assert full[24:28, 38:90].mean() < -0.5 * LARGEST  # ground in both


def plain_advantage(before: Array, now: Array, motion: Array, camera: Array, own: Array) -> Array:
    """The same on the whole frame by array operations, with the camera's motion as a map."""
    last, newest = (cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) for image in (before, now))
    rows, columns = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(np.float32)
    homogeneous = np.stack([columns, rows, np.ones_like(rows)], axis=2) @ camera.T
    by_camera = homogeneous[..., :2] / homogeneous[..., 2:]
    known, errors = np.ones(SHAPE, bool), []
    for x, y in ((columns + motion[..., 0], rows + motion[..., 1]), np.moveaxis(by_camera, 2, 0)):
        known &= (x >= 0) & (x <= SHAPE[1] - 1) & (y >= 0) & (y <= SHAPE[0] - 1)
        moved = cv2.remap(last, x.astype(np.float32), y.astype(np.float32), cv2.INTER_LINEAR)
        errors.append(cv2.blur(np.abs(newest.astype(np.float32) - moved), (3, 3)))
    noise = np.clip(np.median(errors[1]), 1.5, 3.0)
    difference = np.clip((errors[1] - errors[0]) / noise, -LARGEST, LARGEST)
    for_it = own * np.clip(4.0 - errors[0] / noise, 0, 1)
    against_it = np.clip(2.5 - errors[1] / noise, 0, 1)
    return np.asarray(known * difference * np.where(difference > 0, for_it, against_it))


@exact_opencv
def test_it_is_that_of_the_formula_under_any_camera() -> None:
    before, now = frames(texture(0), texture(1))
    rng = np.random.default_rng(5)
    camera = np.array([[1.01, 0.02, -1.3], [-0.015, 0.99, 0.8], [1e-5, -2e-5, 1.0]])
    motion = backward(MOVE) + rng.normal(0, 0.3, (*SHAPE, 2)).astype(np.float32)
    own = rng.random(SHAPE) < 0.5
    parts = FramePart(WHOLE, before), FramePart(WHOLE, now)
    found = compared(*parts, 1, motion, camera, own, LARGEST)
    expected = plain_advantage(before, now, motion, camera, own)
    assert np.abs(expected).mean() > 0.1
    # A grey level just between two whole ones may fall to either side.
    assert np.mean(np.abs(found - expected) > 1e-3) < 0.01


def test_of_pictures_of_cells_the_camera_is_of_cells_as_they_are() -> None:
    before, now = frames(texture(0), texture(1))
    parts = FramePart(WHOLE, before), FramePart(WHOLE, now)
    own, camera = np.ones(SHAPE, bool), np.array([[1.01, 0.02, -1.3], [-0.015, 0.99, 0.8], [1e-5, -2e-5, 1]])
    of_cells = homography_of_cells(camera, 3)
    found = compared(*parts, 3, backward(MOVE), camera, own, LARGEST)
    expected = compared(*parts, 1, backward(MOVE), of_cells, own, LARGEST)
    np.testing.assert_array_equal(found, expected)
    assert found.any()


def test_a_new_born_layer_and_an_empty_region_say_nothing() -> None:
    nowhere, image = Region(0, 0, 0, 0), texture(0)[: SHAPE[0], : SHAPE[1]]
    nothing = FramePart(nowhere, np.zeros((0, 0, 3), np.uint8))
    everywhere = np.ones(SHAPE, bool)
    born = compared(nothing, FramePart(WHOLE, image), 1, backward(MOVE), STILL, everywhere, LARGEST)
    assert born.shape == SHAPE
    assert not born.any()
    none = np.zeros((0, 0, 2), np.float32)
    gone = compared(FramePart(WHOLE, image), nothing, 1, none, STILL, np.zeros((0, 0), bool), LARGEST)
    assert gone.shape == (0, 0)
