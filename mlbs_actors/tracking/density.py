"""The bound on the number of trajectories in each square of a frame.

A few trajectories describe a large mover as well as many do, and a small one reaches into several squares. So
none begin in a square that is full (:mod:`mlbs_actors.tracking.seeding`). Yet they gather afterwards: what
moves alike is carried into the same places, above all in objects that stay for long, whose trajectories would
double within a thousand frames. So of those with a full history no more than the bound stay in a square.

Differs from the paper, which has no such bound.
"""

from __future__ import annotations

import numpy as np

from mlbs_actors.kernels.jit import compiled, inlined
from mlbs_actors.messages import Array

__all__ = ["SQUARE", "cell_of", "room_left", "within_room"]

#: Side of a square, cells.
SQUARE = 8


@inlined
def cell_of(positions: Array, point: int, shape: tuple[int, int], side: int) -> tuple[int, int]:
    """Return row and column of the cell where a point is, or of the nearest."""
    x = min(max(int(positions[point, 0] / side), 0), shape[1] - 1)
    y = min(max(int(positions[point, 1] / side), 0), shape[0] - 1)
    return y, x


@compiled
def _room_in_squares(shape: tuple[int, int], most: int) -> Array:
    """Return the bound of each square of a frame of (h, w) cells, (⌈h/8⌉, ⌈w/8⌉) int64."""
    return np.full((-(-shape[0] // SQUARE), -(-shape[1] // SQUARE)), most)


@compiled
def room_left(positions: Array, shape: tuple[int, int], side: int, most: int) -> Array:
    """Count how many more trajectories each square takes, (⌈h/8⌉, ⌈w/8⌉) int64; negative if overfull.

    Parameters
    ----------
    positions : (n, 2) float32
        Of the trajectories, px.
    shape : (int, int)
        (h, w) of the frame, cells.
    side : int
        Of its cells, px.
    most : int
        Bound of a square.
    """
    room = _room_in_squares(shape, most)
    for point in range(positions.shape[0]):
        y, x = cell_of(positions, point, shape, side)
        room[y // SQUARE, x // SQUARE] -= 1
    return room


@compiled
def within_room(
    positions: Array, ages: Array, oldest: int, shape: tuple[int, int], side: int, most: int
) -> Array:
    """Select the trajectories that stay: all young ones, and in each square the first with a full history.

    Parameters
    ----------
    positions : (n, 2) float32
        Those that began first come first, px.
    ages : (n,) int32
    oldest : int
        Age at which a trajectory's history is full.
    shape : (int, int)
        (h, w) of the frame, cells.
    side : int
        Of its cells, px.
    most : int
        As for :func:`room_left`.

    Returns
    -------
    (m,) intp
        Ascending.
    """
    room, stays, count = _room_in_squares(shape, most), np.empty(ages.size, np.intp), 0
    for point in range(ages.size):
        if ages[point] == oldest:
            y, x = cell_of(positions, point, shape, side)
            room[y // SQUARE, x // SQUARE] -= 1
            if room[y // SQUARE, x // SQUARE] < 0:
                continue
        stays[count] = point
        count += 1
    return stays[:count]
