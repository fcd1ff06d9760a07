"""Where dense flow needs its finest level: near objects, and where the camera fails to explain the image.

The finest level is most of the flow's cost, and it is there for outlines: flow that bleeds past an outline
makes wrong trajectories. Where the last frame had only background that moves as the camera does, the next
coarser level gives the same flow. What is new shows in the next frame, which the camera does not explain.

Not in the paper, whose flow takes its full cost everywhere.
"""

from __future__ import annotations

import cv2
import numpy as np

from mlbs_actors.config import FlowConfig
from mlbs_actors.geometry.boxes import group_regions
from mlbs_actors.kernels.jit import compiled
from mlbs_actors.messages import Array, Region

__all__ = ["focus_blocks", "focus_boxes"]

#: Side of a block, cells.
BLOCK = 8
#: Column of OpenCV's statistics of a component.
_AREA = int(cv2.CC_STAT_AREA)


def focus_blocks(
    advantage: Array, positions: Array, motions: Array, objects: Array, side: int, config: FlowConfig
) -> Array:
    """Find the blocks of a finished frame around which the next flow needs its finest level.

    Parameters
    ----------
    advantage : (h, w) float32
        Of :class:`~mlbs_actors.tracking.camera.CameraEvidence`, × noise.
    positions, motions : (n, 2) float32
        Trajectories in it, and their backward motions, which are taken to go on, px.
    objects : (n,) bool
        Which of them are on objects.
    side : int
        Of a cell, px.

    Returns
    -------
    (⌈h / BLOCK⌉, ⌈w / BLOCK⌉) bool
    """
    height, width = advantage.shape
    rows, columns = -(-height // BLOCK), -(-width // BLOCK)
    mean = cv2.resize(advantage, (columns, rows), interpolation=cv2.INTER_AREA)
    ahead = (mean > config.focus_advantage).view(np.uint8)
    _, piece, stats, _ = cv2.connectedComponentsWithStats(ahead, connectivity=8)
    least, block_px = config.focus_least_blocks, np.float32(BLOCK * side)
    blocks = _blocks(piece, stats, positions, motions, objects, block_px, least)
    # How far they may move in a frame, and the context of the flow.
    grown = 2 * config.focus_margin_blocks + 1
    return np.asarray(cv2.dilate(blocks, np.ones((grown, grown), np.uint8)), bool)


@compiled
def _blocks(
    piece: Array, stats: Array, positions: Array, motions: Array, objects: Array, block_px: np.float32,
    least: int,
) -> Array:  # fmt: skip
    """Label connected blocks (1 …; 0 is none) that are not noise; mark where objects will be, as uint8."""
    blocks = np.empty(piece.shape, np.uint8)
    for y in range(piece.shape[0]):
        for x in range(piece.shape[1]):
            blocks[y, x] = piece[y, x] > 0 and stats[piece[y, x], _AREA] >= least
    for i in range(objects.size):
        if objects[i]:
            x = int((positions[i, 0] - motions[i, 0]) / block_px)
            y = int((positions[i, 1] - motions[i, 1]) / block_px)
            blocks[min(max(y, 0), piece.shape[0] - 1), min(max(x, 0), piece.shape[1] - 1)] = 1
    return blocks


def focus_boxes(blocks: Array, shape: tuple[int, int], config: FlowConfig) -> list[Region]:
    """Return disjoint boxes around the blocks, in cells; the whole frame if they would be most of it.

    Flow is better in one box around neighbours than in several with seams, so boxes are split only where they
    would be most of the frame, as in a crowd.

    Parameters
    ----------
    blocks : (rows, columns) bool
        Of :func:`focus_blocks`.
    shape : (h, w)
        Of the frame, cells.

    Returns
    -------
    list of Region
    """
    _, _, stats, _ = cv2.connectedComponentsWithStats(blocks.view(np.uint8), connectivity=8)
    boxes = [group.box for group in group_regions(_in_cells(stats[1:, :4], shape), shape)]
    most = config.focus_most * shape[0] * shape[1]
    if sum(box.area for box in boxes) > most:
        boxes = _in_cells(_parts(blocks, config.focus_seam_blocks), shape)
    worth = sum(box.area for box in boxes) <= most  # their seams
    return boxes if worth else [Region(0, 0, shape[1], shape[0])]


def _in_cells(rectangles: Array, shape: tuple[int, int]) -> list[Region]:
    """Clip rectangles of blocks (n, 4), left, top, width and height, to the frame; return them in cells."""
    height, width = shape
    return [
        Region(x * BLOCK, y * BLOCK, min(w * BLOCK, width - x * BLOCK), min(h * BLOCK, height - y * BLOCK))
        for x, y, w, h in rectangles.tolist()
    ]


@compiled
def _parts(blocks: Array, seam: float) -> Array:
    """Cover all blocks by disjoint rectangles, (n, 4) int64: left, top, width and height.

    A rectangle around all of them is cut in two as long as the two rectangles cost less.
    """
    waiting, parts = [(0, blocks.shape[0], 0, blocks.shape[1])], []
    while waiting:
        top, bottom, left, right = _tightened(blocks, waiting.pop())
        if top == bottom:
            continue
        part = blocks[top:bottom, left:right]
        between_rows, between_columns = _cut_costs(part, seam), _cut_costs(part.T, seam)
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
def _tightened(blocks: Array, part: tuple[int, int, int, int]) -> tuple[int, int, int, int]:
    """Return the smallest rectangle around the blocks of a part; of height 0 if there are none."""
    top, bottom, left, right = part[1], part[0], part[3], part[2]
    for y in range(part[0], part[1]):
        for x in range(part[2], part[3]):
            if blocks[y, x]:
                top, bottom = min(top, y), max(bottom, y + 1)
                left, right = min(left, x), max(right, x + 1)
    return min(top, bottom), bottom, left, right


@compiled
def _cut_costs(blocks: Array, seam: float) -> Array:
    """Return the cost of a cut above each row: the blocks of the rectangles on both sides, and the seam."""
    rows, columns = blocks.shape
    costs = np.zeros(rows)
    for direction in range(2):
        left, right, height = columns, 0, 0
        for place in range(rows - 1):
            row = place if direction == 0 else rows - 1 - place
            for x in range(columns):
                if blocks[row, x]:
                    left, right, height = min(left, x), max(right, x + 1), place + 1
            costs[row + 1 - direction] += height * (right - left)
    costs[0] = np.inf
    for row in range(1, rows):
        for x in range(columns):
            costs[row] += seam * (blocks[row - 1, x] & blocks[row, x])
    return costs
