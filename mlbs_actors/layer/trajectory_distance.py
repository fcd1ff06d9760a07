"""How far cells lie from the trajectories of some layers: an object is where its trajectories are.

Distances are made of steps to the next cell, across a corner and in a knight's move, of the lengths that cv2
gives them (Borgefors 1986), within 2 % of exact. cv2 takes as long for one; an object needs four of them that
hang on each other, which are one kernel here.
"""

from __future__ import annotations

import numpy as np

from mlbs_actors.kernels.jit import compiled, inlined
from mlbs_actors.kernels.simd import LANES, Lanes, broadcast, broadcast_lane, load, minimum, shifted, store
from mlbs_actors.layer.points_in_box import points_in_box
from mlbs_actors.messages import Array, Region

__all__ = ["closed_distance", "occupied_cells", "occupy", "to_occupied", "trajectory_distance"]

#: Lengths of the steps, cells.
_STRAIGHT, _DIAGONAL, _KNIGHT = np.float32(1), np.float32(1.4), np.float32(2.1969)
#: Infinite cells around all others, so that no step asks for the border.
_BORDER = 2
#: From the cell before those of a register to each of them, and from the one after them.
_STEPS = np.arange(1, LANES + 1).astype(np.float32)
_STEPS_BACK = _STEPS[::-1].copy()


def trajectory_distance(positions: Array, cells: Region, side: int) -> Array:
    """Distance of cells to the nearest one that has a trajectory.

    Parameters
    ----------
    positions : (n, 2) float32
        Of the trajectories, px.
    cells : Region
        In units of cells.
    side : int
        Of a cell, px.

    Returns
    -------
    (h, w) float32
        px; infinite everywhere if no trajectory lies in the region.
    """
    occupied = occupied_cells(positions, side, cells.x, cells.y, cells.width, cells.height)
    return np.asarray(to_occupied(occupied, side))


@compiled
def occupied_cells(positions: Array, side: int, left: int, top: int, width: int, height: int) -> Array:
    """In which cells of a region, in units of cells, some positions lie: (h, w) bool."""
    occupied = np.zeros((height, width), np.bool_)
    occupy(occupied, positions, side, left, top)
    return occupied


@compiled
def occupy(occupied: Array, positions: Array, side: int, left: int, top: int) -> None:
    """Add those of other positions to :func:`occupied_cells`."""
    x, y, height, width = side * left, side * top, side * occupied.shape[0], side * occupied.shape[1]
    for point in points_in_box(positions, x, y, x + width, y + height):
        column = (np.int64(np.rint(positions[point, 0])) - x) // side
        row = (np.int64(np.rint(positions[point, 1])) - y) // side
        occupied[row, column] = True


@compiled
def to_occupied(occupied: Array, side: int) -> Array:
    """Distance of cells of this side to the nearest of some: (h, w) float32, px; infinite without any."""
    height, width = occupied.shape
    room = -(-width // LANES) * LANES
    stride, told = room + 2 * _BORDER, np.empty(occupied.shape, np.float32)
    cells = np.full((height + 2 * _BORDER) * stride, np.float32(np.inf))
    # Cells past the right border, up to a whole register, are told too: no way is shorter by way of them.
    own, results, infinite = occupied.reshape(-1), told.reshape(-1), broadcast(np.float32(np.inf), LANES)
    for y in range(height):
        first = (y + _BORDER) * stride + _BORDER
        for x in range(width):
            free = np.float32(0) if own[np.uint64(y * width + x)] else np.float32(np.inf)
            cells[np.uint64(first + x)] = free
    for y in range(_BORDER, height + _BORDER):
        before = infinite
        for x in range(_BORDER, room + _BORDER, LANES):
            place = np.uint64(y * stride + x)
            before = _stepped_right(_stepped_from(cells, place, place - np.uint64(stride), -stride), before)
            store(cells, place, before)
    for y in range(height + _BORDER - 1, _BORDER - 1, -1):
        after = infinite
        for x in range(room + _BORDER - LANES, 0, -LANES):
            place = np.uint64(y * stride + x)
            after = _stepped_left(_stepped_from(cells, place, place + np.uint64(stride), stride), after)
            store(cells, place, after)
    for y in range(height):
        first = (y + _BORDER) * stride + _BORDER
        for x in range(width):
            results[np.uint64(y * width + x)] = cells[np.uint64(first + x)] * np.float32(side)
    return told


@inlined
def _stepped_from(cells: Array, place: np.uint64, near: np.uint64, stride: int) -> Lanes:
    """Some cells of a row after steps to them from the next row and the one behind it."""
    one, two, further = np.uint64(1), np.uint64(2), np.uint64(np.int64(near) + stride)
    by_knight = minimum(
        minimum(load(cells, further - one, LANES), load(cells, further + one, LANES)),
        minimum(load(cells, near - two, LANES), load(cells, near + two, LANES)),
    )
    by_corner = minimum(load(cells, near - one, LANES), load(cells, near + one, LANES))
    beside = minimum(by_knight + broadcast(_KNIGHT, LANES), by_corner + broadcast(_DIAGONAL, LANES))
    straight = load(cells, near, LANES) + broadcast(_STRAIGHT, LANES)
    stepped: Lanes = minimum(load(cells, place, LANES), minimum(beside, straight))
    return stepped


@inlined
def _stepped_right(row: Lanes, before: Lanes) -> Lanes:
    """Some cells after steps along their row, from those left of them too: of 1, of up to 3, 7 and 15."""
    infinite = broadcast(np.float32(np.inf), LANES)
    row = minimum(row, shifted(infinite, row, 15) + broadcast(np.float32(1), LANES))
    row = minimum(row, shifted(infinite, row, 14) + broadcast(np.float32(2), LANES))
    row = minimum(row, shifted(infinite, row, 12) + broadcast(np.float32(4), LANES))
    row = minimum(row, shifted(infinite, row, 8) + broadcast(np.float32(8), LANES))
    stepped: Lanes = minimum(row, broadcast_lane(before, 15) + load(_STEPS, np.uint64(0), LANES))
    return stepped


@inlined
def _stepped_left(row: Lanes, after: Lanes) -> Lanes:
    """:func:`_stepped_right` from the row's other end."""
    infinite = broadcast(np.float32(np.inf), LANES)
    row = minimum(row, shifted(row, infinite, 1) + broadcast(np.float32(1), LANES))
    row = minimum(row, shifted(row, infinite, 2) + broadcast(np.float32(2), LANES))
    row = minimum(row, shifted(row, infinite, 4) + broadcast(np.float32(4), LANES))
    row = minimum(row, shifted(row, infinite, 8) + broadcast(np.float32(8), LANES))
    stepped: Lanes = minimum(row, broadcast_lane(after, 0) + load(_STEPS_BACK, np.uint64(0), LANES))
    return stepped


@compiled
def closed_distance(distance: Array, radius: np.float32, side: int) -> Array:
    """Distance to the morphological closing of a set, from the distance to the set itself.

    Parameters
    ----------
    distance : (h, w) float32
        Of cells, px; infinite everywhere if the set is empty.
    radius : float32
        Gaps of up to twice this that are enclosed by the set belong to it, px.
    side : int
        Of a cell, px.

    Returns
    -------
    (h, w) float32
        px.
    """
    # Past the region's border the set is taken to go on: an object that leaves the frame stays whole.
    outside = to_occupied(distance > radius, 1)
    closed = to_occupied(outside > np.float32(radius / side), side)
    nearest: Array = np.minimum(distance, closed)
    return nearest
