"""Cameras, points and depths of a rigid scene are found again, and none are where there is no depth."""

from __future__ import annotations

from itertools import combinations

import cv2
import numpy as np
import pytest

from mlbs_actors.messages import Array
from orchestrator.make.holes import holes_of
from orchestrator.make.planes import depth_at, planes_of
from orchestrator.make.point_tracks import Observations
from orchestrator.make.scene_geometry import solved

SIZE, FOCAL = (240, 320), 300.0
CENTRE = np.array([159.5, 119.5])


def poses(number: int, way: float) -> list[tuple[Array, Array]]:
    """Return cameras that turn a little, and go ``way`` m to the side and forward."""
    return [
        (cv2.Rodrigues(np.array([0.01 * k, -0.02 * k, 0.0]))[0], np.array([-way * k, 0.0, -0.5 * way * k]))
        for k in range(number)
    ]


def projected(points: Array, pose: tuple[Array, Array]) -> Array:
    there = points @ pose[0].T + pose[1]
    return np.asarray(there[:, :2] / there[:, 2:] * FOCAL + CENTRE)


def observed(points: Array, cameras: list[tuple[Array, Array]]) -> Observations:
    """Let all cameras see all points, to a tenth of a pixel; each tenth point is followed wrongly."""
    rng = np.random.default_rng(2)
    at = np.stack([projected(points, camera) for camera in cameras], axis=1)
    at += rng.normal(0, 0.1, at.shape)
    at[::10] += np.cumsum(rng.normal(0, 4, at[::10].shape), axis=1)
    point = np.repeat(np.arange(len(points)), len(cameras))
    frame = np.tile(np.arange(len(cameras)), len(points))
    return Observations(point, frame, at.reshape(-1, 2).astype(np.float32))


def homography(points: Array, cameras: list[tuple[Array, Array]], first: int, second: int) -> Array:
    matrix, _ = cv2.findHomography(
        projected(points, cameras[first]), projected(points, cameras[second]), cv2.RANSAC, 2.0
    )
    return np.asarray(matrix)


def points_in_view(number: int) -> Array:
    rng = np.random.default_rng(3)
    depth = rng.uniform(3, 30, number)
    return np.column_stack(
        [rng.uniform(-0.5, 0.5, number) * depth, rng.uniform(-0.4, 0.4, number) * depth, depth]
    )


def test_a_place_in_one_frame_is_found_in_another_by_its_depth() -> None:
    points, cameras = points_in_view(300), poses(12, 0.05)
    scene = solved(observed(points, cameras), SIZE, lambda a, b: homography(points, cameras, a, b))
    assert scene is not None
    assert sorted(scene.numbers) == list(range(12))
    # Depths of new points are known up to the scale of the scene, which that of known ones states.
    at, inverse = scene.points_of(3)
    truth = projected(points, cameras[3])
    nearest = np.linalg.norm(at[:, None] - truth, axis=2)
    depth = (points @ cameras[3][0].T + cameras[3][1])[nearest.argmin(axis=1), 2]
    scale = np.median((inverse * depth)[nearest.min(axis=1) < 0.5])
    new = np.random.default_rng(4).permutation(points)[:50] * (1.0, 0.8, 1.1)
    inverse_of_new = scale / (new @ cameras[3][0].T + cameras[3][1])[:, 2]
    there = scene.relation(3, 9).places(projected(new, cameras[3]), inverse_of_new)
    assert np.median(np.linalg.norm(there - projected(new, cameras[9]), axis=1)) < 0.3


def test_a_camera_that_only_turns_has_no_scene() -> None:
    points, cameras = points_in_view(300), poses(12, 0.0)
    clean = observed(points, cameras)
    good = clean.point % 10 > 0
    seen = Observations(clean.point[good], clean.frame[good], clean.at[good])
    assert solved(seen, SIZE, lambda a, b: homography(points, cameras, a, b)) is None


def test_too_few_points_have_no_scene() -> None:
    points, cameras = points_in_view(40), poses(12, 0.05)
    assert solved(observed(points, cameras), SIZE, lambda a, b: np.eye(3)) is None


def test_planes_are_found_among_other_points_those_with_most_points_first() -> None:
    rng = np.random.default_rng(5)
    truth = np.array([[1e-4, 2e-3, 0.1], [0.0, 0.0, 0.9], [3e-3, 0.0, 0.05]])
    at = np.vstack(
        [rng.uniform(0, 300, (120, 2)), rng.uniform(100, 160, (60, 2)), rng.uniform(200, 240, (30, 2))]
    )
    inverse = np.repeat(truth, (120, 60, 30), axis=0)
    inverse = (inverse[:, :2] * at).sum(axis=1) + inverse[:, 2] + rng.normal(0, 1e-3, 210)
    at, inverse = np.vstack([at, rng.uniform(0, 300, (40, 2))]), np.append(inverse, rng.uniform(2, 5, 40))
    found = planes_of(at, inverse, np.full(250, 3e-3))
    assert len(found) >= 3
    corners = np.array([[100.0, 100.0], [160.0, 100.0], [200.0, 240.0], [240.0, 200.0]])
    for one, plane in zip(found, truth, strict=False):
        assert np.abs(depth_at(one, corners) - depth_at(plane, corners)).max() < 5e-3


@pytest.mark.parametrize("seed", range(5))
def test_a_plane_has_about_as_many_points_as_the_best_through_any_three(seed: int) -> None:
    rng = np.random.default_rng(seed)
    at, inverse = rng.uniform(0, 100, (24, 2)), rng.uniform(0, 1, 24)
    inverse[:14] = at[:14] @ (1e-3, -2e-3) + 0.5 + rng.normal(0, 2e-3, 14)
    rows = np.column_stack([at, np.ones(24)])

    def points_on(plane: Array) -> int:
        return int((np.abs(rows @ plane - inverse) < 0.01).sum())

    triples = [list(three) for three in combinations(range(24), 3)]
    most = max(points_on(np.linalg.solve(rows[three], inverse[three])) for three in triples)
    assert points_on(planes_of(at, inverse, np.full(24, 5e-3))[0]) >= most - 1


@pytest.mark.parametrize(("apart", "number"), [(120, 2), (20, 1)])
def test_holes_far_apart_are_filled_apart(apart: int, number: int) -> None:
    hidden = np.zeros(SIZE, np.uint8)
    hidden[50:60, 40:52] = hidden[60:70, 40 + apart : 60 + apart] = 1
    frame = np.random.default_rng(6).integers(0, 255, (*SIZE, 3)).astype(np.uint8)
    holes = holes_of(frame, hidden, 1 / 10)
    assert len(holes) == number
    assert sorted(np.concatenate([hole.inside for hole in holes])) == list(np.flatnonzero(hidden))
    for hole in holes:
        rows, columns = np.divmod(hole.inside, SIZE[1])
        corner = np.array([hole.region.x, hole.region.y])
        assert (hole.at + corner == np.stack([columns, rows], axis=1)).all()
