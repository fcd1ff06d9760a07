"""Dense optical flow between successive frames, both ways, with its forward–backward check (§3).

Differs from the paper: the authors use LDOF (tens of seconds a frame); here it is OpenCV's DIS on the
shrunk frame, a few milliseconds a direction, and the same flow serves the tracks, the layers' motion
likelihood and the camera model.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numba import njit

from mlbs_actors.config import FlowConfig, TrajectoriesConfig, length_scale
from mlbs_actors.messages import Array, Region

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
    backward_reliable : (h, w) bool
        Backward flow that the forward flow confirms and that is not on a motion boundary.
    step : (float, float)
        Full-size px per grid step in x and y.
    thresholds : four float
        a, b, c and d of the checks |w+w'(x+w)|² < a(|w|²+|w'|²)+b and |∇u|²+|∇v|² ≤ c|w|²+d.
    """

    forward: Array
    backward: Array
    backward_reliable: Array
    step: tuple[float, float]
    thresholds: tuple[float, float, float, float]

    def forward_reliable(self) -> Array:
        """Which forward flow the backward flow confirms and is not on a motion boundary, (h, w) bool."""
        return _reliable(self.forward, self.backward, *self.step, self.thresholds)

    def forward_reliable_at(self, x: Array, y: Array) -> Array:
        """The same at some places of the grid, (n,) int64 each: (n,) bool."""
        return _reliable_at(self.forward, self.backward, *self.step, self.thresholds, x, y)


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
    previous: Array,
    current: Array,
    shape: tuple[int, int],
    config: FlowConfig,
    checks: TrajectoriesConfig,
    focus: Sequence[Region] | None = None,
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
    focus : sequence of Region, optional
        Disjoint boxes of the shrunk frame where the finest level is computed. By default it is everywhere,
        and with the settings of the first frames: what is not told apart there is not found for long.

    Returns
    -------
    DenseFlow
    """
    step = (shape[1] / current.shape[1], shape[0] / current.shape[0])
    first = focus is None
    if focus is None:
        focus = [Region(0, 0, current.shape[1], current.shape[0])]
    backward = _flow(_solver(config, first=first), current, previous, config.finest_scale, focus)
    # Outside the boxes the scene moves as the camera does: there it is enough to turn the flow around.
    start = None if _is_whole(focus, current) else _inverted(backward)
    forward = _flow(_solver(config, first=first), previous, current, config.finest_scale, focus, start)
    for flow in (forward, backward):
        for axis in range(2):  # each by itself: an operand of two numbers would be gone over pixel by pixel
            flow[..., axis] *= np.float32(step[axis])
    thresholds = (
        checks.consistency_relative,
        checks.consistency_px2,
        checks.boundary_relative,
        checks.boundary_absolute,
    )
    return DenseFlow(forward, backward, _reliable(backward, forward, *step, thresholds), step, thresholds)


def _solver(config: FlowConfig, *, first: bool) -> cv2.DISOpticalFlow:
    """One for a single direction: what it keeps between calls must not meet another size."""
    solver = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_FAST)
    if first:
        search, refinement = config.first_search_iterations, config.first_refinement_iterations
        stride = config.first_patch_stride_px
    else:
        search, refinement = config.search_iterations, config.refinement_iterations
        stride = config.patch_stride_px
    solver.setGradientDescentIterations(search)
    solver.setVariationalRefinementIterations(refinement)
    solver.setPatchStride(stride)
    return solver


def _flow(
    solver: cv2.DISOpticalFlow,
    source: Array,
    target: Array,
    finest: int,
    focus: Sequence[Region],
    start: Array | None = None,
) -> Array:
    """DIS from one grey frame to another, (h, w, 2) float32, px of theirs.

    In the boxes it begins a level above the finest if there is a flow to start from, which is kept elsewhere;
    else it begins with the coarsest, and stops a level above the finest elsewhere.
    """
    # The presets stop at half the size they are given: flow bleeds 10–20 px past an object's outline then.
    solver.setFinestScale(finest)
    if _is_whole(focus, source):
        # None, which the stubs do not know: no initial flow.
        return np.asarray(solver.calc(source, target, None))  # type: ignore[call-overload]
    if start is None:
        solver.setFinestScale(finest + 1)
        flow = np.asarray(solver.calc(source, target, None))  # type: ignore[call-overload]
        solver.setFinestScale(finest)
        solver.setCoarsestScale(finest)
    else:
        flow = start
        solver.setCoarsestScale(finest + 1)
    for box in focus:
        part = np.ascontiguousarray(flow[box.slices])
        cut_source, cut_target = (np.ascontiguousarray(frame[box.slices]) for frame in (source, target))
        flow[box.slices] = solver.calc(cut_source, cut_target, part)
    return flow


def _is_whole(focus: Sequence[Region], frame: Array) -> bool:
    """Whether the boxes are one, the frame."""
    return len(focus) == 1 and focus[0].area == frame.size


@njit(cache=True)
def _inverted(flow: Array) -> Array:
    """The flow the other way, (h, w, 2): u with u(x) = −flow(x + u(x)), to a pixel in two rounds."""
    height, width = flow.shape[:2]
    inverse = np.empty_like(flow)
    for y in range(height):
        for x in range(width):
            u, v = -flow[y, x, 0], -flow[y, x, 1]
            for _ in range(2):
                there_x = min(max(int(np.rint(x + u)), 0), width - 1)
                there_y = min(max(int(np.rint(y + v)), 0), height - 1)
                u, v = -flow[there_y, there_x, 0], -flow[there_y, there_x, 1]
            inverse[y, x, 0], inverse[y, x, 1] = u, v
    return inverse


@njit(cache=True)
def _reliable(flow: Array, reverse: Array, step_x: float, step_y: float, checks: tuple[float, ...]) -> Array:
    """The checks of `DenseFlow.thresholds`, inside the frame."""
    height, width = flow.shape[:2]
    reliable = np.zeros((height, width), np.bool_)
    by_x, by_y = np.float32(1.0 / (32 * step_x)), np.float32(1.0 / (32 * step_y))
    shrink_x, shrink_y = np.float32(1.0 / step_x), np.float32(1.0 / step_y)
    smoothed, sheared = np.empty((2, width), np.float32), np.empty((2, width), np.float32)
    steepness = np.empty(width, np.float32)
    there, back = flow.reshape(-1), reverse.reshape(-1)
    limits = (np.float32(checks[0]), np.float32(checks[1]), np.float32(checks[2]), np.float32(checks[3]))
    for y in range(height):
        # Loops without a branch run in vector registers.
        upper, middle, lower = flow[max(y - 1, 0)], flow[y], flow[min(y + 1, height - 1)]
        steepness[:] = 0
        for axis in range(2):
            for x in range(width):
                smoothed[axis, x], sheared[axis, x] = _across(upper, middle, lower, x, axis)
            for x in range(1, width - 1):
                steepness[x] += _slope(
                    smoothed[axis, x - 1], smoothed[axis, x + 1],
                    sheared[axis, x - 1], sheared[axis, x], sheared[axis, x + 1], by_x, by_y,
                )  # fmt: skip
            for x in (0, width - 1):
                before, after = max(x - 1, 0), min(x + 1, width - 1)
                steepness[x] += _slope(
                    smoothed[axis, before], smoothed[axis, after],
                    sheared[axis, before], sheared[axis, x], sheared[axis, after], by_x, by_y,
                )  # fmt: skip
        for x in range(width):
            reliable[y, x] = _agrees(
                there, back, x, y, width, height, steepness[x], shrink_x, shrink_y, limits
            )
    return reliable


@njit(cache=True)
def _reliable_at(
    flow: Array, reverse: Array, step_x: float, step_y: float, checks: tuple[float, ...], xs: Array, ys: Array
) -> Array:
    """The same at some places: trajectories are at a few in a hundred."""
    height, width = flow.shape[:2]
    reliable = np.zeros(xs.size, np.bool_)
    by_x, by_y = np.float32(1.0 / (32 * step_x)), np.float32(1.0 / (32 * step_y))
    shrink_x, shrink_y = np.float32(1.0 / step_x), np.float32(1.0 / step_y)
    there, back = flow.reshape(-1), reverse.reshape(-1)
    limits = (np.float32(checks[0]), np.float32(checks[1]), np.float32(checks[2]), np.float32(checks[3]))
    for point in range(xs.size):
        x, y = xs[point], ys[point]
        before, after = max(x - 1, 0), min(x + 1, width - 1)
        upper, middle, lower = flow[max(y - 1, 0)], flow[y], flow[min(y + 1, height - 1)]
        gradient = np.float32(0)
        for axis in range(2):
            left, sheared_left = _across(upper, middle, lower, before, axis)
            _, sheared = _across(upper, middle, lower, x, axis)
            right, sheared_right = _across(upper, middle, lower, after, axis)
            gradient += _slope(left, right, sheared_left, sheared, sheared_right, by_x, by_y)
        reliable[point] = _agrees(there, back, x, y, width, height, gradient, shrink_x, shrink_y, limits)
    return reliable


@njit(cache=True, inline="always")
def _across(upper: Array, middle: Array, lower: Array, x: int, axis: int) -> tuple[np.float32, np.float32]:
    """Scharr's smoothing and difference over three rows."""
    smoothed = np.float32(3) * (upper[x, axis] + lower[x, axis]) + np.float32(10) * middle[x, axis]
    return smoothed, lower[x, axis] - upper[x, axis]


@njit(cache=True, inline="always")
def _slope(
    left: np.float32, right: np.float32, sheared_left: np.float32, sheared: np.float32,
    sheared_right: np.float32, by_x: np.float32, by_y: np.float32,
) -> np.float32:  # fmt: skip
    """Squared gradient of one component by Scharr's central differences, per full-size px."""
    along = by_x * (right - left)
    down = by_y * (np.float32(3) * (sheared_left + sheared_right) + np.float32(10) * sheared)
    return along * along + down * down


@njit(cache=True, inline="always")
def _agrees(
    flow: Array, back: Array, x: int, y: int, width: int, height: int, gradient: np.float32,
    shrink_x: np.float32, shrink_y: np.float32, limits: tuple[np.float32, ...],
) -> bool:  # fmt: skip
    """The checks of one pixel; flows are flat, and indices narrow, so that many can be gathered at once."""
    zero, one = np.float32(0), np.float32(1)
    right, bottom = np.float32(width - 1), np.float32(height - 1)
    here = np.uint64(2 * (y * width + x))
    u, v = flow[here], flow[here + np.uint64(1)]
    there_x = np.float32(np.int32(x)) + u * shrink_x
    there_y = np.float32(np.int32(y)) + v * shrink_y
    inside = (there_x >= zero) & (there_x <= right) & (there_y >= zero) & (there_y <= bottom)
    there_x, there_y = min(max(there_x, zero), right), min(max(there_y, zero), bottom)
    column, row = min(np.int32(there_x), np.int32(width - 2)), min(np.int32(there_y), np.int32(height - 2))
    along, across = there_x - np.float32(column), there_y - np.float32(row)
    near = np.uint64(np.uint32(np.int32(2) * (row * np.int32(width) + column)))
    below, aside = near + np.uint64(2 * width), np.uint64(2)
    w00, w01 = (one - across) * (one - along), (one - across) * along
    w10, w11 = across * (one - along), across * along
    back_u = w00 * back[near] + w01 * back[near + aside]
    back_u += w10 * back[below] + w11 * back[below + aside]
    near, below = near + np.uint64(1), below + np.uint64(1)
    back_v = w00 * back[near] + w01 * back[near + aside]
    back_v += w10 * back[below] + w11 * back[below + aside]
    squared = u * u + v * v
    error = (u + back_u) * (u + back_u) + (v + back_v) * (v + back_v)
    agrees = error < limits[0] * (squared + back_u * back_u + back_v * back_v) + limits[1]
    return bool(inside & agrees & (gradient <= limits[2] * squared + limits[3]))
