"""The camera's own motion between two frames: a homography fitted to background trajectories.

The paper has no camera model. Here trajectories are compared by what the camera's motion leaves of
theirs, so that a roll or a zoom, whose motion differs from place to place, does not look like objects.
A homography does not explain parallax; that stays in the residuals and is the clustering's business.
"""

from __future__ import annotations

import cv2
import numpy as np

from mlbs_actors.messages import Array

__all__ = ["camera_difference", "camera_homography", "homography_motion"]

#: Reprojection error of an inlier, px.
INLIER_PX = 1.0
#: Bounds of what is taken for noise between two frames, grey levels. Where the median difference is larger,
#: the camera model fails or the scene is full of fine texture; a smooth object differs by less than that.
LEAST_NOISE, MOST_NOISE = 2.0, 3.5
#: Fewer points than this do not determine a homography that can be trusted; a translation is used.
LEAST_POINTS = 12


def camera_homography(positions: Array, motions: Array, scale: float) -> Array:
    """Fit the background's backward motion by RANSAC (seeded inside OpenCV) and least squares.

    Parameters
    ----------
    positions : (n, 2) float32
        Background trajectories in frame t, px.
    motions : (n, 2) float32
        Their backward motions, px.
    scale : float
        :func:`~mlbs_actors.config.length_scale` of the frame.

    Returns
    -------
    (3, 3) float64
        Takes homogeneous pixels of frame t to frame t−1; the median translation where the points do not
        determine more.
    """
    matrix = None
    if len(positions) >= LEAST_POINTS:
        found, _ = cv2.findHomography(
            positions.astype(np.float64),
            (positions + motions).astype(np.float64),
            cv2.RANSAC,
            INLIER_PX * scale,
        )
        matrix = found
    if matrix is None or not np.isfinite(matrix).all() or not 0.5 < np.linalg.det(matrix[:2, :2]) < 2.0:
        matrix = np.eye(3)
        if len(positions):
            matrix[:2, 2] = np.median(motions, axis=0)
    return np.asarray(matrix, np.float64)


def homography_motion(matrix: Array, positions: Array) -> Array:
    """Backward motion that a homography gives each point.

    Parameters
    ----------
    matrix : (3, 3) float64
    positions : (n, 2)
        px.

    Returns
    -------
    (n, 2) float32
        px.
    """
    mapped = positions.astype(np.float64) @ matrix[:, :2].T + matrix[:, 2]
    return np.asarray(mapped[:, :2] / mapped[:, 2:] - positions, np.float32)


def camera_difference(previous: Array, current: Array, matrix: Array, step: tuple[float, float]) -> Array:
    """How badly the camera's own motion explains the new frame, place by place.

    Parameters
    ----------
    previous, current : (h, w) uint8
        Grey frames t−1 and t, shrunk alike.
    matrix : (3, 3) float64
        :func:`camera_homography`, in full-size px.
    step : (float, float)
        Full-size px per shrunk px in x and y.

    Returns
    -------
    (h, w) float32
        Mean absolute difference over a 5×5 window between frame t and frame t−1 moved by the camera's
        motion, in units of the frame's noise, its median over the frame between ``LEAST_NOISE`` and
        ``MOST_NOISE`` grey levels; 0 where frame t−1 did not reach.
    """
    # Full-size pixel centres lie at (shrunk + ½)·step − ½.
    shrink = np.array(
        [[1 / step[0], 0, 0.5 / step[0] - 0.5], [0, 1 / step[1], 0.5 / step[1] - 0.5], [0, 0, 1]]
    )
    mapping = shrink @ matrix @ np.linalg.inv(shrink)
    size = (current.shape[1], current.shape[0])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    moved = cv2.warpPerspective(previous, mapping, size, flags=flags, borderMode=cv2.BORDER_CONSTANT)
    reached = cv2.warpPerspective(np.full_like(previous, 255), mapping, size, flags=flags)
    difference = cv2.absdiff(current, moved)
    difference[reached < 255] = 0
    windowed = cv2.blur(difference.astype(np.float32), (5, 5))
    noise = np.clip(np.median(windowed), LEAST_NOISE, MOST_NOISE)
    return np.asarray(windowed / np.float32(noise))
