"""Dense inverse search: the motion of small patches, coarse to fine (Kroeger et al., ECCV 2016).

On every level patches are searched (:mod:`mlbs_actors.flow.patch_search`), each pixel takes the mean motion
of those over it, and a variational refinement (:mod:`mlbs_actors.flow.variational_refinement`) smooths the
result.

OpenCV's implementation takes twice as long: here a frame's levels are computed once for both directions, and
the kernels are vectorised. A part of a level is searched with its surroundings in view, which gives better
flow than a frame cropped to the part.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from mlbs_actors.flow.patch_search import MARGIN, PATCH, densify, patch_places, search_patches
from mlbs_actors.flow.variational_refinement import refine_flow
from mlbs_actors.kernels.jit import compiled
from mlbs_actors.messages import Array, Region

__all__ = [
    "FlowLevel",
    "SearchEffort",
    "coarsest_level",
    "flow_levels",
    "improve_flow",
    "resized_flow",
]

#: Sweeps of the variational refinement's solver; more do not separate objects better.
SWEEPS = 3


class SearchEffort(NamedTuple):
    """How much work is spent on a flow.

    Attributes
    ----------
    iterations : int
        Descents of a patch at most, half of them in each of two passes over the level.
    refinements : int
        Iterations of the variational refinement; 0 = none.
    stride : int
        From one patch to the next, px.
    """

    iterations: int
    refinements: int
    stride: int


@dataclass(frozen=True, slots=True)
class FlowLevel:
    """One level of a frame.

    Attributes
    ----------
    gray : (h, w) uint8
    around : (h + 2 MARGIN, w + 2 MARGIN) float32
        The same, padded by repeating the outermost pixels.
    slope_x, slope_y : (h, w) int16
        Sobel gradients.
    """

    gray: Array
    around: Array
    slope_x: Array
    slope_y: Array


def coarsest_level(shape: tuple[int, int]) -> int:
    """Number of halvings after which a frame (h, w) is about four patches wide, and at least one high."""
    return max(0, min(int(np.log2(max(shape) / (4.0 * PATCH)) + 0.5), int(np.log2(min(shape) / PATCH))))


def flow_levels(gray: Array, count: int) -> list[FlowLevel]:
    """Return a frame (h, w) uint8 and its next ``count`` halvings, finest first."""
    levels = []
    for level in range(count + 1):
        if level:
            gray = cv2.resize(gray, (gray.shape[1] // 2, gray.shape[0] // 2), interpolation=cv2.INTER_AREA)
        levels.append(FlowLevel(gray, _continued(gray), *cv2.spatialGradient(gray)))
    return levels


@compiled
def _continued(gray: Array) -> Array:
    """Return a frame as float32, its outermost pixels repeated ``MARGIN`` times."""
    height, width = gray.shape
    around = np.empty((height + 2 * MARGIN, width + 2 * MARGIN), np.float32)
    for y in range(around.shape[0]):
        known, row = gray[min(max(y - MARGIN, 0), height - 1)], around[y]
        for x in range(width):
            row[x + MARGIN] = known[x]
        row[:MARGIN], row[width + MARGIN :] = row[MARGIN], row[width + MARGIN - 1]
    return around


def resized_flow(flow: Array, shape: tuple[int, int]) -> Array:
    """Resize flow planes (2, h, w) to another grid, in px of that; the same array if the grid is the same."""
    _, height, width = flow.shape
    if shape == (height, width):
        return flow
    resized = np.empty((2, *shape), np.float32)
    for one, wider, factor in zip(flow, resized, (shape[1] / width, shape[0] / height), strict=True):
        cv2.resize(one, shape[::-1], dst=wider)
        wider *= np.float32(factor)
    return resized


def improve_flow(
    source: FlowLevel, target: FlowLevel, flow: Array, parts: Sequence[Region], effort: SearchEffort
) -> None:
    """Search some parts of a level, one after the other, and refine the flow found there.

    Parameters
    ----------
    source, target : FlowLevel
        Of the same size.
    flow : (2, h, w) float32
        x and y of the motion from ``source`` to ``target``, the estimate so far, px; improved in place.
    parts : sequence of Region
        Each at least a patch wide and high.
    effort : SearchEffort
    """
    if parts:
        boxes = np.array([(part.x, part.y, part.width, part.height) for part in parts])
        _improve(source.gray, target.around, source.slope_x, source.slope_y, flow, boxes, effort)


@compiled
def _improve(
    gray: Array, around: Array, slope_x: Array, slope_y: Array, flow: Array, boxes: Array,
    effort: SearchEffort,
) -> None:  # fmt: skip
    """:func:`improve_flow` in boxes (n, 4): left, top, width and height."""
    iterations = max(1, effort.iterations // 2)  # of each pass
    for box in range(len(boxes)):
        left, top, width, height = boxes[box]
        across, down = patch_places(left, width, effort.stride), patch_places(top, height, effort.stride)
        motions = search_patches(gray, around, slope_x, slope_y, flow, across, down, iterations)
        window = np.zeros((3, height, width), np.float32)
        densify(gray, around, motions, across, down, left, top, window)
        for _ in range(effort.refinements):
            refine_flow(gray, around, (left, top), window, MARGIN, SWEEPS)
        for axis in range(2):  # index 2 of the window holds the sum of weights
            for y in range(height):
                for x in range(width):
                    flow[axis, top + y, left + x] = window[axis, y, x]
