"""The camera's own motion between two frames: a homography fitted to background trajectories.

The paper has no camera model. Here trajectories are compared by their residuals against the camera's motion,
so that a roll or a zoom, whose motion differs from place to place, does not look like objects. A homography
does not explain parallax. Where a camera drives through a scene, :mod:`mlbs_actors.tracking.epipolar` does;
elsewhere parallax stays in the residuals for the clustering to judge.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from mlbs_actors.config import TrajectoriesConfig
from mlbs_actors.geometry.homography import homography_motion, homography_of_cells
from mlbs_actors.kernels.jit import compiled
from mlbs_actors.messages import Array

__all__ = [
    "CameraEvidence",
    "camera_evidence",
    "camera_homography",
    "explained_share",
]


def camera_homography(positions: Array, motions: Array, scale: float, config: TrajectoriesConfig) -> Array:
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
    if len(positions) >= config.camera_tracks:
        inlier = config.camera_inlier_px * scale
        matrix, _ = cv2.findHomography(positions, positions + motions, cv2.RANSAC, inlier)
    if matrix is None or not np.isfinite(matrix).all() or not 0.5 < _enlargement(matrix) < 2.0:
        matrix = np.eye(3)
        if len(positions):
            matrix[:2, 2] = np.median(motions, axis=0)
    return np.asarray(matrix, np.float64)


def _enlargement(matrix: Array) -> float:
    """Return the factor by which a homography (3, 3) enlarges areas, its perspective aside."""
    (xx, xy, _), (yx, yy, _), _ = matrix.tolist()
    return float(xx * yy - xy * yx)


def explained_share(
    homography: Array, positions: Array, motions: Array, scale: float, config: TrajectoriesConfig
) -> float:
    """Return the share of some backward motions that a homography explains.

    Parameters
    ----------
    homography : (3, 3) float64
    positions, motions : (n, 2) float32
        px; without any, 0.
    scale : float
        :func:`~mlbs_actors.config.length_scale` of the frame.
    """
    error = np.hypot(*(motions - homography_motion(homography, positions)).T)
    return float((error < config.camera_inlier_px * scale).sum() / max(len(positions), 1))


@dataclass(frozen=True, slots=True)
class CameraEvidence:
    """How well the camera's own motion explains a new frame, place by place, in units of the frame's noise.

    Attributes
    ----------
    unexplained : (h, w) float32
        Mean absolute difference over a 5×5 window between frame t and frame t−1 moved by the camera's motion.
    advantage : (h, w) float32
        By how much the dense flow explains frame t better than the camera's motion does. Near 0 where the
        image is smooth, whatever moves there: flow that has bled over smooth ground explains it no better.
    difference : (h, w) uint8
        Absolute difference between frame t and frame t−1 moved by the camera's motion, grey levels.
    """

    unexplained: Array
    advantage: Array
    difference: Array


def camera_evidence(
    previous: Array,
    current: Array,
    matrix: Array,
    flow: Array,
    side: int,
    config: TrajectoriesConfig,
    rows: Array | None = None,
) -> CameraEvidence:
    """Compare the frame before, moved by the camera's motion and by the dense flow, with the new frame.

    Parameters
    ----------
    previous, current : (h, w) uint8
        Frames t−1 and t as the flow sees them.
    matrix : (3, 3) float64
        :func:`camera_homography`, px.
    flow : (h, w, 2) float32
        Backward flow t → t−1, px.
    side : int
        Of a cell, px.
    rows : (h, 2) float32, optional
        Backward motion of each row of cells beside the homography's, px.

    Returns
    -------
    CameraEvidence
        The noise is the median difference to the camera's motion, within bounds: where that is larger, the
        camera model fails or the scene is full of fine texture; a smooth object differs by less. All are 0
        where the camera's motion leads out of frame t−1.
    """
    mapping = homography_of_cells(matrix, side)
    height, width = current.shape
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    if rows is None:
        by_camera = cv2.warpPerspective(previous, mapping, (width, height), flags=flags)
    else:
        by_camera = _moved_in_rows(previous, mapping, rows / np.float32(side))
    by_flow = _taken_from(previous, _flow_sources(flow, np.float32(side)))
    differences = _differences(current, by_camera, by_flow, mapping)
    camera_error, flow_error = (cv2.boxFilter(one, cv2.CV_32F, (5, 5)) for one in differences)
    noise = np.float32(min(max(_median_error(camera_error), config.least_noise), config.most_noise))
    return CameraEvidence(*_in_noise(camera_error, flow_error, noise), differences[0])


def _moved_in_rows(previous: Array, mapping: Array, rows: Array) -> Array:
    """Return frame t−1 moved by a homography and then row by row (h, 2), cells."""
    height, width = previous.shape
    cells = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1).astype(np.float32)
    return _taken_from(previous, cv2.perspectiveTransform(cells, mapping) + rows[:, None])


def _taken_from(previous: Array, sources: Array) -> Array:
    """Return frame t−1 as it is at some places, (h, w, 2) float32, cells."""
    # One map of both coordinates, which the stubs do not know.
    taken = cv2.remap(  # type: ignore[call-overload]
        previous, sources, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    return np.asarray(taken)


@compiled
def _flow_sources(flow: Array, side: np.float32) -> Array:
    """Compute x and y of where each pixel comes from, (h, w, 2) float32, cells."""
    height, width = flow.shape[:2]
    sources, one = np.empty((height, width, 2), np.float32), np.uint64(1)
    for y in range(height):
        moved, place = flow[y].reshape(-1), sources[y].reshape(-1)  # flat, so that it is vectorised
        for x in range(width):
            at = np.uint64(2 * x)
            place[at] = np.float32(np.int32(x)) + moved[at] / side
            place[at + one] = np.float32(np.int32(y)) + moved[at + one] / side
    return sources


@compiled
def _median_error(error: Array) -> float:
    """Estimate the median from every fourth pixel; means over 25 integers are counted by value."""
    counts, values = np.zeros(25 * 255 + 1, np.int32), np.zeros(25 * 255 + 1, np.float32)
    total = 0
    for y in range(0, error.shape[0], 2):
        for x in range(0, error.shape[1], 2):
            place = int(np.rint(np.float32(25) * error[y, x]))
            counts[place] += 1
            values[place] = error[y, x]
            total += 1
    below, lower = 0, -1
    for place in range(counts.size):
        below += counts[place]
        if lower < 0 and below > (total - 1) // 2:
            lower = place
        if below > total // 2:
            return float(np.float32(0.5) * (values[lower] + values[place]))
    return 0.0


@compiled
def _in_noise(camera_error: Array, flow_error: Array, noise: np.float32) -> tuple[Array, Array]:
    """Return the camera's error and the flow's advantage over it, × noise."""
    unexplained, advantage = np.empty_like(camera_error), np.empty_like(camera_error)
    for y in range(camera_error.shape[0]):
        for x in range(camera_error.shape[1]):
            unexplained[y, x] = camera_error[y, x] / noise
            advantage[y, x] = (camera_error[y, x] - flow_error[y, x]) / noise
    return unexplained, advantage


@compiled
def _differences(current: Array, one: Array, other: Array, mapping: Array) -> Array:
    """Return absolute differences of a grey frame to two others, (2, h, w) uint8; 0 where it maps outside."""
    height, width = current.shape
    differences = np.zeros((2, height, width), np.uint8)
    for y in range(height):
        # In the row: where x, y and the remaining width and height of the source are not negative.
        left, right = 0.0, width - 1.0
        for axis, length in ((0, width - 1.0), (1, height - 1.0)):
            slope, start = mapping[axis, 0], mapping[axis, 1] * y + mapping[axis, 2]
            below = length * mapping[2, 0] - slope
            end = length * (mapping[2, 1] * y + mapping[2, 2]) - start
            for rise, value in ((slope, start), (below, end)):
                if rise > 0:
                    left = max(left, -value / rise)
                elif rise < 0:
                    right = min(right, -value / rise)
                elif value < 0:
                    right = -1.0
        inside = slice(int(np.ceil(min(left, float(width)))), max(int(np.floor(right)) + 1, 0))
        shown, by_one, by_other = current[y, inside], one[y, inside], other[y, inside]
        to_one, to_other = differences[0, y, inside], differences[1, y, inside]
        for x in range(shown.size):
            gray = np.int16(shown[x])
            to_one[x] = abs(np.int16(gray - np.int16(by_one[x])))
            to_other[x] = abs(np.int16(gray - np.int16(by_other[x])))
    return differences
