"""How much of a label's outline is the frame's border, or that of what is fixed in the picture (§4).

Not in the paper. Near parts of a scene reach out of the frame, an object is mostly surrounded by the
background; known from saliency as boundary connectivity (Zhu et al. 2014). It is measured in squares with
trajectories.
"""

from __future__ import annotations

import cv2
import numpy as np

from mlbs_actors.config import length_scale
from mlbs_actors.kernels.jit import compiled
from mlbs_actors.messages import Array

__all__ = ["border_share", "scene_squares", "taken_squares"]

#: Side of the squares of which an outline is made, px, and fewest of them.
SQUARE_PX, LEAST_SQUARES = 24.0, 4
#: A square of which so much is fixed in the picture shows none of the scene.
MOST_FIXED = 0.5


def taken_squares(positions: Array, shape: tuple[int, int]) -> Array:
    """Squares of the frame that hold some trajectories.

    Parameters
    ----------
    positions : (n, 2) float32
        px.
    shape : (int, int)
        (H, W) of the frame.

    Returns
    -------
    (rows, columns) bool
    """
    taken: Array = _taken(positions, shape, np.zeros(_squares_of(shape), np.bool_))
    return taken


@compiled
def _taken(positions: Array, shape: tuple[int, int], taken: Array) -> Array:
    """Fill in the squares of :func:`taken_squares`."""
    rows, columns = taken.shape
    for point in range(len(positions)):
        y, x = positions[point, 1] * rows / shape[0], positions[point, 0] * columns / shape[1]
        taken[min(max(int(y), 0), rows - 1), min(max(int(x), 0), columns - 1)] = True
    return taken


def scene_squares(fixed: Array, shape: tuple[int, int]) -> Array:
    """Squares of the frame that show the scene.

    Parameters
    ----------
    fixed : (h, w) bool
        Cells that are fixed in the picture.
    shape : (int, int)
        (H, W) of the frame.

    Returns
    -------
    (rows, columns) bool
    """
    rows, columns = _squares_of(shape)
    share = cv2.resize(fixed.astype(np.float32), (columns, rows), interpolation=cv2.INTER_AREA)
    return np.asarray(share < MOST_FIXED)


def _squares_of(shape: tuple[int, int]) -> tuple[int, int]:
    """Rows and columns of squares in a frame."""
    side = SQUARE_PX * length_scale(*shape)
    rows, columns = (max(round(length / side), 3) for length in shape)
    return rows, columns


@compiled
def border_share(taken: Array, scene: Array) -> float:
    """Share of an outline that is the border of what shows the scene.

    Parameters
    ----------
    taken, scene : (rows, columns) bool
        Of :func:`taken_squares` and :func:`scene_squares`.

    Returns
    -------
    float
        0 to 1, of the taken squares that are not surrounded by such; 0 if those are few.
    """
    outline, border = 0, 0
    for y in range(taken.shape[0]):
        for x in range(taken.shape[1]):
            if taken[y, x] and not _surrounded(taken, y, x):
                outline += 1
                border += not _surrounded(scene, y, x)
    return border / outline if outline >= LEAST_SQUARES else 0.0


@compiled
def _surrounded(squares: Array, y: int, x: int) -> bool:
    """Whether a square has all four beside it in the frame, and such as it is."""
    if not (0 < y < squares.shape[0] - 1 and 0 < x < squares.shape[1] - 1 and squares[y, x]):
        return False
    return bool(squares[y - 1, x] and squares[y + 1, x] and squares[y, x - 1] and squares[y, x + 1])
