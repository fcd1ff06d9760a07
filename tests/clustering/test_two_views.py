"""What an essential matrix and a homography explain of the trajectories in two pictures."""

from __future__ import annotations

import numpy as np
import pytest

from mlbs_actors.clustering.two_views import (
    FOCAL_LENGTHS,
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
