"""Where the objects are searched for in a frame: the one rule that every part of the engine applies.

An object is evaluated inside its *region* only: the box of its trajectories and of its pixels in the last
published map, moved by its own motion, with a margin. The margin is wide for objects that may be far larger
than known: those that are new, enter at the frame's border, or come back from behind something, where
trajectories get lost. An object in full view, whose trajectories cover its pixels, needs a sixth of it, and
more where parts of it, such as legs, move differently from the whole.

Outside every object's region all is background, so the background's own posterior matters inside these
regions only. The regions follow from the evidence that every layer is sent, so that the layers agree on them
without another message.

Differs from the paper, in which every layer is evaluated on the whole frame.
"""

from __future__ import annotations

from math import ceil, floor

import numpy as np

from mlbs_actors.config import length_scale
from mlbs_actors.kernels.jit import compiled
from mlbs_actors.messages import (
    BACKGROUND,
    Array,
    FrameEvidence,
    LayerEvidence,
    LayerSummary,
    Region,
    Segmentation,
)

__all__ = [
    "bounds",
    "box_within",
    "contested",
    "median_of_motions",
    "object_region",
]

#: See :func:`object_region`.
Margins = tuple[float, float, float]


def object_region(
    own: LayerEvidence,
    shape: tuple[int, int],
    previous: Segmentation | None,
    margins_px: Margins,
    cell: int,
) -> Region:
    """Find the region of one object in frame t.

    Parameters
    ----------
    own : LayerEvidence
        Its trajectories at t.
    shape : (H, W)
        Size of the frame, px.
    previous : Segmentation or None
        Published result of t−1.
    margins_px : Margins
        Margins around trajectories and pixels, px of a 640×480 frame: of any object, and of one in full view,
        to which the largest deviation from its median motion is added; and most pixels per trajectory at
        which an object's trajectories cover it, px² of such a frame.
    cell : int
        The region consists of whole cells of this side, px.

    Returns
    -------
    Region
        Inside the frame; empty for an object without trajectories and pixels.
    """
    summaries = previous.layers if previous is not None else ()
    known = _known_pixels(next((one for one in summaries if one.layer == own.layer), None))
    scale = length_scale(*shape)
    return Region(
        *_region_of_object(
            np.array(known, np.float64), own.positions, own.motions, margins_px, scale, cell, *shape
        )
    )


def _known_pixels(one: LayerSummary | None) -> tuple[float, ...]:
    """Return number, box and velocity of an object's pixels in the last map."""
    if one is None:
        return 0, 0, 0, 0, 0, 0, 0
    return one.area, *one.region.box, *one.velocity


@compiled
def _region_of_object(
    pixels: Array, positions: Array, motions: Array, margins_px: Margins, scale: float, cell: int,
    height: int, width: int,
) -> tuple[int, int, int, int]:  # fmt: skip
    """Compute box (left, top, width, height) of :func:`object_region`, px, from :func:`_known_pixels`."""
    left, top, right, bottom = np.inf, np.inf, -np.inf, -np.inf
    move_x, move_y = pixels[5], pixels[6]
    if len(positions):
        x0, y0, x1, y1 = bounds(positions)
        left, top, right, bottom = np.float64(x0), np.float64(y0), np.float64(x1), np.float64(y1)
        if pixels[0]:
            back_x, back_y = median_of_motions(motions)
            move_x, move_y = -np.float64(back_x), -np.float64(back_y)
    elif not pixels[0]:
        return 0, 0, 0, 0
    if pixels[0]:
        moved_x, moved_y = pixels[1] + move_x, pixels[2] + move_y
        left, top = min(left, moved_x), min(top, moved_y)
        right, bottom = max(right, moved_x + pixels[3]), max(bottom, moved_y + pixels[4])
    inside = (
        pixels[1] > 0 and pixels[2] > 0 and pixels[1] + pixels[3] < width and pixels[2] + pixels[4] < height
    )
    in_full_view = pixels[0] and inside and pixels[0] <= len(positions) * margins_px[2] * scale**2
    margin = scale * margins_px[0]
    if in_full_view:
        margin = min(margin, scale * margins_px[1] + _farthest(motions, -move_x, -move_y))
    x, y, wide, high = box_within(left, top, right, bottom, margin, height, width)
    if wide * high == 0:
        return x, y, wide, high
    # Whole cells, which end at the frame's border.
    end_x, end_y = min(-(-(x + wide) // cell) * cell, width), min(-(-(y + high) // cell) * cell, height)
    x, y = x // cell * cell, y // cell * cell
    return x, y, end_x - x, end_y - y


@compiled
def median_of_motions(motions: Array) -> tuple[float, float]:
    """Return the median of some motions (n ≥ 1, 2), px: of x and of y."""
    return np.median(motions[:, 0]), np.median(motions[:, 1])


@compiled
def _farthest(motions: Array, x: float, y: float) -> float:
    """Return the largest deviation of some motions from a given one, in x or in y, px."""
    most = np.float32(0)
    for one in range(len(motions)):
        most = max(most, abs(motions[one, 0] - np.float32(x)), abs(motions[one, 1] - np.float32(y)))
    return np.float64(most)


@compiled
def bounds(positions: Array) -> tuple[float, float, float, float]:
    """Return least x and y, largest x and y of some positions (n ≥ 1, 2)."""
    x, y = positions[:, 0], positions[:, 1]
    return x.min(), y.min(), x.max(), y.max()


@compiled
def box_within(
    left: float, top: float, right: float, bottom: float, margin: float, height: int, width: int
) -> tuple[int, int, int, int]:
    """Return left, top, width and height of the pixels in some bounds with a margin, inside a frame, px."""
    x, y = _within(floor(left - margin), width), _within(floor(top - margin), height)
    end_x, end_y = _within(ceil(right + margin) + 1, width), _within(ceil(bottom + margin) + 1, height)
    return x, y, end_x - x, end_y - y


@compiled
def _within(place: int, length: int) -> int:
    return min(max(place, 0), length)


def contested(
    evidence: FrameEvidence, previous: Segmentation | None, margins_px: Margins, cell: int = 1
) -> tuple[Region, Array]:
    """Find where a pixel can be an object's: the union of the objects' regions.

    Parameters
    ----------
    evidence : FrameEvidence
    previous : Segmentation or None
        Published result of the frame before.
    margins_px, cell
        As for :func:`object_region`.

    Returns
    -------
    box : Region
        Around it with a margin of one pixel, clipped to the frame; of whole cells, px.
    inside : (rows, columns) bool
        Which of the box's cells are in it.
    """
    objects = [one for one in evidence.tracks if one.layer != BACKGROUND]
    if not objects:
        return Region(0, 0, 0, 0), np.zeros((0, 0), np.bool_)
    counts = np.array([one.end - one.start for one in objects])
    published = {one.layer: one for one in previous.layers} if previous is not None else {}
    pixels = np.array([_known_pixels(published.get(one.layer)) for one in objects], np.float64)
    shape, scale = evidence.shape, length_scale(*evidence.shape)
    box, inside = _contested(
        pixels, evidence.positions, evidence.motions, counts, margins_px, scale, cell, shape
    )
    return Region(*box), inside


@compiled
def _contested(
    pixels: Array, positions: Array, motions: Array, counts: Array, margins_px: Margins,
    scale: float, cell: int, shape: tuple[int, int],
) -> tuple[tuple[int, int, int, int], Array]:  # fmt: skip
    """Find the box and its cells; the objects' trajectories come last in the arrays."""
    height, width = shape
    regions = np.empty((len(pixels), 4), np.int64)
    left, top, right, bottom = width, height, 0, 0
    start = len(positions) - counts.sum()
    for one in range(len(pixels)):
        end = start + counts[one]
        x, y, wide, high = _region_of_object(
            pixels[one], positions[start:end], motions[start:end], margins_px, scale, cell, height, width
        )
        if wide * high:
            left, top, right, bottom = (
                min(left, x - 1), min(top, y - 1), max(right, x + wide + 1), max(bottom, y + high + 1)
            )  # fmt: skip
        regions[one, 0], regions[one, 1], regions[one, 2], regions[one, 3] = x, y, x + wide, y + high
        start = end
    left, top = max(left, 0) // cell * cell, max(top, 0) // cell * cell
    right = min(-(-right // cell) * cell, width)
    bottom = min(-(-bottom // cell) * cell, height)
    if right <= left:
        left, top, right, bottom = 0, 0, 0, 0
    inside = np.zeros((-(-(bottom - top) // cell), -(-(right - left) // cell)), np.bool_)
    for one in range(len(pixels)):
        x, y = (regions[one, 0] - left) // cell, (regions[one, 1] - top) // cell
        end_x, end_y = -(-(regions[one, 2] - left) // cell), -(-(regions[one, 3] - top) // cell)
        if regions[one, 2] > regions[one, 0]:
            inside[y:end_y, x:end_x] = True
    return (left, top, right - left, bottom - top), inside
