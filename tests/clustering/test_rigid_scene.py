"""Static parts of a scene that move only because they are near are told from objects."""

from __future__ import annotations

from itertools import count

import numpy as np
import pytest

from mlbs_actors.clustering import rigid_scene
from mlbs_actors.clustering.rigid_scene import (
    FOCAL,
    Places,
    border_share,
    judge_by_depth,
    scene_squares,
    taken_squares,
)
from mlbs_actors.config import LayersConfig
from mlbs_actors.messages import Array

SHAPE = (480, 640)
#: Nothing is fixed in the picture.
SCENE = np.zeros((120, 160), bool)
#: What the camera does between the two pictures, in units of the scene.
SIDEWAYS, FORWARDS = np.array([0.3, 0.05, 0.02]), np.array([0.05, 0.0, 0.8])


def seen(points: Array, camera: Array) -> Array:
    """Where points (n, 3) of the scene are in the picture, px, (n, 2) float32."""
    there = points - camera
    centre = np.array([SHAPE[1] / 2, SHAPE[0] / 2])
    return np.asarray(FOCAL * max(SHAPE) * there[:, :2] / there[:, 2:] + centre, np.float32)


def scene(
    near: tuple[slice, slice], motion: Array, camera: Array, relief: float = 8.0
) -> tuple[list[Places], Array]:
    """A background of some depths, and something near, labelled 1, that moves itself by ``motion``."""
    y, x = (one.reshape(-1) for one in np.mgrid[8 : SHAPE[0] : 16, 8 : SHAPE[1] : 16])
    labels = np.zeros(len(x), np.int64)
    inside = np.zeros(SHAPE, bool)
    inside[near] = True
    labels[inside[y, x]] = 1
    generator = np.random.default_rng(1)
    depth = np.where(labels == 1, 4.0, 12.0) + relief * generator.uniform(size=len(x))
    rays = np.stack([x - SHAPE[1] / 2, y - SHAPE[0] / 2], axis=1) / (FOCAL * max(SHAPE))
    points = np.concatenate([rays * depth[:, None], depth[:, None]], axis=1)
    now, before = seen(points, np.zeros(3)), seen(points - (labels == 1)[:, None] * motion, -camera)
    ids = np.arange(len(x))
    noise = generator.normal(0, 0.1, before.shape).astype(np.float32)
    return [Places(ids, now), Places(ids[5:], (before + noise)[5:])], labels


LEFT, MIDDLE = (slice(0, 480), slice(0, 200)), (slice(150, 330), slice(200, 420))
CORNER = (slice(200, 280), slice(0, 90))
STILL, ITSELF = np.zeros(3), np.array([0.0, 0.4, 0.1])


def test_the_outline_of_what_reaches_out_of_the_frame_is_partly_the_border() -> None:
    showing = scene_squares(SCENE, SHAPE)
    for near, share in ((LEFT, 0.6), (MIDDLE, 0.0)):
        places, labels = scene(near, STILL, SIDEWAYS)
        taken = taken_squares(places[0].positions[labels == 1], SHAPE)
        assert border_share(taken, showing) == pytest.approx(share, abs=0.15 * (share > 0))
    assert border_share(taken_squares(np.zeros((2, 2), np.float32), SHAPE), showing) == 0.0


def test_the_scene_ends_where_the_picture_is_fixed() -> None:
    places, labels = scene((slice(200, 380), slice(150, 490)), STILL, SIDEWAYS, relief=0.0)
    bonnet = SCENE.copy()
    bonnet[95:] = True
    config = LayersConfig()
    for fixed, static in ((SCENE, set()), (bonnet, {1})):
        assert judge_by_depth(places, labels, {1}, set(), fixed, SHAPE, config) == (static, set())


@pytest.mark.parametrize("camera", [SIDEWAYS, FORWARDS])
def test_a_near_part_of_a_flat_scene_is_background_if_it_reaches_out_of_the_frame(camera: Array) -> None:
    config = LayersConfig()
    for near, motion, young, static in (
        (LEFT, STILL, {1}, {1}),
        (LEFT, STILL, set(), set()),
        (MIDDLE, STILL, {1}, set()),  # surrounded by a plane: depth would explain too much
        (CORNER, STILL, {1}, set()),  # small: the outcome hangs on a few trajectories
    ):
        places, labels = scene(near, motion, camera, relief=0.0)
        assert judge_by_depth(places, labels, young, set(), SCENE, SHAPE, config) == (static, set())


@pytest.mark.parametrize("camera", [SIDEWAYS, FORWARDS])
def test_a_scene_with_depth_tells_static_things_anywhere(camera: Array) -> None:
    config = LayersConfig()
    for near, motion, static in (
        (MIDDLE, STILL, {1}),
        (CORNER, STILL, {1}),
        (MIDDLE, ITSELF, set()),
        (LEFT, ITSELF, set()),
    ):
        places, labels = scene(near, motion, camera)
        for young in ({1}, set()):
            assert judge_by_depth(places, labels, young, set(), SCENE, SHAPE, config) == (static, set())
        assert judge_by_depth(places, labels, set(), {1}, SCENE, SHAPE, config) == (set(), set())


@pytest.mark.parametrize("fitted", [1, 2])
def test_what_the_matrix_of_half_of_the_background_contradicts_is_not_static(
    fitted: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    places, labels = scene(MIDDLE, STILL, SIDEWAYS)
    obeying, fits = rigid_scene._obeying, count()

    def one_contradicts(pairs: rigid_scene._Pairs, chosen: Array, *, in_front: bool = False) -> Array | None:
        obeys = obeying(pairs, chosen, in_front=in_front)
        assert obeys is not None
        return obeys & (pairs.labels != 1) if next(fits) == fitted else obeys

    monkeypatch.setattr(rigid_scene, "_obeying", one_contradicts)
    assert judge_by_depth(places, labels, set(), set(), SCENE, SHAPE, LayersConfig()) == (set(), set())
    assert next(fits) == fitted + 1


def test_what_keeps_pace_with_a_driving_camera_is_behind_infinity() -> None:
    for speed, static in ((0.0, {1}), (1.5, set())):  # x the camera's
        places, labels = scene(MIDDLE, speed * FORWARDS, FORWARDS)
        assert judge_by_depth(places, labels, {1}, set(), SCENE, SHAPE, LayersConfig()) == (static, set())


@pytest.mark.parametrize("camera", [SIDEWAYS, FORWARDS])
def test_what_no_depth_explains_moves_by_itself(camera: Array) -> None:
    config = LayersConfig()
    places, labels = scene(MIDDLE, ITSELF, camera)
    assert judge_by_depth(places, labels, {1}, {1}, SCENE, SHAPE, config) == (set(), {1})
    assert judge_by_depth(places, labels, {1}, set(), SCENE, SHAPE, config) == (set(), set())
    assert judge_by_depth(places, labels, set(), {1}, SCENE, SHAPE, config) == (set(), set())
    places, labels = scene(MIDDLE, STILL, camera)
    assert judge_by_depth(places, labels, {1}, {1}, SCENE, SHAPE, config) == (set(), set())


def test_without_a_background_nothing_contradicts_the_scene() -> None:
    places, labels = scene(LEFT, ITSELF, SIDEWAYS)
    labels[labels == 0] = 2
    assert judge_by_depth(places, labels, {1}, {1}, SCENE, SHAPE, LayersConfig()) == ({1}, set())
