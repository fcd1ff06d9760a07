"""Points of the background that are followed from frame to frame, for as long as they are seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from mlbs_actors.messages import Array

__all__ = ["Observations", "PointTracks"]

#: Points followed at once, at most, and how far apart they begin, px of a sketch. New ones are looked for
#: when there are fewer than that share.
POINTS, APART_PX, LEAST_SHARE = 1000, 8, 0.8
#: A point that, followed back, misses where it began by more is lost, px.
BACK_PX = 0.5
#: Nearer to what covers the background, and to the picture's edge, no point is followed, px.
CLEAR_PX = 4
#: Side of the square by which a point is known, px.
WINDOW = 7


@dataclass(frozen=True, slots=True)
class Observations:
    """Where points are seen.

    Attributes
    ----------
    point, frame : (n,) int64
        Which point, and in which frame; sorted by point, then by frame.
    at : (n, 2) float32
        (x, y), px of the sketch.
    """

    point: Array
    frame: Array
    at: Array


class PointTracks:
    """Follows points through a clip; frames are added in order."""

    def __init__(self) -> None:
        self._points: list[Array] = []  # of each frame, their numbers
        self._at: list[Array] = []
        self._last: Array | None = None
        self._number = 0

    def add(self, gray: Array, free: Array, guess: Array | None) -> None:
        """Add the next frame.

        Parameters
        ----------
        gray : (h, w) uint8
            Its sketch.
        free : (h, w) uint8
            1 where nothing covers the background.
        guess : (3, 3) float64 or None
            Homography from the frame before; None if it is of another shot.
        """
        usable = np.zeros_like(free)
        kernel = np.ones((2 * CLEAR_PX + 1,) * 2, np.uint8)
        inner = cv2.erode(free, kernel, borderValue=1)
        usable[CLEAR_PX:-CLEAR_PX, CLEAR_PX:-CLEAR_PX] = inner[CLEAR_PX:-CLEAR_PX, CLEAR_PX:-CLEAR_PX]
        points, at = np.zeros(0, np.int64), np.zeros((0, 2), np.float32)
        if self._last is not None and guess is not None and len(self._at[-1]):
            points, at = self._followed(self._last, gray, usable, guess)
        if len(points) < LEAST_SHARE * POINTS and usable.any():
            wanted = usable.copy()
            for x, y in np.round(at).astype(int):
                cv2.circle(wanted, (int(x), int(y)), APART_PX, 0, -1)
            found = cv2.goodFeaturesToTrack(
                gray, POINTS - len(points), 0.002, APART_PX, mask=wanted, blockSize=3
            )
            if found is not None:
                points = np.concatenate([points, self._number + np.arange(len(found))])
                at = np.concatenate([at, found[:, 0]])
                self._number += len(found)
        self._points.append(points)
        self._at.append(at)
        self._last = gray

    def _followed(self, last: Array, gray: Array, usable: Array, guess: Array) -> tuple[Array, Array]:
        before = self._at[-1][:, None]
        start = cv2.perspectiveTransform(before.astype(np.float64), guess).astype(np.float32)
        ends, found = _searched(last, gray, before, start)
        again, back = _searched(gray, last, ends, before)
        missed = np.linalg.norm((again - before)[:, 0], axis=1)
        at = np.round(ends[:, 0]).astype(int)
        height, width = gray.shape
        good = found & back & (missed < BACK_PX)
        good &= (at >= 0).all(axis=1) & (at < (width, height)).all(axis=1)
        good[good] = usable[at[good, 1], at[good, 0]] > 0
        return self._points[-1][good], ends[good, 0]

    def between(self, frames: Sequence[int]) -> Observations:
        """Return what is seen in these frames."""
        point = np.concatenate([self._points[frame] for frame in frames])
        frame = np.repeat(np.asarray(frames), [len(self._points[frame]) for frame in frames])
        at = np.concatenate([self._at[frame] for frame in frames])
        order = np.lexsort((frame, point))
        return Observations(point[order], frame[order], at[order])


def _searched(picture: Array, other: Array, points: Array, start: Array) -> tuple[Array, Array]:
    """Return where points (n, 1, 2) float32 of a picture lie in another, and which are found, (n,) bool."""
    ends, found, _ = cv2.calcOpticalFlowPyrLK(
        picture,
        other,
        points,
        start.copy(),
        winSize=(WINDOW, WINDOW),
        maxLevel=2,
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )
    return ends, found[:, 0] > 0
