"""Cameras and points of a rigid scene that agree best with where the points are seen."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from mlbs_actors.messages import Array

__all__ = ["Cameras", "Sightings", "adjusted", "intersected", "misses"]

#: A sighting that misses by this much has lost most of its say, px.
ROBUST_PX = 0.7
#: Rounds of the adjustment, at most, and the gain of one below which it ends.
ROUNDS, LEAST_GAIN = 12, 1e-4


@dataclass(frozen=True, slots=True)
class Sightings:
    """Where points are seen.

    Attributes
    ----------
    point, camera : (k,) int64
        From 0. Sorted by point, and every point is seen at least once.
    at : (k, 2) float64
        (x, y) from the picture's centre, px.
    """

    point: Array
    camera: Array
    at: Array

    def of(self, chosen: Array) -> tuple[Sightings, Array]:
        """Return those chosen, (k,) bool, with points numbered anew, and their numbers here."""
        points, again = np.unique(self.point[chosen], return_inverse=True)
        return Sightings(again, self.camera[chosen], self.at[chosen]), points


@dataclass(frozen=True, slots=True)
class Cameras:
    """Cameras of one focal length.

    Attributes
    ----------
    focal : float
        px.
    turns : (m, 3, 3) float64
        From the scene's axes to each camera's: right, down, forward.
    shifts : (m, 3) float64
        Where the scene's origin lies for each.
    """

    focal: float
    turns: Array
    shifts: Array


def intersected(seen: Sightings, cameras: Cameras) -> Array:
    """Return the points (n, 4) whose homogeneous places agree best with straight lines of sight."""
    views = np.concatenate([cameras.turns, cameras.shifts[:, :, None]], axis=2)[seen.camera]
    rows = views[:, :2] - (seen.at / cameras.focal)[:, :, None] * views[:, 2:]
    normal = _summed(np.einsum("kai,kaj->kij", rows, rows), seen.point)
    points: Array = np.linalg.eigh(normal)[1][:, :, 0]
    ahead = np.sign(np.einsum("ki,ki->k", views[:, 2], points[seen.point]))
    points *= np.where(_summed(ahead, seen.point) < 0, -1.0, 1.0)[:, None]
    return points


def misses(seen: Sightings, cameras: Cameras, points: Array) -> Array:
    """Return by how much each sighting misses, (k,) px."""
    missed: Array = np.linalg.norm(_Projection(seen, cameras, points).missed, axis=1)
    return missed


def adjusted(seen: Sightings, cameras: Cameras, points: Array, fixed: int) -> tuple[Cameras, Array]:
    """Adjust cameras and points until the sightings are missed least, outliers aside.

    Levenberg and Marquardt's method, of which each round solves for the cameras with the points eliminated.

    Parameters
    ----------
    seen : Sightings
    cameras : Cameras
    points : (n, 4) float64
        Homogeneous.
    fixed : int
        The camera that stays where it is.

    Returns
    -------
    Cameras
    (n, 4) float64
        Of length 1.
    """
    points = points / np.linalg.norm(points, axis=1, keepdims=True)
    now = _Projection(seen, cameras, points)
    damping = 1e-3
    for turn in range(ROUNDS):
        normal = _Normal(now, max(1.0, 3.0 - turn))
        for _ in range(4):
            other = _Projection(seen, *normal.solved(damping, fixed))
            if other.cost < now.cost:
                break
            damping *= 8
        else:
            break
        gain, now = now.cost - other.cost, other
        damping = max(damping / 4, 1e-7)
        if gain < LEAST_GAIN * now.cost and turn > 3:
            break
    return now.cameras, now.points


def _summed(values: Array, groups: Array) -> Array:
    """Sum values (k, …) over groups (k,), which are sorted and without gaps."""
    sums: Array = np.add.reduceat(values, np.flatnonzero(np.diff(groups, prepend=-1)), axis=0)
    return sums


class _Projection:
    """Where cameras see points, and by how much (k, 2) they miss the sightings."""

    def __init__(self, seen: Sightings, cameras: Cameras, points: Array) -> None:
        self.seen, self.cameras, self.points = seen, cameras, points
        mine = points[seen.point]
        self.turned = np.einsum("kij,kj->ki", cameras.turns[seen.camera], mine[:, :3])
        self.there = self.turned + mine[:, 3:] * cameras.shifts[seen.camera]
        depth = self.there[:, 2:]
        self.depth = np.where(np.abs(depth) < 1e-9, 1e-9, depth)
        self.pixels = cameras.focal * self.there[:, :2] / self.depth
        self.missed = self.pixels - seen.at
        share = (self.missed**2).sum(axis=1) / ROBUST_PX**2
        self.cost = float((share / (1 + share)).sum())


class _Normal:
    """The normal equations at a projection: six unknowns a camera, the focal length, three a point."""

    def __init__(self, now: _Projection, wider: float) -> None:
        seen, cameras, points = now.seen, now.cameras, now.points
        self._now = now
        weight = 1 / (1 + (now.missed**2).sum(axis=1) / (ROBUST_PX * wider) ** 2) ** 2
        by_place = np.zeros((len(seen.point), 2, 3))
        by_place[:, 0, 0] = by_place[:, 1, 1] = cameras.focal / now.depth[:, 0]
        by_place[:, :, 2] = -now.pixels / now.depth
        x, y, z = now.turned.T
        zero = np.zeros_like(x)
        turning = np.stack([zero, z, -y, -z, zero, x, y, -x, zero], axis=1).reshape(-1, 3, 3)
        far = points[seen.point, 3][:, None, None]
        # Columns: six of the camera, the focal length, which all cameras share.
        by_camera = np.concatenate([by_place @ turning, by_place * far, now.pixels[:, :, None]], axis=2)
        # Points move at right angles to themselves, so that their length stays.
        self._basis = np.linalg.svd(points[:, None, :])[2][:, 1:].transpose(0, 2, 1)
        views = np.concatenate([cameras.turns, cameras.shifts[:, :, None]], axis=2)
        by_point = by_place @ views[seen.camera] @ self._basis[seen.point]
        weighted = by_camera * weight[:, None, None]
        number, unknowns = len(cameras.turns), 6 * len(cameras.turns) + 1
        order = np.argsort(seen.camera, kind="stable")
        both = np.zeros((number, 7, 7))
        wanted = np.zeros((number, 7))
        present = np.unique(seen.camera)
        both[present] = _by_camera(np.einsum("kai,kaj->kij", weighted, by_camera), seen.camera, order)
        wanted[present] = _by_camera(np.einsum("kai,ka->ki", weighted, now.missed), seen.camera, order)
        self._cameras = np.zeros((unknowns, unknowns))
        for one in range(number):
            at = slice(6 * one, 6 * one + 6)
            self._cameras[at, at] = both[one, :6, :6]
        self._cameras[:-1, -1] = self._cameras[-1, :-1] = both[:, :6, 6].ravel()
        self._cameras[-1, -1] = both[:, 6, 6].sum()
        self._camera_side = np.append(wanted[:, :6].ravel(), wanted[:, 6].sum())
        self._points = _summed(np.einsum("k,kai,kaj->kij", weight, by_point, by_point), seen.point)
        self._point_side = _summed(np.einsum("k,kai,ka->ki", weight, by_point, now.missed), seen.point)
        cross = np.einsum("kai,kaj->kij", weighted, by_point)
        self._mixed = np.zeros((unknowns, len(points), 3))
        for row in range(6):
            self._mixed[6 * seen.camera + row, seen.point] = cross[:, row]
        self._mixed[-1] = _summed(cross[:, 6], seen.point)

    def solved(self, damping: float, fixed: int) -> tuple[Cameras, Array]:
        """Return cameras and points after one step, damped."""
        cameras, points = self._now.cameras, self._now.points
        unknowns = len(self._camera_side)
        size = np.trace(self._points, axis1=1, axis2=2) / 3 + 1e-9
        inverse = np.linalg.inv(self._points + damping * size[:, None, None] * np.eye(3))
        mixed = np.einsum("pni,nij->pnj", self._mixed, inverse)
        matrix = self._cameras - mixed.reshape(unknowns, -1) @ self._mixed.reshape(unknowns, -1).T
        side = self._camera_side - np.einsum("pni,ni->p", mixed, self._point_side)
        own = np.diag(self._cameras)
        matrix[np.diag_indices(unknowns)] += damping * own + 1e-9 * own.max()
        still = slice(6 * fixed, 6 * fixed + 6)
        matrix[still], matrix[:, still], side[still] = 0, 0, 0
        matrix[still, still] = np.eye(6)
        step = -np.linalg.solve(matrix, side)
        moved = -np.einsum(
            "nij,nj->ni", inverse, self._point_side + np.einsum("pni,p->ni", self._mixed, step)
        )
        by_camera = step[:-1].reshape(-1, 6)
        turns = np.stack(
            [cv2.Rodrigues(one[:3])[0] @ turn for one, turn in zip(by_camera, cameras.turns, strict=True)]
        )
        focal = cameras.focal * float(np.exp(np.clip(step[-1], -0.2, 0.2)))
        points = points + np.einsum("nij,nj->ni", self._basis, moved)
        points /= np.linalg.norm(points, axis=1, keepdims=True)
        return Cameras(focal, turns, cameras.shifts + by_camera[:, 3:]), points


def _by_camera(values: Array, camera: Array, order: Array) -> Array:
    """Sum values (k, …) of each camera that is present, in their order."""
    ranks = np.unique(camera[order], return_inverse=True)[1]
    return _summed(values[order], ranks)
