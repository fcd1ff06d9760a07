"""The holes of a frame: what is to be replaced, cut out with some of what is around it."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from mlbs_actors.messages import Array, Region
from orchestrator.make.background_motion import CELL, Sketch, in_picture, sketch_of

__all__ = ["Hole", "holes_of"]


@dataclass(frozen=True, slots=True)
class Hole:
    """Pixels of a frame whose background is wanted.

    Attributes
    ----------
    region : Region
        Of the sketch, in whole cells: the hole and what is around it. It may reach beyond the picture.
    sketch : Sketch
        Of the region.
    inside : (n,) int64
        The hole's pixels, counted in the frame row by row.
    at : (n, 2) float32
        The same, (x, y) in the region of the sketch.
    """

    region: Region
    sketch: Sketch
    inside: Array
    at: Array

    def pixels(self) -> Array:
        """Return (x, y) in the frame's sketch of the region's pixels, (h, w, 2) float32."""
        region = self.region
        xs, ys = np.arange(region.width) + region.x, np.arange(region.height) + region.y
        return np.stack(np.meshgrid(xs, ys), axis=-1).astype(np.float32)


def holes_of(frame: Array, hidden: Array, context: float) -> list[Hole]:
    """Cut the holes out of a frame, each with what is around it.

    Parameters
    ----------
    frame : (H, W, 3) uint8
    hidden : (H, W) uint8
        1 where the background is wanted.
    context : float
        How much around a hole is of interest, a share of the picture's width. Holes closer than that are one.

    Returns
    -------
    list of Hole
    """
    sketch = sketch_of(frame, hidden)
    height, width = sketch.gray.shape
    around = max(1, round(context * width))
    wide = cv2.dilate(1 - sketch.free, np.ones((around | 1, around | 1), np.uint8))
    number, labels = cv2.connectedComponents(wide)
    rows, columns = np.nonzero(hidden)
    at = in_picture(np.stack([columns, rows], axis=1), hidden.shape, sketch.gray.shape)
    whole = np.clip(np.round(at).astype(int), 0, (width - 1, height - 1))
    which = labels[whole[:, 1], whole[:, 0]]
    holes = []
    for one in range(number):
        mine = which == one
        if mine.any():
            region = _region(whole[mine], around, (width, height))
            corner = np.array([region.x, region.y], np.float32)
            inside = rows[mine] * hidden.shape[1] + columns[mine]
            holes.append(Hole(region, _part(sketch, region), inside, at[mine] - corner))
    return holes


def _region(at: Array, around: int, size: tuple[int, int]) -> Region:
    """Return whole cells that hold pixels (n, 2) and what is around them in a picture (width, height)."""
    left, top = np.maximum(at.min(axis=0) - around, 0) // CELL * CELL
    right, bottom = np.minimum(at.max(axis=0) + 1 + around, size)
    return Region(
        int(left), int(top), int(-(-(right - left) // CELL) * CELL), int(-(-(bottom - top) // CELL) * CELL)
    )


def _part(sketch: Sketch, region: Region) -> Sketch:
    """Cut a region out of a sketch; what is beyond it repeats the edge, and is not free."""
    height, width = sketch.gray.shape
    beyond = (0, max(0, region.y + region.height - height), 0, max(0, region.x + region.width - width))
    colours, gray = (
        np.ascontiguousarray(cv2.copyMakeBorder(one, *beyond, cv2.BORDER_REPLICATE)[region.slices])
        for one in (sketch.colours, sketch.gray)
    )
    free = cv2.copyMakeBorder(sketch.free, *beyond, cv2.BORDER_CONSTANT, value=0)[region.slices]
    return Sketch(colours, gray, np.ascontiguousarray(free))
