"""Where dense flow is worth its finest level: near objects, and where the camera fails to explain the image.

The finest level is most of the flow's cost, and it is there for outlines: flow that bleeds past an outline
makes wrong trajectories. Where the last frame held nothing but background that moves as the camera does,
the level above it says the same. What is new shows in the next frame, because the camera does not explain
it.

Not in the paper, whose flow takes its full cost everywhere.
"""

from __future__ import annotations

import cv2
import numpy as np

from mlbs_actors.kernels.jit import compiled
from mlbs_actors.messages import Array, Region
from mlbs_actors.segmentation.region_groups import group_regions

__all__ = ["focus_boxes", "focus_cells"]

#: Side of a cell, px of the shrunk frame.
CELL = 8
#: A cell is looked at closely if the flow explained the image better than the camera by this in it, × noise.
ADVANTAGE = 0.5
#: Fewer such cells together are chance.
LEAST_CELLS = 3
#: So many cells around what is looked at closely: how far it may move in a frame, and what the flow sees
#: beside it.
GROWN = 2
#: Column of OpenCV's statistics of a component.
_AREA = int(cv2.CC_STAT_AREA)
#: What a seam between two boxes costs for each pair of cells that it parts, in cells.
SEAM = 4.0
#: Above this share of the frame, boxes are not worth their seams.
MOST = 0.7


def focus_cells(
    advantage: Array, positions: Array, motions: Array, objects: Array, step: tuple[float, float]
) -> Array:
    """Cells of a finished frame around which the next flow needs its finest level.

    Parameters
    ----------
    advantage : (h, w) float32
        Of :class:`~mlbs_actors.tracking.camera.CameraEvidence`, × noise.
    positions, motions : (n, 2) float32
        Trajectories in it, and their backward motions, which are taken to go on, full-size px.
    objects : (n,) bool
        Which of them are on objects.
    step : (float, float)
        Full-size px per px of the shrunk frame.

    Returns
    -------
    (⌈h / CELL⌉, ⌈w / CELL⌉) bool
    """
    height, width = advantage.shape
    rows, columns = -(-height // CELL), -(-width // CELL)
    mean = cv2.resize(advantage, (columns, rows), interpolation=cv2.INTER_AREA)
    _, piece, stats, _ = cv2.connectedComponentsWithStats((mean > ADVANTAGE).view(np.uint8), connectivity=8)
    cells = _cells(
        piece, stats, positions, motions, objects,
        np.float32(CELL * step[0]), np.float32(CELL * step[1]),
    )  # fmt: skip
    return np.asarray(cv2.dilate(cells, np.ones((2 * GROWN + 1, 2 * GROWN + 1), np.uint8)), bool)


@compiled
def _cells(
    piece: Array, stats: Array, positions: Array, motions: Array, objects: Array, width: np.float32,
    height: np.float32,
) -> Array:  # fmt: skip
    """Cells of pieces (1 …; 0 is none) that are no chance, and those where objects will be, as uint8."""
    cells = np.empty(piece.shape, np.uint8)
    for y in range(piece.shape[0]):
        for x in range(piece.shape[1]):
            cells[y, x] = piece[y, x] > 0 and stats[piece[y, x], _AREA] >= LEAST_CELLS
    for i in range(objects.size):
        if objects[i]:
            x = int((positions[i, 0] - motions[i, 0]) / width)
            y = int((positions[i, 1] - motions[i, 1]) / height)
            cells[min(max(y, 0), piece.shape[0] - 1), min(max(x, 0), piece.shape[1] - 1)] = 1
    return cells


def focus_boxes(cells: Array, shape: tuple[int, int]) -> list[Region]:
    """Boxes around the cells, disjoint; the whole frame if they would be most of it.

    Flow is better in one box around neighbours than in several with seams. Only where such boxes would be
    most of the frame, as in a crowd, they are parted.

    Parameters
    ----------
    cells : (rows, columns) bool
        Of :func:`focus_cells`.
    shape : (h, w)
        Of the shrunk frame.

    Returns
    -------
    list of Region
    """
    _, _, stats, _ = cv2.connectedComponentsWithStats(cells.view(np.uint8), connectivity=8)
    boxes = [group.box for group in group_regions(_in_pixels(stats[1:, :4], shape), shape)]
    if _most(boxes, shape):
        boxes = _in_pixels(_parts(cells), shape)
    return [Region(0, 0, shape[1], shape[0])] if _most(boxes, shape) else boxes


def _in_pixels(rectangles: Array, shape: tuple[int, int]) -> list[Region]:
    """Rectangles of cells (n, 4), left, top, width and height, as far as they lie in the frame."""
    height, width = shape
    return [
        Region(x * CELL, y * CELL, min(w * CELL, width - x * CELL), min(h * CELL, height - y * CELL))
        for x, y, w, h in rectangles.tolist()
    ]


def _most(boxes: list[Region], shape: tuple[int, int]) -> bool:
    return sum(box.area for box in boxes) > MOST * shape[0] * shape[1]


@compiled
def _parts(cells: Array) -> Array:
    """Disjoint rectangles around all cells, (n, 4) int64: left, top, width and height.

    One around all of them is cut in two as long as two around what is on either side cost less.
    """
    waiting, parts = [(0, cells.shape[0], 0, cells.shape[1])], []
    while waiting:
        top, bottom, left, right = _shrunk(cells, waiting.pop())
        if top == bottom:
            continue
        part = cells[top:bottom, left:right]
        between_rows, between_columns = _cut_costs(part), _cut_costs(part.T)
        row, column = int(np.argmin(between_rows)), int(np.argmin(between_columns))
        if min(between_rows[row], between_columns[column]) >= part.size:
            parts.append((left, top, right - left, bottom - top))
        elif between_rows[row] <= between_columns[column]:
            waiting.append((top, top + row, left, right))
            waiting.append((top + row, bottom, left, right))
        else:
            waiting.append((top, bottom, left, left + column))
            waiting.append((top, bottom, left + column, right))
    found = np.empty((len(parts), 4), np.int64)
    for place in range(len(parts)):
        found[place] = parts[place]
    return found


@compiled
def _shrunk(cells: Array, part: tuple[int, int, int, int]) -> tuple[int, int, int, int]:
    """The smallest rectangle around the cells of a part; without height if there are none."""
    top, bottom, left, right = part[1], part[0], part[3], part[2]
    for y in range(part[0], part[1]):
        for x in range(part[2], part[3]):
            if cells[y, x]:
                top, bottom = min(top, y), max(bottom, y + 1)
                left, right = min(left, x), max(right, x + 1)
    return min(top, bottom), bottom, left, right


@compiled
def _cut_costs(cells: Array) -> Array:
    """Cost of a cut above each row: the cells of the rectangles on both sides, and the seam."""
    rows, columns = cells.shape
    costs = np.zeros(rows)
    for turn in range(2):
        left, right, height = columns, 0, 0
        for place in range(rows - 1):
            row = place if turn == 0 else rows - 1 - place
            for x in range(columns):
                if cells[row, x]:
                    left, right, height = min(left, x), max(right, x + 1), place + 1
            costs[row + 1 - turn] += height * (right - left)
    costs[0] = np.inf
    for row in range(1, rows):
        for x in range(columns):
            costs[row] += SEAM * (cells[row - 1, x] & cells[row, x])
    return costs
