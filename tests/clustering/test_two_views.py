"""What an essential matrix and a homography explain of the trajectories in two pictures."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mlbs_actors.clustering.two_views import (
    BEHIND_PX,
    FIRST_RATINGS,
    FOCAL_LENGTHS,
    INLIER_PX,
    INLIER_RELATIVE,
    MOST_PARALLAX_PX,
    RATING_PERIOD,
    USUAL,
    FocalLength,
    Pairs,
    Places,
    in_scene,
    on_plane,
)
from mlbs_actors.messages import Array

SHAPE = (480, 640)


def pairs_of(points: Array, camera: Array, turn: float, focal_length: float) -> Pairs:
    """Points (n, 3) of a scene before a camera that goes to a place and turns by an angle, rad."""

    def seen(there: Array) -> Array:
        centre = np.array([SHAPE[1] / 2, SHAPE[0] / 2])
        return np.asarray(focal_length * max(SHAPE) * there[:, :2] / there[:, 2:] + centre, np.float32)

    cos, sin = np.cos(turn), np.sin(turn)
    rotation = np.array([[cos, 0, sin], [0, 1, 0], [-sin, 0, cos]])
    ids = np.arange(len(points))
    noise = np.random.default_rng(1).normal(0, 0.1, (len(points), 2)).astype(np.float32)
    before = Places(ids, seen((points + camera) @ rotation.T) + noise)
    return Pairs.between(before, Places(ids, seen(points)), np.zeros(len(points), np.int64), SHAPE)


def two_planes(focal_length: float) -> Array:
    """A slope before a far wall, (n, 3)."""
    y, x = (one.reshape(-1) for one in np.mgrid[8 : SHAPE[0] : 16, 8 : SHAPE[1] : 16])
    rays = np.stack([x - SHAPE[1] / 2, y - SHAPE[0] / 2], axis=1) / (focal_length * max(SHAPE))
    depth = np.where(y < 240, 60.0, 30.0 - 20.0 * (y - 240) / 240)
    return np.concatenate([rays * depth[:, None], depth[:, None]], axis=1)


MOTION = np.array([0.8, 0.3, 1.0])


def test_a_scene_in_depth_is_explained_by_an_essential_matrix_and_not_by_a_homography() -> None:
    pairs = pairs_of(two_planes(USUAL), MOTION, 0.05, USUAL)
    everything = np.arange(len(pairs.now))
    found = in_scene(pairs, everything)
    assert found is not None
    explained, static = found
    assert explained.mean() > 0.95
    assert static.mean() > 0.95
    flat = on_plane(pairs, everything)
    assert flat is not None
    assert 0.4 < flat.mean() < 0.7


@pytest.mark.parametrize("focal_length", FOCAL_LENGTHS)
def test_the_right_focal_length_explains_most_of_a_scene(focal_length: float) -> None:
    pairs = pairs_of(two_planes(focal_length), MOTION, 0.05, focal_length)
    everything = np.arange(len(pairs.now))
    rated = FocalLength()
    for part in range(8):
        rated = rated.rated(pairs, everything, everything[part::8])
    assert FOCAL_LENGTHS[int(np.argmax(rated.shares))] == focal_length


def test_as_long_as_no_other_explains_more_the_focal_length_is_the_usual_one() -> None:
    assert FocalLength().best == USUAL
    assert FocalLength((0.9, 0.88, 0.9, 0.9)).best == USUAL
    assert FocalLength((0.9, 0.6, 0.95, 0.9)).best == FOCAL_LENGTHS[2]


def test_what_obeys_a_matrix_lies_near_its_epipolar_line_and_on_the_near_side_of_infinity() -> None:
    points = two_planes(USUAL)
    pairs = pairs_of(points, MOTION, 0.05, USUAL)
    rng = np.random.default_rng(5)
    strays = rng.choice(len(points), 200, replace=False)
    moved = pairs.before.copy()
    moved[strays] += rng.normal(0, 20, (200, 2))
    pairs = replace(pairs, before=moved)
    chosen = np.setdiff1d(np.arange(len(points)), strays)
    found = in_scene(pairs, chosen)
    assert found is not None
    # The camera that made the points, instead of the fitted one, as geometry text books put it.
    cos, sin = np.cos(0.05), np.sin(0.05)
    rotation = np.array([[cos, 0, sin], [0, 1, 0], [-sin, 0, cos]])
    camera = pairs.camera
    explained, static = [], []
    for now, before in zip(pairs.now, pairs.before, strict=True):
        far = camera @ rotation @ np.linalg.inv(camera) @ [*now, 1.0]
        epipole = camera @ rotation @ MOTION
        line = np.cross(far, epipole)
        line /= np.hypot(*line[:2])
        parallax = before - far[:2] / far[2]
        towards = epipole[:2] - epipole[2] * far[:2] / far[2]
        allowed = np.array([np.hypot(*parallax), min(np.hypot(*parallax), MOST_PARALLAX_PX)])
        near = abs(line @ [*before, 1.0]) < INLIER_PX + INLIER_RELATIVE * allowed
        explained.append(near[0])
        static.append(near[1] and parallax @ towards / np.hypot(*towards) > -BEHIND_PX)
    # Fitted and true camera differ by a little noise, and few points lie just there.
    assert (found[0] == explained).mean() > 0.98
    assert (found[1] == static).mean() > 0.98
    assert 0.2 < np.mean(static) < 0.9
    assert np.mean(np.array(static)[strays]) < 0.5


def test_focal_lengths_are_rated_by_the_first_clusterings_and_then_now_and_again() -> None:
    pairs = pairs_of(two_planes(USUAL), MOTION, 0.05, USUAL)
    everything = np.arange(len(pairs.now))
    rated, changed = FocalLength(), []
    for clustering in range(1, FIRST_RATINGS + 2 * RATING_PERIOD + 1):
        before, rated = rated, rated.rated(pairs, everything, everything[::8])
        if rated.shares != before.shares:
            changed.append(clustering)
    later = [one for one in changed if one > FIRST_RATINGS]
    assert changed[:FIRST_RATINGS] == list(range(1, FIRST_RATINGS + 1))
    assert [one % RATING_PERIOD for one in later] == [0, 0]
