"""Proposals: bounding boxes within which a layer can win pixels; the cut is restricted to them (§7).

An object's region leaves room for its motion, and for parts of it that have no trajectory yet: four of five
of its cells clearly belong to the background. A layer's proposal is the box around the cells where it costs
less than the background or has a trajectory: inside it contrast can give an object cells where it does not
cost least; larger boxes have not made label maps better. Outside all proposals is background.

Differs from the paper, which labels the whole frame with all layers at once.
"""

from __future__ import annotations

import numpy as np

from mlbs_actors.kernels.jit import compiled
from mlbs_actors.messages import Array

__all__ = ["proposal_boxes"]


@compiled
def proposal_boxes(
    cost: Array,
    places: Array,
    positions: Array,
    tracks: Array,
    corner: tuple[int, int],
    side: int,
) -> Array:
    """Find the box of cells that each layer may win.

    Parameters
    ----------
    cost : (K, h, w) uint8
    places : (K, 4) int64
        Of :class:`~mlbs_actors.appearance.fusion.FusedCosts`; the first layer is the background.
    positions : (n, 2) float32
        Trajectories, px of the frame.
    tracks : (K, 2) int64
        First trajectory of each layer, and the one past its last.
    corner : (x, y)
        Position of the costs' box in the frame, cells.
    side : int
        Of a cell, px.

    Returns
    -------
    (K, 4) int64
        First row, row past the last, first column, column past the last: for the background its place, for
        any other layer inside its place, and empty if it costs least nowhere and has no trajectory.
    """
    found = np.zeros_like(places)
    found[0] = places[0]
    leads = np.empty(cost.shape[2], np.bool_)
    for layer in range(1, len(places)):
        top, bottom, left, right = places[layer]
        first, end = bottom, top
        leads[:] = False
        for y in range(top, bottom):
            own, background, any_leads = cost[layer, y], cost[0, y], False
            for x in range(left, right):
                at = np.uint64(x)
                lead = own[at] < background[at]
                leads[at] |= lead
                any_leads |= lead
            if any_leads:
                first, end = min(first, y), y + 1
        for point in range(tracks[layer, 0], tracks[layer, 1]):
            x = int(np.rint(positions[point, 0])) // side - corner[0]
            y = int(np.rint(positions[point, 1])) // side - corner[1]
            if top <= y < bottom and left <= x < right:
                leads[x] = True
                first, end = min(first, y), max(end, y + 1)
        if first < end:
            columns, box = np.flatnonzero(leads), found[layer]
            box[0], box[1], box[2], box[3] = first, end, columns[0], columns[-1] + 1
    return found
