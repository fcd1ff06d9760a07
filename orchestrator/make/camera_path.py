"""The camera's path through a clip: where each frame's background lies in the other frames' pictures.

A frame is tracked from a *key* frame, not from the one before it, as long as enough of the key's points are
found: a fixed camera does not drift however long the clip, and a moving one only where a key is left for the
next. Frames that cannot be placed begin a new shot.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from mlbs_actors.messages import Array

__all__ = ["CameraPath", "Pose"]

#: Frames are tracked at this width, px; what is finer costs time and adds little.
TRACKED_WIDTH = 640
#: Points tracked, at most.
POINTS = 600
#: A point that misses the camera's motion by more is not background, px at the tracked width.
INLIER_PX = 2.0
#: Points that must agree before a frame is placed by them.
LEAST_POINTS = 12
#: … and the least share of those tracked.
LEAST_SHARE = 0.3
#: The key is left for another one when fewer of its points are found.
KEPT_SHARE = 0.5
#: Grey levels by which a picture without points may differ from the last one in the same shot.
SAME_PICTURE = 12.0


@dataclass(frozen=True, slots=True)
class Pose:
    """Where a frame lies in its shot.

    Attributes
    ----------
    shot : int
        From 0. Frames of different shots show nothing of each other.
    to_shot : (3, 3) float64
        Homography from the frame's pixels to the pixels of its shot's first frame.
    """

    shot: int
    to_shot: Array

    def into(self, other: Pose) -> Array:
        """Return the homography from this frame's pixels to another frame's of the same shot, float64."""
        return _normed(np.linalg.solve(other.to_shot, self.to_shot))


@dataclass(frozen=True, slots=True)
class _Key:
    """A frame from which others are tracked: its grey picture, points (n, 1, 2) and place in the shot."""

    gray: Array
    points: Array
    to_shot: Array


class CameraPath:
    """Places one frame after the other."""

    def __init__(self) -> None:
        self._shot = -1
        self._key: _Key | None = None
        self._before: _Key | None = None
        self._in_key = np.eye(3)  # from the key's pixels to those of the frame before

    def place(self, frame: Array, free: Array, size: tuple[int, int]) -> Pose:
        """Place the next frame.

        Parameters
        ----------
        frame : (H, W, 3) uint8
            BGR.
        free : (h, w) uint8
            1 where the background is to be seen, at any size.
        size : (int, int)
            Width and height of the picture in whose pixels the pose is stated.

        Returns
        -------
        Pose
        """
        scale = min(1.0, TRACKED_WIDTH / frame.shape[1])
        gray = cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY)
        if scale < 1.0:
            smaller = (round(frame.shape[1] * scale), max(1, round(frame.shape[0] * scale)))
            gray = cv2.resize(gray, smaller, interpolation=cv2.INTER_AREA)
        seen = cv2.resize(free, (gray.shape[1], gray.shape[0]), interpolation=cv2.INTER_NEAREST)
        to_shot = self._placed(gray, seen)
        if to_shot is None:
            self._shot, to_shot = self._shot + 1, np.eye(3)
            self._key, self._in_key = None, np.eye(3)
        points = cv2.goodFeaturesToTrack(gray, POINTS, 0.003, 7, mask=seen, blockSize=5)
        found = np.zeros((0, 1, 2), np.float32) if points is None else points
        self._before = _Key(gray, found, to_shot)
        if self._key is None:
            self._key = self._before
        into = _resized((gray.shape[1], gray.shape[0]), size)
        stated = into @ to_shot @ np.linalg.inv(into)
        return Pose(self._shot, _normed(stated))

    def _placed(self, gray: Array, seen: Array) -> Array | None:
        """Return the homography from the frame to its shot; None where it belongs to no shot so far."""
        if self._key is None or self._before is None:
            return None
        found, share = _tracked(self._key, gray, seen, self._in_key)
        if found is None or share < KEPT_SHARE:
            other, _ = _tracked(self._before, gray, seen, np.eye(3))
            if other is not None:
                self._key, found = self._before, other
        if found is None:
            if not _alike(self._before, gray, seen):
                return None
            self._key, found = self._before, np.eye(3)
        self._in_key = found
        return _normed(self._key.to_shot @ np.linalg.inv(found))


def _normed(matrix: Array) -> Array:
    """Scale a homography so that its last element is 1."""
    normed: Array = matrix / matrix[2, 2]
    return normed


def _resized(size: tuple[int, int], other: tuple[int, int]) -> Array:
    """Return the matrix from the pixels of a picture to those of the same at another size (width, height)."""
    along, down = other[0] / size[0], other[1] / size[1]
    return np.array([[along, 0, along / 2 - 0.5], [0, down, down / 2 - 0.5], [0, 0, 1]])


def _tracked(key: _Key, gray: Array, seen: Array, guess: Array) -> tuple[Array | None, float]:
    """Return the homography from the key's pixels to the frame's, and the share of its points that agree."""
    if len(key.points) < LEAST_POINTS:
        return None, 0.0
    start = cv2.perspectiveTransform(key.points, guess).astype(np.float32)
    ends, status, _ = cv2.calcOpticalFlowPyrLK(
        key.gray, gray, key.points, start, winSize=(17, 17), maxLevel=3, flags=cv2.OPTFLOW_USE_INITIAL_FLOW
    )
    at = np.round(ends[:, 0]).astype(int)
    inside = (at >= 0).all(axis=1) & (at < (gray.shape[1], gray.shape[0])).all(axis=1)
    good = (status[:, 0] > 0) & inside
    good[good] = seen[at[good, 1], at[good, 0]] > 0
    if good.sum() < LEAST_POINTS:
        return None, 0.0
    matrix, agree = cv2.findHomography(
        key.points[good], ends[good], cv2.RANSAC, INLIER_PX, maxIters=1000, confidence=0.999
    )
    if matrix is None or agree.sum() < max(LEAST_POINTS, LEAST_SHARE * good.sum()):
        return None, 0.0
    height, width = gray.shape
    corners = np.array([[[0, 0]], [[width, 0]], [[width, height]], [[0, height]]], np.float32)
    moved = cv2.perspectiveTransform(corners, matrix)
    area = cv2.contourArea(moved, oriented=True) / cv2.contourArea(corners, oriented=True)
    if not 0.1 < area < 10.0:
        return None, 0.0
    return matrix, float(agree.sum()) / len(key.points)


def _alike(key: _Key, gray: Array, seen: Array) -> bool:
    """Whether two pictures without enough points show the same."""
    if not seen.any():
        return True
    return bool(np.median(cv2.absdiff(key.gray, gray)[seen > 0]) < SAME_PICTURE)
