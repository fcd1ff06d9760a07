"""The points in a box: a frame has thousands of trajectories, an object some tens of them.

A branch for each point would be mispredicted. So all are compared first, vectorised, and then skipped eight
at a time where none is inside.
"""

from __future__ import annotations

import numpy as np

from mlbs_actors.kernels.jit import compiled
from mlbs_actors.messages import Array

__all__ = ["points_in_box"]


@compiled
def points_in_box(positions: Array, left: float, top: float, right: float, bottom: float) -> Array:
    """Find the points that lie in a box when rounded to whole numbers.

    Parameters
    ----------
    positions : (n, 2) float32
        x and y; C-contiguous.
    left, top, right, bottom : float
        left ≤ x < right and top ≤ y < bottom.

    Returns
    -------
    (m,) int32
        Ascending.
    """
    count = positions.shape[0]
    inside = np.zeros(-(-count // 8) * 8, np.bool_)
    _compare(positions, np.float32(left), np.float32(top), np.float32(right), np.float32(bottom), inside)
    found, size = np.empty(inside.size + 1, np.int32), 0
    eights = inside.view(np.uint64)
    for eight in range(eights.size):
        if eights[eight] == 0:
            continue
        for point in range(8 * eight, 8 * eight + 8):
            found[size] = point  # kept if it counts
            size += int(inside[point])
    return found[:size]


@compiled
def _compare(
    positions: Array, left: np.float32, top: np.float32, right: np.float32, bottom: np.float32, inside: Array
) -> None:
    flat = positions.reshape(-1)
    for point in range(positions.shape[0]):
        x, y = np.rint(flat[np.uint64(2 * point)]), np.rint(flat[np.uint64(2 * point + 1)])
        inside[np.uint64(point)] = (x >= left) & (x < right) & (y >= top) & (y < bottom)
