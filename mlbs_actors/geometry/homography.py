"""Homographies, (3, 3): where they take points, and the same one between pictures of other pixels."""

from __future__ import annotations

import numpy as np

from mlbs_actors.kernels.jit import compiled
from mlbs_actors.messages import Array

__all__ = ["homography_motion", "homography_of_cells"]


@compiled
def homography_motion(matrix: Array, positions: Array) -> Array:
    """Return the backward motion of each point under a homography.

    Parameters
    ----------
    matrix : (3, 3) float64
    positions : (n, 2)
        px.

    Returns
    -------
    (n, 2) float32
        px.
    """
    motions = np.empty((len(positions), 2), np.float32)
    for point in range(len(positions)):
        x, y = np.float64(positions[point, 0]), np.float64(positions[point, 1])
        along = matrix[0, 0] * x + matrix[0, 1] * y + matrix[0, 2]
        down = matrix[1, 0] * x + matrix[1, 1] * y + matrix[1, 2]
        depth = matrix[2, 0] * x + matrix[2, 1] * y + matrix[2, 2]
        motions[point, 0], motions[point, 1] = along / depth - x, down / depth - y
    return motions


@compiled
def homography_of_cells(matrix: Array, side: int) -> Array:
    """Return the same homography between pictures whose pixels are cells of the frame.

    Parameters
    ----------
    matrix : (3, 3) float64
    side : int
        Of a cell, px.

    Returns
    -------
    (3, 3) float64
    """
    # A cell's centre lies at (cell + ½)·side − ½.
    of_cells, shift = np.empty((3, 3)), 0.5 * side - 0.5
    for axis in range(2):
        for column in range(3):
            of_cells[axis, column] = 1 / side * matrix[axis, column] - shift / side * matrix[2, column]
    of_cells[2] = matrix[2]
    for row in range(3):
        along, down = of_cells[row, 0], of_cells[row, 1]
        of_cells[row, 2] += along * shift + down * shift
        of_cells[row, 0], of_cells[row, 1] = along * side, down * side
    return of_cells
