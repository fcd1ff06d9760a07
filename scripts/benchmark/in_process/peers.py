"""Alternatives to the engine: moving against not moving with OpenCV alone, in a few lines each.

All of them subtract the camera's motion by a homography and give one mask per frame, without separate
objects. They are written to be good at it with one set of parameters, in one thread, so that a comparison is
fair.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import cv2
import numpy as np

from benchmark.options import PEER_NAMES
from mlbs_actors.messages import Array

__all__ = ["PEERS", "FlowComposite", "FlowResidual", "Peer", "StabilisedMog2"]

#: GrabCut works on the frame shrunk by this.
SHRINK = 2
#: Reprojection error of an inlier of the camera's homography, px.
INLIER_PX = 1.0
#: Spacing, px, at which the flow votes for the camera's motion.
VOTE_STEP = 16
#: Residual motion below this is noise, px a frame.
LEAST_RESIDUAL_PX = 1.0
#: Share of the last frame's average that is kept.
KEPT_SHARE = 0.7
#: Components smaller than this share of the frame are specks.
SPECK_SHARE = 0.0005
#: How far the stabilised frame may drift, in frame widths; beyond that the background is learnt anew.
MOST_DRIFT = 0.25


class Peer(Protocol):
    """A two-label subtractor."""

    def apply(self, frame: Array) -> Array:
        """Take the next frame, (H, W, 3) uint8 BGR; return what moves, (H, W) bool."""


class FlowResidual:
    """DIS flow minus the camera's homography, thresholded by Otsu's rule."""

    def __init__(self) -> None:
        self._flow = _BackwardFlow()

    def apply(self, frame: Array) -> Array:
        """See :class:`Peer`."""
        backward = self._flow.to_previous(frame)
        if backward is None:
            return np.zeros(frame.shape[:2], bool)
        return _without_specks(_moving(_residual(backward)))


class FlowComposite:
    """The same, averaged along the flow over time, outlined by GrabCut on the shrunk frame."""

    def __init__(self) -> None:
        self._flow = _BackwardFlow()
        self._average: Array | None = None

    def apply(self, frame: Array) -> Array:
        """See :class:`Peer`."""
        backward = self._flow.to_previous(frame)
        if backward is None:
            return np.zeros(frame.shape[:2], bool)
        residual = _residual(backward)
        if self._average is not None:
            residual = KEPT_SHARE * _warped(self._average, backward) + (1.0 - KEPT_SHARE) * residual
        self._average = residual
        moving = _moving(residual).astype(np.uint8)
        height, width = moving.shape
        size = (max(1, width // SHRINK), max(1, height // SHRINK))
        small = cv2.resize(frame, size, interpolation=cv2.INTER_AREA)
        cut_out = _cut_out(small, cv2.resize(moving, size, interpolation=cv2.INTER_NEAREST).astype(bool))
        large = cv2.resize(cut_out.astype(np.uint8), (width, height), interpolation=cv2.INTER_NEAREST)
        return _without_specks(large.astype(bool))


class StabilisedMog2:
    """MOG2 on frames that are registered to the first one by homographies of tracked corners."""

    def __init__(self) -> None:
        self._restart()

    def _restart(self) -> None:
        self._model = cv2.createBackgroundSubtractorMOG2(history=200, varThreshold=16, detectShadows=False)
        self._last: Array | None = None
        self._to_first = np.eye(3)

    def apply(self, frame: Array) -> Array:
        """See :class:`Peer`."""
        gray = cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY)
        if self._last is not None:
            self._to_first = self._to_first @ _corner_homography(gray, self._last)
            self._to_first /= self._to_first[2, 2]
        height, width = gray.shape
        corners = np.array([[[0, 0], [width, 0], [width, height], [0, height]]], np.float64)
        moved = cv2.perspectiveTransform(corners, self._to_first) - corners
        if not np.abs(moved).max() < MOST_DRIFT * width:
            self._restart()
        self._last = gray
        stabilised = cv2.warpPerspective(
            frame, self._to_first, (width, height), borderMode=cv2.BORDER_REPLICATE
        )
        foreground = (self._model.apply(stabilised) > 0).astype(np.uint8)
        flags = cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP
        back = cv2.warpPerspective(foreground, self._to_first, (width, height), flags=flags)
        return _without_specks(cv2.medianBlur(back, 5).astype(bool))


#: By the name that chooses it.
PEERS: dict[str, Callable[[], Peer]] = dict(
    zip(PEER_NAMES, (StabilisedMog2, FlowResidual, FlowComposite), strict=True)
)


class _BackwardFlow:
    """DIS flow from each frame to the one before it."""

    def __init__(self) -> None:
        self._dis = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
        self._last: Array | None = None

    def to_previous(self, frame: Array) -> Array | None:
        """Return the flow, (H, W, 2) float32 px; None for the first frame."""
        gray, last = cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY), self._last
        self._last = gray
        return None if last is None else self._dis.calc(gray, last, None)  # type: ignore[call-overload]


def _pixels(shape: tuple[int, ...]) -> Array:
    rows, columns = np.indices(shape[:2], dtype=np.float32)
    return np.dstack([columns, rows])


def _residual(backward: Array) -> Array:
    """Return the residual of a backward flow after the camera's homography, (h, w) float32, px."""
    at = _pixels(backward.shape)
    votes = np.s_[VOTE_STEP // 2 :: VOTE_STEP, VOTE_STEP // 2 :: VOTE_STEP]
    start, end = at[votes].reshape(-1, 2), (at + backward)[votes].reshape(-1, 2)
    matrix = None
    if len(start) >= 4:
        matrix, _ = cv2.findHomography(start, end, cv2.RANSAC, INLIER_PX)
    if matrix is None:
        return np.zeros(backward.shape[:2], np.float32)
    by_camera = cv2.perspectiveTransform(at.reshape(1, -1, 2), matrix).reshape(at.shape)
    return np.asarray(np.hypot(*np.moveaxis(at + backward - by_camera, 2, 0)), np.float32)


def _warped(image: Array, backward: Array) -> Array:
    """Warp a map of the last frame along the flow."""
    source = _pixels(backward.shape) + backward
    return cv2.remap(image, source, None, cv2.INTER_LINEAR)  # type: ignore[call-overload,no-any-return]


def _moving(residual: Array) -> Array:
    """Apply Otsu's threshold, but not below the noise; few very fast pixels do not raise it."""
    top = float(np.quantile(residual, 0.995))
    if top <= LEAST_RESIDUAL_PX:
        return np.zeros(residual.shape, bool)
    quantised = np.rint(255 * np.minimum(residual / top, 1.0)).astype(np.uint8)
    threshold, _ = cv2.threshold(quantised, 0, 255, cv2.THRESH_BINARY | cv2.THRESH_OTSU)
    return np.asarray(residual > max(threshold * top / 255, LEAST_RESIDUAL_PX))


def _cut_out(image: Array, moving: Array) -> Array:
    """Run GrabCut from a rough mask: certain well inside and well outside of it, undecided between."""
    kernel = np.ones((9, 9), np.uint8)
    inside = cv2.erode(moving.astype(np.uint8), kernel).astype(bool)
    near = cv2.dilate(moving.astype(np.uint8), kernel).astype(bool)
    if not inside.any() or near.all():
        return moving
    state = np.where(near, np.where(moving, cv2.GC_PR_FGD, cv2.GC_PR_BGD), cv2.GC_BGD).astype(np.uint8)
    state[inside] = cv2.GC_FGD
    cv2.grabCut(image, state, None, np.zeros((1, 65)), np.zeros((1, 65)), 1, cv2.GC_INIT_WITH_MASK)  # type: ignore[call-overload]
    return np.asarray((state == cv2.GC_FGD) | (state == cv2.GC_PR_FGD))


def _corner_homography(gray: Array, last: Array) -> Array:
    """Estimate the homography from this frame to the last; the identity if too few corners are tracked."""
    points = cv2.goodFeaturesToTrack(gray, 400, 0.01, 10)
    if points is None:
        return np.eye(3)
    moved, found, _ = cv2.calcOpticalFlowPyrLK(gray, last, points, None)  # type: ignore[call-overload]
    kept = found.ravel() == 1
    if np.count_nonzero(kept) < 8:
        return np.eye(3)
    matrix, _ = cv2.findHomography(points[kept], moved[kept], cv2.RANSAC, 2.0)
    return np.eye(3) if matrix is None else np.asarray(matrix)


def _without_specks(mask: Array) -> Array:
    _, pieces, boxes, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8))
    kept = boxes[:, cv2.CC_STAT_AREA] >= SPECK_SHARE * mask.size
    kept[0] = False
    return np.asarray(kept[pieces])
