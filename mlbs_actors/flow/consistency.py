"""Dense flow of a frame in both directions, and where the two confirm each other (§3).

The checks are those of Sundaram, Brox and Keutzer (ECCV 2010), which the paper's trajectories use.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mlbs_actors.config import TrajectoriesConfig
from mlbs_actors.kernels.jit import compiled, inlined
from mlbs_actors.messages import Array

__all__ = ["DenseFlow", "checked_flow", "reliable_at"]


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
        """Forward flow that the backward flow confirms and that is not on a motion boundary, (h, w) bool."""
        return _reliable(self.forward, self.backward, self.side, self.thresholds)


def checked_flow(forward: Array, backward: Array, side: int, checks: TrajectoriesConfig) -> DenseFlow:
    """Check the flow of each direction against the other one.

    Parameters
    ----------
    forward, backward : (h, w, 2) float32
        As of :class:`DenseFlow`.
    side : int
        Of a cell, px.
    checks : TrajectoriesConfig

    Returns
    -------
    DenseFlow
    """
    thresholds = (
        checks.consistency_relative,
        checks.consistency_px2,
        checks.boundary_relative,
        checks.boundary_absolute,
    )
    return DenseFlow(forward, backward, _reliable(backward, forward, side, thresholds), side, thresholds)


@compiled
def _reliable(flow: Array, reverse: Array, side: int, checks: tuple[float, ...]) -> Array:
    """Apply the checks of `DenseFlow.thresholds`, inside the frame."""
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
        # Loops without a branch are vectorised, over both components side by side.
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
        for x in range(width):  # a gather: not vectorised
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
    """Evaluate :func:`_reliable` only at columns and rows (n,) int64: trajectories cover a few per cent."""
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


@inlined
def _across(upper: np.float32, middle: np.float32, lower: np.float32) -> tuple[np.float32, np.float32]:
    """Smooth and difference three rows by Scharr's weights."""
    return np.float32(3) * (upper + lower) + np.float32(10) * middle, lower - upper


@inlined
def _slope(
    left: np.float32, right: np.float32, sheared_left: np.float32, sheared: np.float32,
    sheared_right: np.float32, per_px: np.float32,
) -> np.float32:  # fmt: skip
    """Return the squared gradient of one component by Scharr's central differences, per px."""
    along = per_px * (right - left)
    down = per_px * (np.float32(3) * (sheared_left + sheared_right) + np.float32(10) * sheared)
    return along * along + down * down


@inlined
def _there(
    u: np.float32, v: np.float32, x: int, y: int, width: int, height: int, shrink: np.float32,
) -> tuple[bool, np.int32, np.float32, np.float32]:  # fmt: skip
    """Say whether flow ends inside; return the pixel above and left of its end, and the fractions beyond."""
    zero, right, bottom = np.float32(0), np.float32(width - 1), np.float32(height - 1)
    there_x = np.float32(np.int32(x)) + u * shrink
    there_y = np.float32(np.int32(y)) + v * shrink
    inside = (there_x >= zero) & (there_x <= right) & (there_y >= zero) & (there_y <= bottom)
    there_x, there_y = min(max(there_x, zero), right), min(max(there_y, zero), bottom)
    column, row = min(np.int32(there_x), np.int32(width - 2)), min(np.int32(there_y), np.int32(height - 2))
    near = np.int32(row * np.int32(width) + column)
    return bool(inside), near, there_x - np.float32(column), there_y - np.float32(row)


@inlined
def _back(
    back: Array, near: np.int32, width: int, along: np.float32, across: np.float32
) -> tuple[np.float32, np.float32]:
    """Interpolate a flattened flow at a place of :func:`_there`."""
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


@inlined
def _confirmed(
    u: np.float32, v: np.float32, back_u: np.float32, back_v: np.float32, gradient: np.float32,
    limits: tuple[np.float32, ...],
) -> bool:  # fmt: skip
    squared = u * u + v * v
    error = (u + back_u) * (u + back_u) + (v + back_v) * (v + back_v)
    agrees = error < limits[0] * (squared + back_u * back_u + back_v * back_v) + limits[1]
    return bool(agrees & (gradient <= limits[2] * squared + limits[3]))
