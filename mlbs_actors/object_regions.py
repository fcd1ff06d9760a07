"""Where the objects are looked for in a frame: the one rule by which every part of the engine knows it.

An object is evaluated inside its *region* only: the box of its trajectories and of its pixels in the last
published map, moved by its own motion, with a margin. What lies outside every object's region is background
without a question, so that the background's own posterior matters inside these regions only. The regions
follow from what every layer is sent, so that the layers agree on them without another message.

Differs from the paper, in which every layer is evaluated on the whole frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil, floor

import numpy as np

from mlbs_actors.cells import aligned, in_cells
from mlbs_actors.compilation import compiled
from mlbs_actors.config import length_scale
from mlbs_actors.messages import BACKGROUND, Array, FrameEvidence, LayerEvidence, Region, Segmentation
from mlbs_actors.region_groups import around, common, slices_in

__all__ = ["bounds", "box_within", "contested", "median_motion", "object_region"]


def object_region(
    evidence: LayerEvidence,
    previous: Segmentation | None,
    shape: tuple[int, int],
    margin_px: float,
    cell: int = 1,
) -> Region:
    """Region of one object in frame t.

    Parameters
    ----------
    evidence : LayerEvidence
        The object's trajectories at t.
    previous : Segmentation or None
        Published result of t−1; None for the first frame.
    shape : (H, W)
        Size of the frame, px.
    margin_px : float
        Margin around trajectories and pixels, px of a 640×480 frame.
    cell : int
        The region is made of whole cells of this side, px.

    Returns
    -------
    Region
        Inside the frame; empty for an object without trajectories and pixels.
    """
    boxes = []
    if len(evidence.positions):
        boxes.append(bounds(evidence.positions))
    for summary in previous.layers if previous is not None else ():
        if summary.layer == evidence.layer:
            box = summary.region
            if boxes:
                back_x, back_y = median_motion(evidence.motions)
                x, y = box.x - back_x, box.y - back_y
            else:
                x, y = box.x + summary.velocity[0], box.y + summary.velocity[1]
            boxes.append((x, y, x + box.width, y + box.height))
    if not boxes:
        return Region(0, 0, 0, 0)
    margin = margin_px * length_scale(*shape)
    return aligned(box_within(boxes, margin, shape), cell, shape)


def median_motion(motions: Array) -> tuple[float, float]:
    """Median of some motions (n ≥ 1, 2), px: of x and of y."""
    x, y = _median_motion(motions)
    return float(x), float(y)


@compiled()
def _median_motion(motions: Array) -> tuple[float, float]:
    return np.median(motions[:, 0]), np.median(motions[:, 1])


@compiled()
def bounds(positions: Array) -> tuple[float, float, float, float]:
    """Least x and y, largest x and y of some positions (n ≥ 1, 2)."""
    x, y = positions[:, 0], positions[:, 1]
    return x.min(), y.min(), x.max(), y.max()


def box_within(
    boxes: Sequence[tuple[float, float, float, float]], margin: float, shape: tuple[int, int]
) -> Region:
    """The region around some :func:`bounds`, at least one, with a margin, inside an (H, W) frame, px."""
    left, top, right, bottom = zip(*boxes, strict=True)
    x0, y0 = _within(floor(min(left) - margin), shape[1]), _within(floor(min(top) - margin), shape[0])
    x1 = _within(ceil(max(right) + margin) + 1, shape[1])
    y1 = _within(ceil(max(bottom) + margin) + 1, shape[0])
    return Region(x0, y0, x1 - x0, y1 - y0)


def _within(place: int, length: int) -> int:
    return min(max(place, 0), length)


def contested(
    evidence: FrameEvidence, previous: Segmentation | None, margin_px: float, cell: int = 1
) -> tuple[Region, Array]:
    """Where a pixel can be an object's: the union of the objects' regions.

    Parameters
    ----------
    evidence : FrameEvidence
    previous : Segmentation or None
        Published result of the frame before.
    margin_px, cell
        As for :func:`object_region`.

    Returns
    -------
    box : Region
        Around it and one pixel more on each side, as far as the frame goes; of whole cells, px.
    inside : (rows, columns) bool
        Which of the box's cells are in it.
    """
    regions = [
        object_region(one, previous, evidence.shape, margin_px, cell)
        for one in evidence.layers
        if one.layer != BACKGROUND
    ]
    whole = Region(0, 0, evidence.shape[1], evidence.shape[0])
    box = aligned(common(around(regions, 1), whole), cell, evidence.shape)
    cells = in_cells(box, cell)
    inside = np.zeros((cells.height, cells.width), np.bool_)
    for region in regions:
        inside[slices_in(in_cells(region, cell), cells)] = True
    return box, inside
