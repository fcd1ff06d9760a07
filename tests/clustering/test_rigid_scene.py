"""Static parts of a scene that move only because they are near are told from objects."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
import pytest

from mlbs_actors.clustering.outline import border_share, scene_squares, taken_squares
from mlbs_actors.clustering.rigid_scene import SceneEvidence, scene_evidence
from mlbs_actors.clustering.two_views import USUAL, FocalLength, Places
from mlbs_actors.config import IdentityConfig, LayersConfig
from mlbs_actors.messages import Array

SHAPE, IDENTITY = (480, 640), IdentityConfig()
#: Nothing is fixed in the picture.
SCENE = np.zeros((120, 160), bool)
#: What the camera does between the two pictures, in units of the scene.
SIDEWAYS, FORWARDS = np.array([0.3, 0.05, 0.02]), np.array([0.05, 0.0, 0.8])


def seen(points: Array, camera: Array) -> Array:
    """Where points (n, 3) of the scene are in the picture, px, (n, 2) float32."""
    there = points - camera
    centre = np.array([SHAPE[1] / 2, SHAPE[0] / 2])
    return np.asarray(USUAL * max(SHAPE) * there[:, :2] / there[:, 2:] + centre, np.float32)


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
    rays = np.stack([x - SHAPE[1] / 2, y - SHAPE[0] / 2], axis=1) / (USUAL * max(SHAPE))
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


def weighed(
    places: list[Places],
    labels: Array,
    fixed: Array = SCENE,
    speed: float = 3.0,
    objects: Collection[int] = (),
) -> SceneEvidence:
    """The evidence for labels that move ``speed`` times as fast as the slowest objects."""
    speeds = dict.fromkeys(labels.tolist(), speed)
    return scene_evidence(places, labels, objects, speeds, fixed, SHAPE, FocalLength(), LayersConfig())


@pytest.mark.parametrize("camera", [SIDEWAYS, FORWARDS])
@pytest.mark.parametrize("near", [MIDDLE, CORNER, LEFT])
def test_in_a_scene_with_depth_motion_tells_what_is_static(near: tuple[slice, slice], camera: Array) -> None:
    assert weighed(*scene(near, STILL, camera)).motion[1] > 2.0
    assert weighed(*scene(near, ITSELF, camera)).motion[1] < -1.5


@pytest.mark.parametrize("camera", [SIDEWAYS, FORWARDS])
def test_before_a_plane_motion_tells_hardly_anything(camera: Array) -> None:
    for near in (MIDDLE, CORNER):
        for motion in (STILL, ITSELF):
            assert abs(weighed(*scene(near, motion, camera, relief=0.0)).motion[1]) <= 0.5


def test_the_background_may_be_a_small_piece_of_the_scene() -> None:
    places, labels = scene(MIDDLE, STILL, SIDEWAYS)
    x, y = places[0].positions.T
    pieces = np.where(labels == 1, 1, 2 + (x // 160 + 4 * (y // 160)).astype(np.int64))
    pieces[pieces == 2] = 0
    assert min(weighed(places, pieces).motion.values()) > 2.0
    places, _ = scene(MIDDLE, ITSELF, SIDEWAYS)
    motion = weighed(places, pieces).motion
    assert motion.pop(1) < -1.5
    assert min(motion.values()) > 2.0


def test_the_scene_is_not_fitted_to_objects() -> None:
    large = (slice(60, 420), slice(100, 540))
    places, labels = scene(large, ITSELF, SIDEWAYS)
    labels[labels == 1] = np.where(places[0].positions[labels == 1, 0] < 320, 1, 2)
    assert weighed(places, labels, objects={1, 2}).motion[1] < -1.5


def test_what_keeps_pace_with_a_driving_camera_is_behind_infinity() -> None:
    assert weighed(*scene(MIDDLE, 1.5 * FORWARDS, FORWARDS)).motion[1] < -1.5


def test_trajectories_that_are_younger_are_judged_by_newer_pictures() -> None:
    (now, before), labels = scene(MIDDLE, STILL, SIDEWAYS)
    old = Places(before.ids[labels[before.ids] == 0], before.positions[labels[before.ids] == 0])
    assert 1 not in weighed([now, old], labels).motion
    for newer in ([before, old, old], [old, before, old]):
        assert weighed([now, *newer], labels).motion[1] > 2.0


def test_what_reaches_out_of_the_frame_is_rather_static() -> None:
    surrounded, reaching = (weighed(*scene(near, STILL, SIDEWAYS)).standing[1] for near in (MIDDLE, LEFT))
    assert surrounded < reaching - 2.0


def test_the_scene_ends_where_the_picture_is_fixed() -> None:
    places, labels = scene((slice(200, 380), slice(150, 490)), STILL, SIDEWAYS)
    bonnet = SCENE.copy()
    bonnet[95:] = True
    assert weighed(places, labels, bonnet).standing[1] > weighed(places, labels).standing[1] + 1.0


def test_what_is_slow_or_stands_in_a_scene_with_depth_is_rather_static() -> None:
    places, labels = scene(MIDDLE, STILL, SIDEWAYS)
    standing = [weighed(places, labels, speed=speed).standing[1] for speed in (0.3, 1.0, 3.0, 16.0)]
    assert standing == sorted(standing, reverse=True)
    planar = weighed(*scene(MIDDLE, STILL, SIDEWAYS, relief=0.0)).standing[1]
    assert planar < weighed(places, labels).standing[1] - 1.0


def test_without_a_scene_nothing_is_known_of_motions() -> None:
    places, labels = scene(LEFT, STILL, SIDEWAYS)
    assert weighed([places[0]], labels).motion == {}
    generator = np.random.default_rng(2)
    moved = places[1].positions + generator.normal(0, 40, places[1].positions.shape).astype(np.float32)
    assert weighed([places[0], Places(places[1].ids, moved)], labels).motion == {1: 0.0}


def test_evidence_is_gathered_over_the_lives_of_trajectories() -> None:
    def seen(static: Array, labels: Array, **motion: float) -> Array:
        evidence = SceneEvidence({int(key[1:]): odds for key, odds in motion.items()}, {}, FocalLength())
        return evidence.gathered(static, labels, IDENTITY)

    unknown = np.full(4, np.nan, np.float32)
    first = seen(unknown, np.array([1, 1, 2, 0]), _1=2.0)
    np.testing.assert_array_equal(first, np.array([2.0, 2.0, np.nan, np.nan], np.float32))
    # The same piece of the scene under another name, with a new trajectory.
    again = seen(first, np.array([3, 3, 3, 0]), _3=-1.0)
    np.testing.assert_allclose(again[:3], 2.0 * IDENTITY.fading - IDENTITY.weight)
    # One of them alone.
    parted = seen(again, np.array([4, 3, 3, 0]), _4=1.0)
    assert parted[0] == pytest.approx(again[0] * IDENTITY.fading + IDENTITY.weight)
    np.testing.assert_array_equal(parted[1:], again[1:])


def test_the_odds_of_a_label_are_by_all_that_is_known() -> None:
    evidence = SceneEvidence({}, {1: -0.5, 2: 1.5}, FocalLength())
    static = np.array([1.0, 2.0, np.nan, np.nan, 8.0], np.float32)
    assert evidence.odds(static, np.array([1, 1, 1, 2, 0])) == {1: pytest.approx(1.0), 2: 1.5}


def test_while_nothing_moves_at_all_nothing_is_known_of_motions() -> None:
    generator = np.random.default_rng(3)
    for _ in range(30):  # OpenCV 4.10 finds none, any or one that holds no numbers, by chance
        positions = (generator.uniform(size=(800, 2)) * SHAPE[::-1]).astype(np.float32)
        now = Places(np.arange(800), positions)
        motion = weighed([now, now], (positions[:, 0] > 500).astype(np.int64)).motion
        assert motion.get(1, 0.0) == pytest.approx(0.0, abs=0.5)
