"""Dense optical flow between successive frames, both ways, with its forward–backward check (§3).

Differs from the paper: the authors use LDOF (tens of seconds a frame); here it is dense inverse
search (:mod:`mlbs_actors.flow.inverse_search`) on the frame's cells (:mod:`mlbs_actors.cells`), a few
milliseconds a direction, and the same flow serves the tracks, the layers' motion likelihood and the camera
model.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from mlbs_actors.cells import mean_of_cells
from mlbs_actors.config import FlowConfig, TrajectoriesConfig
from mlbs_actors.flow.inverse_search import (
    FlowLevel,
    SearchEffort,
    coarsest_level,
    flow_levels,
    improve_flow,
    resized_flow,
)
from mlbs_actors.flow.patch_search import PATCH
from mlbs_actors.kernels.jit import compiled
from mlbs_actors.messages import Array, Region

__all__ = ["LEAST_CELLS", "DenseFlow", "dense_flow", "flow_gray", "reliable_at"]

#: A frame with fewer cells on a side has no flow: two patches.
LEAST_CELLS = 2 * PATCH


@dataclass(frozen=True, slots=True)
class DenseFlow:
    """Flow between frames t−1 and t, one vector for each cell of the frame.

    Attributes
    ----------
    forward : (h, w, 2) float32
        t−1 → t, px, of the cells of frame t−1.
    backward : (h, w, 2) float32
        t → t−1, px, of the cells of frame t.
    backward_reliable : (h, w) bool
        Backward flow that the forward flow confirms and that is not on a motion boundary.
    side : int
        Of a cell, px.
    thresholds : four float
        a, b, c and d of the checks |w+w'(x+w)|² < a(|w|²+|w'|²)+b and |∇u|²+|∇v|² ≤ c|w|²+d.
    """

    forward: Array
    backward: Array
    backward_reliable: Array
    side: int
    thresholds: tuple[float, float, float, float]

    def forward_reliable(self) -> Array:
        """Which forward flow the backward flow confirms and is not on a motion boundary, (h, w) bool."""
        return _reliable(self.forward, self.backward, self.side, self.thresholds)


def flow_gray(frame: Array, side: int) -> Array:
    """Return a (H, W, 3) uint8 BGR frame as the flow sees it: mean grey levels of its cells, (h, w) uint8."""
    return mean_of_cells(cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY), side)


def dense_flow(
    previous: Array,
    current: Array,
    side: int,
    config: FlowConfig,
    checks: TrajectoriesConfig,
    focus: Sequence[Region] | None = None,
) -> DenseFlow:
    """Estimate the flow between two frames, both ways, with the checks of Sundaram et al.

    Parameters
    ----------
    previous, current : (h, w) uint8
        From :func:`flow_gray`, at least ``LEAST_CELLS`` high and wide.
    side : int
        Of a cell, px.
    config : FlowConfig
    checks : TrajectoriesConfig
        Thresholds of the forward–backward and motion-boundary checks.
    focus : sequence of Region, optional
        Disjoint boxes, in cells, where the finest level is computed. By default it is everywhere,
        and with the settings of the first frames: what is not told apart there is not found for long.

    Returns
    -------
    DenseFlow
    """
    whole = [Region(0, 0, current.shape[1], current.shape[0])]
    if focus is None:
        effort = SearchEffort(
            config.first_search_iterations, config.first_refinement_iterations, config.first_patch_stride_px
        )
        focus = whole
    else:
        effort = SearchEffort(config.search_iterations, config.refinement_iterations, config.patch_stride_px)
    coarsest = coarsest_level(current.shape)
    finest = min(config.finest_scale, coarsest)
    before, now = flow_levels(previous, coarsest), flow_levels(current, coarsest)
    # Halves alone would not do: flow bleeds 10–20 px past an object's outline then.
    backward = np.zeros((2, *now[coarsest].gray.shape), np.float32)
    backward = _finer(now, before, backward, range(coarsest, finest, -1), whole, effort)
    backward = _finer(now, before, backward, [finest], focus, effort)
    if list(focus) == whole:
        turned, first = -resized_flow(backward, now[coarsest].gray.shape), coarsest
    else:
        # Outside the boxes the scene moves as the camera does: there it is enough to turn the flow around.
        turned, first = _inverted(backward), min(finest + 1, coarsest)
    forward = _finer(before, now, turned, range(first, finest - 1, -1), focus, effort)
    forward, backward = (_in_px(resized_flow(one, current.shape), side) for one in (forward, backward))
    thresholds = (
        checks.consistency_relative,
        checks.consistency_px2,
        checks.boundary_relative,
        checks.boundary_absolute,
    )
    return DenseFlow(forward, backward, _reliable(backward, forward, side, thresholds), side, thresholds)


def _finer(
    source: Sequence[FlowLevel],
    target: Sequence[FlowLevel],
    flow: Array,
    levels: Iterable[int],
    boxes: Sequence[Region],
    effort: SearchEffort,
) -> Array:
    """Carry a flow (2, h, w), which may be overwritten, through levels; improve it in boxes of level 0."""
    for level in levels:
        shape = source[level].gray.shape
        flow = resized_flow(flow, shape)
        parts = [_on_level(box, level, shape) for box in boxes]
        improve_flow(source[level], target[level], flow, parts, effort)
    return flow


def _on_level(box: Region, level: int, shape: tuple[int, int]) -> Region:
    """The pixels of a level that a box of level 0 covers; at least a patch."""
    places = []
    for start, length, all_ in ((box.x, box.width, shape[1]), (box.y, box.height, shape[0])):
        end = min(max(-(-(start + length) >> level), (start >> level) + PATCH), all_)
        places.append((min(start >> level, end - PATCH), end))
    (left, right), (top, bottom) = places
    return Region(left, top, right - left, bottom - top)


@compiled
def _in_px(flow: Array, side: int) -> Array:
    """Flow planes (2, h, w) in cells as (h, w, 2) in px."""
    _, height, width = flow.shape
    scaled = np.empty((height, width, 2), np.float32)
    for y in range(height):
        for x in range(width):
            scaled[y, x, 0] = np.float32(side) * flow[0, y, x]
            scaled[y, x, 1] = np.float32(side) * flow[1, y, x]
    return scaled


@compiled
def _inverted(flow: Array) -> Array:
    """The flow the other way, planes (2, h, w): u with u(x) = −flow(x + u(x)), to a pixel in two rounds."""
    _, height, width = flow.shape
    inverse, place = np.empty_like(flow), np.empty(width, np.int32)
    right, bottom, zero = np.float32(width - 1), np.float32(height - 1), np.float32(0)
    along, down = flow[0].reshape(-1), flow[1].reshape(-1)
    for y in range(height):
        u, v = inverse[0, y], inverse[1, y]
        for x in range(width):
            u[x], v[x] = -flow[0, y, x], -flow[1, y, x]
        for _ in range(2):
            for x in range(width):  # in vector registers
                there_x = np.int32(min(max(np.rint(np.float32(np.int32(x)) + u[x]), zero), right))
                there_y = np.int32(min(max(np.rint(np.float32(np.int32(y)) + v[x]), zero), bottom))
                place[x] = np.int32(there_y * np.int32(width)) + there_x
            for x in range(width):
                there = np.uint64(np.uint32(place[x]))
                u[x], v[x] = -along[there], -down[there]
    return inverse


@compiled
def _reliable(flow: Array, reverse: Array, side: int, checks: tuple[float, ...]) -> Array:
    """The checks of `DenseFlow.thresholds`, inside the frame."""
    height, width = flow.shape[:2]
    reliable = np.zeros((height, width), np.bool_)
    per_px, shrink = np.float32(1.0 / (32 * side)), np.float32(1.0 / side)
    smoothed, sheared = np.empty(2 * width, np.float32), np.empty(2 * width, np.float32)
    slope = np.empty(2 * width, np.float32)
    along, across = np.empty(width, np.float32), np.empty(width, np.float32)
    inside, near = np.empty(width, np.bool_), np.empty(width, np.int32)
    back, rows = reverse.reshape(-1), flow.reshape(height, -1)
    limits = (np.float32(checks[0]), np.float32(checks[1]), np.float32(checks[2]), np.float32(checks[3]))
    one = np.uint64(1)
    for y in range(height):
        # Loops without a branch run in vector registers, over both components side by side.
        upper, middle, lower = rows[max(y - 1, 0)], rows[y], rows[min(y + 1, height - 1)]
        for k in range(2 * width):
            smoothed[k], sheared[k] = _across(upper[k], middle[k], lower[k])
        for k in range(2, 2 * width - 2):
            slope[k] = _slope(
                smoothed[k - 2], smoothed[k + 2], sheared[k - 2], sheared[k], sheared[k + 2], per_px
            )
        for k in (0, 1, 2 * width - 2, 2 * width - 1):
            before, after = max(k - 2, k & 1), min(k + 2, 2 * width - 2 + (k & 1))
            slope[k] = _slope(
                smoothed[before], smoothed[after], sheared[before], sheared[k], sheared[after], per_px
            )
        for x in range(width):
            at = np.uint64(2 * x)
            inside[x], near[x], along[x], across[x] = _there(
                middle[at], middle[at + one], x, y, width, height, shrink
            )
        for x in range(width):  # the only one that cannot
            along[x], across[x] = _back(back, near[x], width, along[x], across[x])
        found = reliable[y]
        for x in range(width):
            at = np.uint64(2 * x)
            steepness = slope[at] + slope[at + one]
            confirmed = _confirmed(middle[at], middle[at + one], along[x], across[x], steepness, limits)
            found[x] = confirmed & inside[x]
    return reliable


@compiled
def reliable_at(
    flow: Array, reverse: Array, side: int, checks: tuple[float, ...], xs: Array, ys: Array
) -> Array:
    """The same at columns and rows (n,) int64 of the grid: trajectories are at a few in a hundred."""
    height, width = flow.shape[:2]
    reliable = np.zeros(xs.size, np.bool_)
    per_px, shrink = np.float32(1.0 / (32 * side)), np.float32(1.0 / side)
    back = reverse.reshape(-1)
    limits = (np.float32(checks[0]), np.float32(checks[1]), np.float32(checks[2]), np.float32(checks[3]))
    for point in range(xs.size):
        x, y = xs[point], ys[point]
        before, after = max(x - 1, 0), min(x + 1, width - 1)
        upper, middle, lower = flow[max(y - 1, 0)], flow[y], flow[min(y + 1, height - 1)]
        gradient = np.float32(0)
        for axis in range(2):
            left, sheared_left = _across(upper[before, axis], middle[before, axis], lower[before, axis])
            _, sheared = _across(upper[x, axis], middle[x, axis], lower[x, axis])
            right, sheared_right = _across(upper[after, axis], middle[after, axis], lower[after, axis])
            gradient += _slope(left, right, sheared_left, sheared, sheared_right, per_px)
        u, v = flow[y, x, 0], flow[y, x, 1]
        inside, near, along, across = _there(u, v, x, y, width, height, shrink)
        back_u, back_v = _back(back, near, width, along, across)
        reliable[point] = inside & _confirmed(u, v, back_u, back_v, gradient, limits)
    return reliable


@compiled
def _across(upper: np.float32, middle: np.float32, lower: np.float32) -> tuple[np.float32, np.float32]:
    """Scharr's smoothing and difference over three rows."""
    return np.float32(3) * (upper + lower) + np.float32(10) * middle, lower - upper


@compiled
def _slope(
    left: np.float32, right: np.float32, sheared_left: np.float32, sheared: np.float32,
    sheared_right: np.float32, per_px: np.float32,
) -> np.float32:  # fmt: skip
    """Squared gradient of one component by Scharr's central differences, per px."""
    along = per_px * (right - left)
    down = per_px * (np.float32(3) * (sheared_left + sheared_right) + np.float32(10) * sheared)
    return along * along + down * down


@compiled
def _there(
    u: np.float32, v: np.float32, x: int, y: int, width: int, height: int, shrink: np.float32,
) -> tuple[bool, np.int32, np.float32, np.float32]:  # fmt: skip
    """Whether flow leads to a place inside; the pixel above and left of it, and the way from that, px."""
    zero, right, bottom = np.float32(0), np.float32(width - 1), np.float32(height - 1)
    there_x = np.float32(np.int32(x)) + u * shrink
    there_y = np.float32(np.int32(y)) + v * shrink
    inside = (there_x >= zero) & (there_x <= right) & (there_y >= zero) & (there_y <= bottom)
    there_x, there_y = min(max(there_x, zero), right), min(max(there_y, zero), bottom)
    column, row = min(np.int32(there_x), np.int32(width - 2)), min(np.int32(there_y), np.int32(height - 2))
    near = np.int32(row * np.int32(width) + column)
    return bool(inside), near, there_x - np.float32(column), there_y - np.float32(row)


@compiled
def _back(
    back: Array, near: np.int32, width: int, along: np.float32, across: np.float32
) -> tuple[np.float32, np.float32]:
    """Flow at a place of :func:`_there`, from a flat one."""
    one, aside = np.float32(1), np.uint64(2)
    u, below = np.uint64(np.uint32(np.int32(2) * near)), np.uint64(2 * width)
    v = u + np.uint64(1)
    w00, w01 = (one - across) * (one - along), (one - across) * along
    w10, w11 = across * (one - along), across * along
    back_u = w00 * back[u] + w01 * back[u + aside]
    back_u += w10 * back[u + below] + w11 * back[u + below + aside]
    back_v = w00 * back[v] + w01 * back[v + aside]
    back_v += w10 * back[v + below] + w11 * back[v + below + aside]
    return back_u, back_v


@compiled
def _confirmed(
    u: np.float32, v: np.float32, back_u: np.float32, back_v: np.float32, gradient: np.float32,
    limits: tuple[np.float32, ...],
) -> bool:  # fmt: skip
    squared = u * u + v * v
    error = (u + back_u) * (u + back_u) + (v + back_v) * (v + back_v)
    agrees = error < limits[0] * (squared + back_u * back_u + back_v * back_v) + limits[1]
    return bool(agrees & (gradient <= limits[2] * squared + limits[3]))
