"""Dense optical flow between successive frames, both ways, with its forward–backward check (§3).

Differs from the paper: the authors use LDOF (tens of seconds a frame); here it is OpenCV's DIS on the
shrunk frame, a few milliseconds a direction, and the same flow serves the tracks, the layers' motion
likelihood and the camera model.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from mlbs_actors.config import FlowConfig, TrajectoriesConfig, length_scale
from mlbs_actors.messages import Array

__all__ = ["DenseFlow", "dense_flow", "flow_gray", "sample_flow"]


@dataclass(frozen=True, slots=True)
class DenseFlow:
    """Flow between frames t−1 and t on a grid coarser than the frame.

    Attributes
    ----------
    forward : (h, w, 2) float32
        t−1 → t, in full-size px, defined on the pixels of frame t−1.
    backward : (h, w, 2) float32
        t → t−1, in full-size px, defined on the pixels of frame t.
    forward_reliable : (h, w) bool
        Forward flow that the backward flow confirms and that is not on a motion boundary.
    backward_reliable : (h, w) bool
        The same for the backward flow.
    step : (float, float)
        Full-size px per grid step in x and y.
    """

    forward: Array
    backward: Array
    forward_reliable: Array
    backward_reliable: Array
    step: tuple[float, float]


def flow_gray(frame: Array, config: FlowConfig) -> Array:
    """Grey image, shrunk to the size on which flow is computed.

    Parameters
    ----------
    frame : (H, W, 3) uint8
        BGR.
    config : FlowConfig

    Returns
    -------
    (h, w) uint8
        At least 16 px a side, the least that DIS accepts.
    """
    gray = cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY)
    height, width = gray.shape
    scale = min(1.0, config.scale / length_scale(height, width))
    size = (max(16, round(width * scale)), max(16, round(height * scale)))
    return gray if size == (width, height) else cv2.resize(gray, size, interpolation=cv2.INTER_AREA)


def sample_flow(flow: Array, points: Array, step: tuple[float, float]) -> Array:
    """Bilinear flow vectors at full-size positions.

    Parameters
    ----------
    flow : (h, w, c) float32
    points : (n, 2) float32
        (x, y), full-size px.
    step : (float, float)
        Full-size px per grid step.

    Returns
    -------
    (n, c) float32
    """
    if len(points) == 0:
        return np.zeros((0, flow.shape[2]), np.float32)
    x = ((points[:, 0] + 0.5) / step[0] - 0.5).astype(np.float32)
    y = ((points[:, 1] + 0.5) / step[1] - 0.5).astype(np.float32)
    sampled = cv2.remap(flow, x[None, :], y[None, :], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return sampled.reshape(len(points), flow.shape[2])


def dense_flow(
    previous: Array, current: Array, shape: tuple[int, int], config: FlowConfig, checks: TrajectoriesConfig
) -> DenseFlow:
    """Flow between two shrunk grey frames, both ways, with the checks of Sundaram et al.

    Parameters
    ----------
    previous, current : (h, w) uint8
        From :func:`flow_gray`.
    shape : (int, int)
        (H, W) of the full frame.
    config : FlowConfig
    checks : TrajectoriesConfig
        Thresholds of the forward–backward and motion-boundary checks.

    Returns
    -------
    DenseFlow
    """
    step = (shape[1] / current.shape[1], shape[0] / current.shape[0])
    solver = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_FAST)
    # The presets stop at half the size they are given: flow bleeds 10–20 px past an object's outline then.
    solver.setFinestScale(config.finest_scale)
    solver.setGradientDescentIterations(config.search_iterations)
    solver.setVariationalRefinementIterations(config.refinement_iterations)
    factor = np.array(step, np.float32)
    # None, which the stubs do not know: no initial flow.
    forward = solver.calc(previous, current, None) * factor  # type: ignore[call-overload]
    backward = solver.calc(current, previous, None) * factor  # type: ignore[call-overload]
    return DenseFlow(
        forward,
        backward,
        _reliable(forward, backward, step, checks),
        _reliable(backward, forward, step, checks),
        step,
    )


def _reliable(flow: Array, reverse: Array, step: tuple[float, float], checks: TrajectoriesConfig) -> Array:
    """|w+w'(x+w)|² < a(|w|²+|w'|²)+b inside the frame, and |∇u|²+|∇v|² ≤ c|w|²+d."""
    height, width = flow.shape[:2]
    target_x = np.arange(width, dtype=np.float32)[None, :] + flow[..., 0] / np.float32(step[0])
    target_y = np.arange(height, dtype=np.float32)[:, None] + flow[..., 1] / np.float32(step[1])
    there = cv2.remap(reverse, target_x, target_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    inside = (target_x >= 0) & (target_x <= width - 1) & (target_y >= 0) & (target_y <= height - 1)
    squared = np.square(flow).sum(axis=2)
    error = np.square(flow + there).sum(axis=2)
    allowed = checks.consistency_relative * (squared + np.square(there).sum(axis=2)) + checks.consistency_px2
    # Central differences of the flow, per full-size px.
    gradient = np.zeros((height, width), np.float32)
    for axis in (0, 1):
        horizontal = cv2.Scharr(flow[..., axis], cv2.CV_32F, 1, 0, scale=1 / 32) / step[0]
        vertical = cv2.Scharr(flow[..., axis], cv2.CV_32F, 0, 1, scale=1 / 32) / step[1]
        gradient += np.square(horizontal) + np.square(vertical)
    smooth = gradient <= checks.boundary_relative * squared + checks.boundary_absolute
    return np.asarray(inside & (error < allowed) & smooth)
