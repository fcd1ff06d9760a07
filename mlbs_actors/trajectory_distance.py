"""How far cells lie from the trajectories of some layers: an object is where its trajectories are."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from mlbs_actors.compilation import compiled
from mlbs_actors.messages import Array, LayerEvidence, Region

__all__ = ["closed_distance", "trajectory_distance"]


def trajectory_distance(layers: Sequence[LayerEvidence], cells: Region, side: int) -> Array:
    """Distance of cells to the nearest one that has a trajectory of some layers.

    Parameters
    ----------
    layers : sequence of LayerEvidence
    cells : Region
        In units of cells.
    side : int
        Of a cell, px.

    Returns
    -------
    (h, w) float32
        px; infinite everywhere if no trajectory lies in the region.
    """
    positions = [evidence.positions for evidence in layers if len(evidence.positions)]
    if positions:
        # Also of one: for Numba an array that can only be read is another type, with kernels of its own.
        free, found = _free_cells(
            np.concatenate(positions), side, cells.x, cells.y, cells.width, cells.height
        )
        if found:
            return np.multiply(_distance(free), np.float32(side))
    return np.full((cells.height, cells.width), np.inf, np.float32)


@compiled()
def _free_cells(
    positions: Array, side: int, left: int, top: int, width: int, height: int
) -> tuple[Array, bool]:
    """0 for the cells in which some positions lie and 1 for the others, uint8; whether there is one."""
    free, found = np.ones((height, width), np.uint8), False
    for point in range(positions.shape[0]):
        x, y = np.rint(positions[point, 0]) - side * left, np.rint(positions[point, 1]) - side * top
        if 0 <= x < side * width and 0 <= y < side * height:
            free[int(y) // side, int(x) // side] = 0
            found = True
    return free, found


def _distance(free: Array) -> Array:
    """To the nearest 0, cells: (h, w) float32."""
    return cv2.distanceTransform(free, cv2.DIST_L2, 5)


def closed_distance(distance: Array, radius: float, side: int) -> Array:
    """Distance to the morphological closing of a set, from the distance to the set itself.

    Parameters
    ----------
    distance : (h, w) float32
        Of cells, px; infinite everywhere if the set is empty.
    radius : float
        Gaps of up to twice this that are enclosed by the set belong to it, px.
    side : int
        Of a cell, px.

    Returns
    -------
    (h, w) float32
        px.
    """
    if distance.size == 0 or distance[0, 0] == np.inf:
        return distance
    # Past the region's border the set is taken to go on: an object that leaves the frame stays whole.
    outside = _distance(_within(distance, np.float32(radius)))
    to_closed = _distance(_within(outside, np.float32(radius / side)))
    return np.minimum(distance, np.multiply(to_closed, np.float32(side), out=to_closed), out=to_closed)


@compiled()
def _within(distance: Array, radius: np.float32) -> Array:
    """1 where a distance is at most the radius, 0 elsewhere, uint8."""
    within = np.empty(distance.shape, np.uint8)
    for y in range(distance.shape[0]):
        for x in range(distance.shape[1]):
            within[y, x] = distance[y, x] <= radius
    return within
