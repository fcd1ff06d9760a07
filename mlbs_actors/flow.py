"""Dense optical flow between successive frames, both ways, with its forward–backward check (§3).

Differs from the paper: the authors use LDOF (tens of seconds a frame); here it is OpenCV's DIS on the
shrunk frame, a few milliseconds a direction, and the same flow serves the tracks, the layers' motion
likelihood and the camera model.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numba import njit

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
    thresholds = (
        checks.consistency_relative,
        checks.consistency_px2,
        checks.boundary_relative,
        checks.boundary_absolute,
    )
    return DenseFlow(
        forward,
        backward,
        _reliable(forward, backward, *step, thresholds),
        _reliable(backward, forward, *step, thresholds),
        step,
    )


@njit(cache=True)
def _reliable(flow: Array, reverse: Array, step_x: float, step_y: float, checks: tuple[float, ...]) -> Array:
    """|w+w'(x+w)|² < a(|w|²+|w'|²)+b inside the frame, and |∇u|²+|∇v|² ≤ c|w|²+d, for checks (a, b, c, d)."""
    height, width = flow.shape[:2]
    relative, absolute, boundary_relative, boundary_absolute = checks
    reliable = np.zeros((height, width), np.bool_)
    for y in range(height):
        above, below = max(y - 1, 0), min(y + 1, height - 1)
        for x in range(width):
            u, v = flow[y, x, 0], flow[y, x, 1]
            there_x, there_y = x + u / step_x, y + v / step_y
            if not (0 <= there_x <= width - 1 and 0 <= there_y <= height - 1):
                continue
            squared = u * u + v * v
            column, row = int(there_x), int(there_y)
            right, down = min(column + 1, width - 1), min(row + 1, height - 1)
            along, across = there_x - column, there_y - row
            back_u = (1 - across) * (
                (1 - along) * reverse[row, column, 0] + along * reverse[row, right, 0]
            ) + across * ((1 - along) * reverse[down, column, 0] + along * reverse[down, right, 0])
            back_v = (1 - across) * (
                (1 - along) * reverse[row, column, 1] + along * reverse[row, right, 1]
            ) + across * ((1 - along) * reverse[down, column, 1] + along * reverse[down, right, 1])
            error = (u + back_u) ** 2 + (v + back_v) ** 2
            if error >= relative * (squared + back_u**2 + back_v**2) + absolute:
                continue
            before, after = max(x - 1, 0), min(x + 1, width - 1)
            gradient = 0.0
            for axis in range(2):
                # Scharr's central differences, per full-size px.
                horizontal = (
                    3 * (flow[above, after, axis] - flow[above, before, axis])
                    + 10 * (flow[y, after, axis] - flow[y, before, axis])
                    + 3 * (flow[below, after, axis] - flow[below, before, axis])
                ) / (32 * step_x)
                vertical = (
                    3 * (flow[below, before, axis] - flow[above, before, axis])
                    + 10 * (flow[below, x, axis] - flow[above, x, axis])
                    + 3 * (flow[below, after, axis] - flow[above, after, axis])
                ) / (32 * step_y)
                gradient += horizontal * horizontal + vertical * vertical
            reliable[y, x] = gradient <= boundary_relative * squared + boundary_absolute
    return reliable
