"""Driving through a scene of many depths: told from all other motions, and what is static in it."""

from __future__ import annotations

import numpy as np
import pytest

from mlbs_actors.config import TrajectoriesConfig
from mlbs_actors.messages import Array
from mlbs_actors.tracking.camera import camera_homography
from mlbs_actors.tracking.epipolar import EpipolarGeometry, forward_motion, static_motion

SHAPE = (480, 640)
CONFIG = TrajectoriesConfig()
FOCAL = 500.0
#: A turn of 0.6° and a nod of 0.3° between two frames.
TURN = (0.005, 0.01)


def projected(points: Array) -> Array:
    return np.asarray(FOCAL * points[:, :2] / points[:, 2:] + np.array([320.0, 240.0]))


def turned(points: Array) -> Array:
    """Camera coordinates after the camera's turn."""
    (sin_x, sin_y), (cos_x, cos_y) = np.sin(TURN), np.cos(TURN)
    about_x = np.array([[1, 0, 0], [0, cos_x, -sin_x], [0, sin_x, cos_x]])
    about_y = np.array([[cos_y, 0, sin_y], [0, 1, 0], [-sin_y, 0, cos_y]])
    return np.asarray(points @ (about_x @ about_y).T)


def street(count: int = 400, seed: int = 0) -> Array:
    """Points (x right, y down, z ahead) on a road, on two rows of houses and between, m."""
    rng = np.random.default_rng(seed)
    z = rng.uniform(8, 60, count)
    x = np.where(rng.random(count) < 0.5, rng.choice([-6.0, 6.0], count), rng.uniform(-6, 6, count))
    y = np.where(np.abs(x) == 6.0, rng.uniform(-8, 1.5, count), rng.uniform(-1, 1.5, count))
    return np.stack([x, y, z], axis=1)


def seen(scene: Array, drive: Array, own: Array | float = 0.0) -> tuple[Array, Array]:
    """Positions and backward motions of the points that both frames show; ``own`` is what they moved."""
    before = projected(scene - own)
    now = projected(turned(scene - drive))
    inside = ((now >= 0) & (now < (640, 480)) & (before >= 0) & (before < (640, 480))).all(axis=1)
    noise = np.random.default_rng(9).normal(0, 0.1, now.shape)
    return now[inside].astype(np.float32), (before - now + noise)[inside].astype(np.float32)


def geometry_of(positions: Array, motions: Array) -> EpipolarGeometry | None:
    homography = camera_homography(positions, motions, 1.0, CONFIG)
    return forward_motion(positions, motions, homography, SHAPE, CONFIG)


def driving() -> EpipolarGeometry:
    geometry = geometry_of(*seen(street(), np.array([0.0, 0.0, 1.5])))
    assert geometry is not None
    return geometry


def test_the_epipole_is_the_point_that_the_camera_drives_towards() -> None:
    geometry = driving()
    np.testing.assert_allclose(geometry.epipole_before, (320, 240), atol=4)
    np.testing.assert_allclose(geometry.epipole, projected(turned(np.array([[0.0, 0, 1]])))[0], atol=4)


def test_what_is_static_moves_as_a_static_point_of_some_depth_would() -> None:
    positions, motions = seen(street(seed=1), np.array([0.0, 0.0, 1.5]))
    error = np.hypot(*(static_motion(driving(), positions, motions) - motions).T)
    assert np.quantile(error, 0.95) < 0.6
    homography = camera_homography(positions, motions, 1.0, CONFIG)
    assert forward_motion(positions, motions, homography, SHAPE, CONFIG) is not None


@pytest.mark.parametrize(
    "own", [np.array([0.0, 0.0, 3.5]), np.array([1.0, 0.0, 0.0])], ids=["driven away from", "crossing"]
)
def test_what_drives_off_or_crosses_moves_as_no_static_point_would(own: Array) -> None:
    car = np.random.default_rng(2).uniform((1.5, -0.5, 12), (3.5, 1.2, 16), (60, 3))
    positions, motions = seen(car, np.array([0.0, 0.0, 1.5]), own)
    error = np.hypot(*(static_motion(driving(), positions, motions) - motions).T)
    assert np.median(error) > 2.0


def test_what_comes_closer_looks_like_something_nearer() -> None:
    car = np.random.default_rng(2).uniform((1.5, -0.5, 12), (3.5, 1.2, 16), (60, 3))
    positions, motions = seen(car, np.array([0.0, 0.0, 1.5]), np.array([0.0, 0.0, -1.0]))
    error = np.hypot(*(static_motion(driving(), positions, motions) - motions).T)
    assert np.median(error) < 0.5


@pytest.mark.parametrize("drive", [(0.0, 0.0, 0.0), (0.6, 0.0, 0.0), (0.0, 0.3, 0.05)])
def test_a_camera_that_turns_or_moves_sideways_does_not_drive(drive: tuple[float, float, float]) -> None:
    assert geometry_of(*seen(street(), np.array(drive))) is None


@pytest.mark.parametrize("back", [-1.5, -2.5, -4.0])
@pytest.mark.parametrize("seed", [0, 1])
def test_a_camera_that_backs_off_does_not_drive_forwards(back: float, seed: int) -> None:
    assert geometry_of(*seen(street(600, seed), np.array([0.0, 0.0, back]))) is None


def test_a_scene_that_a_homography_explains_needs_no_depths() -> None:
    road = street()
    road[:, 1] = 1.5
    assert geometry_of(*seen(road, np.array([0.0, 0.0, 1.5]))) is None


def test_a_large_object_before_a_camera_that_turns_does_not_make_it_drive() -> None:
    positions, motions = seen(street(), np.zeros(3))
    motions[np.abs(positions[:, 0] - 320) < 100] += np.array([9.0, 2.0], np.float32)
    assert geometry_of(positions, motions) is None


def test_motions_at_random_have_no_geometry() -> None:
    rng = np.random.default_rng(7)
    positions = rng.uniform((0, 0), (640, 480), (300, 2)).astype(np.float32)
    assert geometry_of(positions, rng.normal(0, 15, (300, 2)).astype(np.float32)) is None


def test_few_motions_at_random_have_no_geometry_either() -> None:
    for seed in range(60):  # with some of them OpenCV fails
        rng = np.random.default_rng(seed)
        positions = rng.uniform((0, 0), (160, 120), (26, 2)).astype(np.float32)
        motions = rng.normal(0, 3, (26, 2)).astype(np.float32)
        assert forward_motion(positions, motions, np.eye(3), (120, 160), CONFIG) is None


@pytest.mark.parametrize("count", [0, 5])
def test_few_points_say_nothing(count: int) -> None:
    positions, motions = seen(street(), np.array([0.0, 0.0, 1.5]))
    assert geometry_of(positions[:count], motions[:count]) is None
