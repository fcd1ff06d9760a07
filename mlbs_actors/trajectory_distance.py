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
    free = np.full((cells.height, cells.width), 255, np.uint8)
    if layers:
        positions = [evidence.positions for evidence in layers]
        _mark(np.concatenate(positions), side, cells.x, cells.y, free)
    if free.size == 0 or free.all():
        return np.full(free.shape, np.inf, np.float32)
    return np.asarray(np.float32(side) * cv2.distanceTransform(free, cv2.DIST_L2, 5))


@compiled()
def _mark(positions: Array, side: int, left: int, top: int, free: Array) -> None:
    """Set the cells to 0 in which some positions lie."""
    height, width = free.shape
    for point in range(positions.shape[0]):
        x, y = np.rint(positions[point, 0]) - side * left, np.rint(positions[point, 1]) - side * top
        if 0 <= x < side * width and 0 <= y < side * height:
            free[int(y) // side, int(x) // side] = 0


def closed_distance(distance: Array, radius: float, side: int) -> Array:
    """Distance to the morphological closing of a set, from the distance to the set itself.

    Parameters
    ----------
    distance : (h, w) float32
        Of cells, px.
    radius : float
        Gaps of up to twice this that are enclosed by the set belong to it, px.
    side : int
        Of a cell, px.

    Returns
    -------
    (h, w) float32
        px.
    """
    if distance.size == 0 or not np.isfinite(distance).all():
        return distance
    # Past the region's border the set is taken to go on: an object that leaves the frame stays whole.
    outside = cv2.distanceTransform((distance <= radius).astype(np.uint8), cv2.DIST_L2, 5)
    closed = outside > radius / side
    to_closed = cv2.distanceTransform((~closed).astype(np.uint8), cv2.DIST_L2, 5)
    return np.asarray(np.minimum(distance / np.float32(side), to_closed) * np.float32(side))
