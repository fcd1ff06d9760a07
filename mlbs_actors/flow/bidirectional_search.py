"""Dense inverse search in both directions between two frames.

The backward flow is found first; its inverse is where the search for the forward flow starts.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from mlbs_actors.config import FlowConfig
from mlbs_actors.flow.inverse_search import (
    FlowLevel,
    SearchEffort,
    improve_flow,
    resized_flow,
)
from mlbs_actors.flow.patch_search import PATCH
from mlbs_actors.kernels.jit import compiled
from mlbs_actors.messages import Array, Region

__all__ = ["search_both_ways"]


def search_both_ways(
    before: Sequence[FlowLevel],
    now: Sequence[FlowLevel],
    config: FlowConfig,
    focus: Sequence[Region] | None = None,
) -> tuple[Array, Array]:
    """Search the flow between two frames, both ways.

    Parameters
    ----------
    before, now : sequence of FlowLevel
        All levels of the two, finest first; at least two patches high and wide.
    focus : sequence of Region, optional
        Disjoint boxes where the finest level is computed. By default it is everywhere, and with the settings
        of the first frames, where an object that is missed stays missed for long.

    Returns
    -------
    forward, backward : (2, h, w) float32
        x and y of the motion from ``before`` to ``now`` and from ``now`` to ``before``, in pixels of these.
    """
    height, width = now[0].gray.shape
    whole = [Region(0, 0, width, height)]
    if focus is None:
        effort = SearchEffort(
            config.first_search_iterations, config.first_refinement_iterations, config.first_patch_stride_px
        )
        focus = whole
    else:
        effort = SearchEffort(config.search_iterations, config.refinement_iterations, config.patch_stride_px)
    coarsest = len(now) - 1
    finest = min(config.finest_scale, coarsest)
    if finest == coarsest:  # no coarser level gives the motion outside the boxes
        focus = whole
    # Two levels alone would not do: flow then bleeds 10–20 px past an object's outline.
    backward = np.zeros((2, *now[coarsest].gray.shape), np.float32)
    backward = _finer(now, before, backward, range(coarsest, finest, -1), whole, effort)
    backward = _finer(now, before, backward, [finest], focus, effort)
    if list(focus) == whole:
        turned, first = -resized_flow(backward, now[coarsest].gray.shape), coarsest
    else:
        # Outside the boxes the scene moves as the camera does, so inverting the flow is good enough.
        turned, first = _inverted(backward), min(finest + 1, coarsest)
    forward = _finer(before, now, turned, range(first, finest - 1, -1), focus, effort)
    forward, backward = (resized_flow(one, (height, width)) for one in (forward, backward))
    return forward, backward


def _finer(
    source: Sequence[FlowLevel],
    target: Sequence[FlowLevel],
    flow: Array,
    levels: Iterable[int],
    boxes: Sequence[Region],
    effort: SearchEffort,
) -> Array:
    """Carry a flow (2, h, w) through levels, in place if it can; improve it in boxes of level 0."""
    for level in levels:
        shape = source[level].gray.shape
        flow = resized_flow(flow, shape)
        parts = [_on_level(box, level, shape) for box in boxes]
        improve_flow(source[level], target[level], flow, parts, effort)
    return flow


def _on_level(box: Region, level: int, shape: tuple[int, int]) -> Region:
    """Return the pixels of a level that a box of level 0 covers; at least one patch."""
    places = []
    for start, length, all_ in ((box.x, box.width, shape[1]), (box.y, box.height, shape[0])):
        end = min(max(-(-(start + length) >> level), (start >> level) + PATCH), all_)
        places.append((min(start >> level, end - PATCH), end))
    (left, right), (top, bottom) = places
    return Region(left, top, right - left, bottom - top)


@compiled
def _inverted(flow: Array) -> Array:
    """Invert a flow, planes (2, h, w): find u with u(x) = −flow(x + u(x)), to a pixel in two rounds."""
    _, height, width = flow.shape
    inverse, place = np.empty_like(flow), np.empty(width, np.int32)
    right, bottom, zero = np.float32(width - 1), np.float32(height - 1), np.float32(0)
    along, down = flow[0].reshape(-1), flow[1].reshape(-1)
    for y in range(height):
        u, v = inverse[0, y], inverse[1, y]
        for x in range(width):
            u[x], v[x] = -flow[0, y, x], -flow[1, y, x]
        for _ in range(2):
            for x in range(width):  # vectorised
                there_x = np.int32(min(max(np.rint(np.float32(np.int32(x)) + u[x]), zero), right))
                there_y = np.int32(min(max(np.rint(np.float32(np.int32(y)) + v[x]), zero), bottom))
                place[x] = np.int32(there_y * np.int32(width)) + there_x
            for x in range(width):
                there = np.uint64(np.uint32(place[x]))
                u[x], v[x] = -along[there], -down[there]
    return inverse
