"""Epipolar geometry: how a static scene of many depths moves when the camera drives into it.

The paper has no camera model. A homography (:mod:`mlbs_actors.tracking.camera`) fails when a vehicle drives
down a street: each house, parked car and road marking moves in its own way, all are discontinuous at their
borders, and all would be objects. One epipolar geometry explains them, with a depth for each point. It also
explains much that moves: a car that comes towards the camera looks like something nearer. So it is used only
where nothing else works (:func:`forward_motion`); what it cannot distinguish from the scene is background.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from mlbs_actors.config import TrajectoriesConfig, length_scale
from mlbs_actors.messages import Array
from mlbs_actors.tracking.camera import explained_share

__all__ = ["EpipolarGeometry", "forward_motion", "static_motion"]

#: Confidence that the best geometry was found, and most samples drawn for it.
CONFIDENCE, MOST_SAMPLES = 0.999, 2000


@dataclass(frozen=True, slots=True)
class EpipolarGeometry:
    """Where points of a static scene can come from while the camera drives into it.

    Attributes
    ----------
    fundamental : (3, 3) float64
        Takes homogeneous pixels of frame t to their epipolar lines in frame t−1.
    epipole, epipole_before : (2,) float64
        The point that the camera drives towards, in frames t and t−1, px.
    """

    fundamental: Array
    epipole: Array
    epipole_before: Array


def forward_motion(
    positions: Array, motions: Array, homography: Array, shape: tuple[int, int], config: TrajectoriesConfig
) -> EpipolarGeometry | None:
    """Estimate the epipolar geometry of a camera that drives forwards through a scene of many depths.

    Three signs together identify it: the homography fails for a great part of the frame, static points in one
    epipolar geometry explain it, and the epipole is in the frame. A camera that pans or moves sideways has it
    far outside, and there anything that moves along with the parallax would look static.

    Parameters
    ----------
    positions, motions : (n, 2) float32
        Trajectories spread evenly over the frame, and their backward motions, px.
    homography : (3, 3) float64
        :func:`camera_homography`.
    shape : (H, W)
        px.

    Returns
    -------
    EpipolarGeometry or None
        None if the camera does not drive.
    """
    if len(positions) < 2 * config.camera_tracks:
        return None
    scale = length_scale(*shape)
    if explained_share(homography, positions, motions, scale, config) > config.most_planar:
        return None
    inlier = config.camera_inlier_px * scale
    points = positions.astype(np.float64)
    try:
        matrix, inliers = cv2.findFundamentalMat(
            points, points + motions, cv2.USAC_MAGSAC, inlier, CONFIDENCE, MOST_SAMPLES
        )
    except cv2.error:  # with few points in random motion OpenCV may find no matrix, and fail on that
        return None
    if matrix is None or matrix.shape != (3, 3) or inliers.mean() < config.least_epipolar:
        return None
    before, _, after = np.linalg.svd(matrix)
    with np.errstate(divide="ignore", invalid="ignore"):
        epipoles = [after[2, :2] / after[2, 2], before[:2, 2] / before[2, 2]]
    if not all((one >= 0).all() and (one < shape[::-1]).all() for one in epipoles):
        return None
    geometry = EpipolarGeometry(matrix, *epipoles)
    # A camera that drives backwards has the same epipolar lines, but its points come from farther out.
    error = np.hypot(*(motions - static_motion(geometry, positions, motions)).T)
    return geometry if (error < inlier).mean() >= config.least_static else None


def static_motion(geometry: EpipolarGeometry, positions: Array, motions: Array) -> Array:
    """Return the motion of a static point, at any depth, that is nearest to each motion observed.

    A far point moves with the camera's rotation alone, which carries the epipole along; the nearer it is, the
    closer to the epipole it was before. An object that the camera drives away from does neither.

    Parameters
    ----------
    geometry : EpipolarGeometry
    positions, motions : (n, 2) float32
        Points of frame t and their backward motions, px.

    Returns
    -------
    (n, 2) float32
        px.
    """
    points = positions.astype(np.float64)
    lines = np.column_stack([points, np.ones(len(points))]) @ geometry.fundamental.T
    normals = lines[:, :2] / np.maximum(np.hypot(lines[:, 0], lines[:, 1]), 1e-12)[:, None]

    def on_line(there: Array) -> Array:
        away = (normals * (there - geometry.epipole_before)).sum(axis=1)
        return np.asarray(there - away[:, None] * normals)

    farthest = on_line(points + geometry.epipole_before - geometry.epipole)
    seen = on_line(points + motions)
    towards = geometry.epipole_before - farthest
    depth = ((seen - farthest) * towards).sum(axis=1) / np.maximum(np.square(towards).sum(axis=1), 1e-12)
    return np.asarray(farthest + np.clip(depth, 0.0, 1.0)[:, None] * towards - points, np.float32)
