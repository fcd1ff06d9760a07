"""Where the cameras of a part of a clip stand in a rigid scene, and where its points lie.

Two frames with much parallax are related first; then the other frames are placed, those first that see most
of the points known so far; at last all is adjusted together.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from mlbs_actors.messages import Array
from orchestrator.make.bundle_adjustment import Cameras, Sightings, adjusted, intersected, misses
from orchestrator.make.point_tracks import Observations

__all__ = ["Relation", "RigidScene", "solved"]

#: Points that two frames must share to be related first, and a frame with the scene to be placed in it.
PAIR_POINTS, FRAME_POINTS = 80, 12
#: What a homography must miss of the most displaced points of these two, px.
PARALLAX_PX = 1.5
#: Focal lengths tried, of the picture's width.
FOCAL = (0.7, 1.0, 1.5)
#: Frames in which a point must be seen, and points that are adjusted, at most.
SEEN_IN, ADJUSTED = 3, 1200
#: What points and frames may miss, px.
POINT_PX, FRAME_PX = 1.5, 1.0
#: Where a place is stated to be that lies behind a camera, px.
BEHIND = -1e4
#: Share of the points of the first two that must agree with them.
AGREE = 0.6


@dataclass(frozen=True, slots=True)
class Relation:
    """How one frame's pixels lie in another.

    Attributes
    ----------
    matrix : (3, 3) float64
        Homography of what is infinitely far away.
    shift : (3,) float64
        What is added, in homogeneous coordinates, for an inverse depth of 1.
    """

    matrix: Array
    shift: Array

    def places(self, points: Array, inverse: Array) -> Array:
        """Return where pixels (…, 2) of these inverse depths (…) lie, (…, 2) float32."""
        x, y = points[..., 0], points[..., 1]
        right, down, ahead = (
            one[0] * x + one[1] * y + one[2] + inverse * shift
            for one, shift in zip(self.matrix, self.shift, strict=True)
        )
        ahead = np.where(ahead < 1e-3, np.nan, ahead)
        there = np.stack([right / ahead, down / ahead], axis=-1)
        return np.asarray(np.nan_to_num(there, nan=BEHIND), np.float32)

    def of_plane(self, plane: Array) -> Array:
        """Return the homography of a plane, whose inverse depth is (x, y, 1) · ``plane``."""
        return np.asarray(self.matrix + np.outer(self.shift, plane))


@dataclass(frozen=True, slots=True)
class RigidScene:
    """Frames' cameras and the points that they have seen.

    Attributes
    ----------
    cameras : Cameras
    numbers : dict of int to int
        Of the frames that are placed well, which of the cameras is theirs.
    points : (n, 4) float64
        Homogeneous.
    centre : (2,) float64
        Of the sketch, px.
    """

    cameras: Cameras
    numbers: dict[int, int]
    points: Array
    centre: Array

    def relation(self, index: int, other: int) -> Relation:
        """Relate two frames that are placed."""
        here, there = self.numbers[index], self.numbers[other]
        focal, turns, shifts = self.cameras.focal, self.cameras.turns, self.cameras.shifts
        lens = np.array([[focal, 0, self.centre[0]], [0, focal, self.centre[1]], [0, 0, 1.0]])
        turn = turns[there] @ turns[here].T
        return Relation(lens @ turn @ np.linalg.inv(lens), lens @ (shifts[there] - turn @ shifts[here]))

    def points_of(self, index: int) -> tuple[Array, Array]:
        """Return where the points in front of a frame lie in its sketch, (n, 2), and inverse depths, (n,)."""
        here = self.numbers[index]
        there = (
            self.points[:, :3] @ self.cameras.turns[here].T + self.points[:, 3:] * self.cameras.shifts[here]
        )
        ahead = there[:, 2] > 1e-6
        there, inverse = there[ahead], self.points[ahead, 3] / there[ahead, 2]
        return there[:, :2] / there[:, 2:] * self.cameras.focal + self.centre, inverse


def solved(
    seen: Observations, size: tuple[int, int], homography: Callable[[int, int], Array]
) -> RigidScene | None:
    """Find the cameras of frames and the points that they see.

    Parameters
    ----------
    seen : Observations
    size : (int, int)
        Height and width of a sketch.
    homography : callable
        That from one frame's pixels to another's.

    Returns
    -------
    RigidScene or None
        None if there is too little parallax, or the frames do not show one rigid scene.
    """
    centre = (np.array([size[1], size[0]]) - 1) / 2
    frames, camera = np.unique(seen.frame, return_inverse=True)
    point = np.unique(seen.point, return_inverse=True)[1]
    often = np.bincount(point)[point] >= SEEN_IN
    if often.sum() < PAIR_POINTS:
        return None
    sightings, _ = Sightings(point, camera, seen.at - centre).of(often)
    pair = _pair(
        sightings,
        len(frames),
        size[1],
        lambda a, b: _centred(homography(int(frames[a]), int(frames[b])), centre),
    )
    if pair is None:
        return None
    cameras, first, known = _placed(sightings, *pair)
    sightings, _ = sightings.of(known[sightings.camera])
    counts = np.bincount(sightings.point)
    longest = np.zeros(len(counts), np.bool_)
    longest[np.argsort(-counts, kind="stable")[:ADJUSTED]] = True
    longest &= counts >= SEEN_IN
    some, _ = sightings.of(longest[sightings.point])
    cameras, _ = adjusted(some, cameras, intersected(some, cameras), first)
    points = intersected(sightings, cameras)
    missed = misses(sightings, cameras, points)
    agree = np.bincount(sightings.point, missed) / counts < POINT_PX
    error = [
        np.median(missed[sightings.camera == one]) if known[one] else np.inf for one in range(len(frames))
    ]
    numbers = {int(frame): one for one, frame in enumerate(frames) if error[one] < FRAME_PX}
    if agree.mean() < AGREE or len(numbers) < 2:
        return None
    return RigidScene(cameras, numbers, points[agree & (counts >= SEEN_IN)], centre)


def _centred(matrix: Array, centre: Array) -> Array:
    """State a homography in pixels from the picture's centre."""
    there = np.array([[1, 0, centre[0]], [0, 1, centre[1]], [0, 0, 1.0]])
    return np.asarray(np.linalg.inv(there) @ matrix @ there)


def _pair(
    seen: Sightings, number: int, width: int, homography: Callable[[int, int], Array]
) -> tuple[Cameras, int, int] | None:
    """Relate the two frames with most parallax among those that share enough points."""
    where = np.full((number, seen.point[-1] + 1), -1)
    where[seen.camera, seen.point] = np.arange(len(seen.point))
    step = max(1, number // 12)
    most, best = 0.0, None
    for first in range(0, number, step):
        for second in range(first + step, number, step):
            both = np.flatnonzero((where[first] >= 0) & (where[second] >= 0))
            if len(both) < PAIR_POINTS:
                continue
            here, there = seen.at[where[first, both]], seen.at[where[second, both]]
            placed = cv2.perspectiveTransform(here[:, None], homography(first, second))[:, 0]
            parallax = np.linalg.norm(placed - there, axis=1)
            score = np.quantile(parallax, 0.7) * np.sqrt(len(both))
            if score > most and np.quantile(parallax, 0.9) > PARALLAX_PX:
                most, best = score, (first, second, here, there)
    if best is None:
        return None
    first, second, here, there = best
    found: tuple[int, Cameras] | None = None
    for share in FOCAL:
        lens = np.diag([share * width, share * width, 1.0])
        essential, agree = cv2.findEssentialMat(here, there, lens, cv2.RANSAC, 0.999, 0.7)
        if essential is None or essential.shape != (3, 3):
            continue
        count, turn, shift, _, _ = cv2.recoverPose(
            essential, here, there, lens, distanceThresh=1e6, mask=agree
        )
        if count > (found[0] if found else AGREE * len(here)):
            turns, shifts = np.tile(np.eye(3), (number, 1, 1)), np.zeros((number, 3))
            turns[second], shifts[second] = turn, shift[:, 0]
            found = count, Cameras(share * width, turns, shifts)
    return None if found is None else (found[1], first, second)


def _placed(seen: Sightings, cameras: Cameras, first: int, second: int) -> tuple[Cameras, int, Array]:
    """Place the other cameras against the first two; also return which are placed, (m,) bool."""
    focal, turns, shifts = cameras.focal, cameras.turns.copy(), cameras.shifts.copy()
    known = np.zeros(len(turns), np.bool_)
    known[[first, second]] = True
    lens = np.diag([focal, focal, 1.0])
    while not known.all():
        cameras = Cameras(focal, turns, shifts)
        some, numbers = seen.of(known[seen.camera])
        points = intersected(some, cameras)
        counts = np.bincount(some.point)
        good = (counts >= 2) & (
            np.bincount(some.point, misses(some, cameras, points)) / counts < 4 * POINT_PX
        )
        place = np.full((seen.point[-1] + 1, 3), np.nan)
        place[numbers[good]] = points[good, :3] / np.maximum(points[good, 3:], 1e-4)
        usable = ~np.isnan(place[seen.point, 0])
        shared = np.bincount(seen.camera[usable], minlength=len(known))
        shared[known] = 0
        if shared.max() < FRAME_POINTS:
            break
        for one in np.argsort(-shared, kind="stable")[: max(1, int((~known).sum()) // 3)]:
            if shared[one] < FRAME_POINTS:
                break
            mine = usable & (seen.camera == one)
            others = np.flatnonzero(known)
            near = others[np.argmin(np.abs(others - one))]
            turn, shift = cv2.Rodrigues(turns[near])[0], shifts[near, :, None].copy()
            done, turn, shift, _ = cv2.solvePnPRansac(
                place[seen.point[mine]], seen.at[mine], lens, None, turn, shift, True, 200, 3.0, 0.999
            )
            turns[one], shifts[one] = (
                (cv2.Rodrigues(turn)[0], shift[:, 0]) if done else (turns[near], shifts[near])
            )
            known[one] = True
    return Cameras(focal, turns, shifts), first, known
