"""Where a layer may learn the colours that it won, and how far an object extends from its trajectories (§6).

A pixel that is labelled wrongly once, and learnt, would be attributed to the layer ever after; so only cells
whose label is certain are learnt. Not in the paper.
"""

from __future__ import annotations

import numpy as np

from mlbs_actors.cells import aligned, in_cells
from mlbs_actors.config import Config, length_scale
from mlbs_actors.geometry.distance import (
    closed_distance,
    occupied_cells,
    occupy,
    to_occupied,
    trajectory_distance,
)
from mlbs_actors.kernels.jit import compiled
from mlbs_actors.layer.object_regions import bounds, box_within
from mlbs_actors.messages import UNEXPLAINED_STEP, Array, FrameEvidence, LayerEvidence, LayerTracks, Region

__all__ = ["object_support", "trusted_background"]


def object_support(
    config: Config, evidence: FrameEvidence, own: LayerTracks, cells: Region, side: int
) -> tuple[Array, Array]:
    """Find where an object may learn, and how far its cells are from its trajectories.

    Wrong labels near an outline must not be learnt: an object learns close to its own trajectories, where the
    camera's motion fails to explain the image.

    Parameters
    ----------
    evidence : FrameEvidence
    own : LayerTracks
        Which trajectories are the object's.
    cells : Region
        Where it is evaluated, in units of cells.
    side : int
        Of a cell, px.

    Returns
    -------
    trusted : (h, w) bool
        Cells in which it may learn.
    away : (h, w) float32
        0 near its own trajectories and in the gaps between them, rising to 1 further off.
    """
    weights, scale = config.posterior, length_scale(*evidence.shape)
    lengths = (weights.close_px, weights.learn_px, weights.near_px, weights.fade_px)
    trusted, away = _object_support(
        evidence.positions,
        (own.start, own.end),
        side,
        cells.box,
        evidence.unexplained,
        config.layers.unexplained_noise / UNEXPLAINED_STEP,
        np.array(lengths, np.float64) * scale,
    )
    return trusted, away


@compiled
def _object_support(
    positions: Array, own_tracks: tuple[int, int], side: int, cells: tuple[int, int, int, int],
    unexplained: Array, least: float, lengths: Array,
) -> tuple[Array, Array]:  # fmt: skip
    (start, end), (left, top, width, height) = own_tracks, cells
    close, learn = np.float32(lengths[0]), np.float32(lengths[1])
    near, fade = np.float32(lengths[2]), np.float32(lengths[3])
    trusted, away = np.empty((height, width), np.bool_), np.empty((height, width), np.float32)
    # Distances are computed for 2×2 cells of the frame at once.
    coarse, first_column, first_row = 2 * side, left // 2, top // 2
    columns, rows = -(-(left + width) // 2) - first_column, -(-(top + height) // 2) - first_row
    occupied = occupied_cells(positions[:start], coarse, first_column, first_row, columns, rows)
    occupy(occupied, positions[end:], coarse, first_column, first_row)
    others = to_occupied(occupied, coarse)
    occupied = occupied_cells(positions[start:end], coarse, first_column, first_row, columns, rows)
    own = to_occupied(occupied, coarse)
    body = closed_distance(own, close, coarse)
    closest, zero, one = np.empty(own.shape, np.bool_), np.float32(0), np.float32(1)
    for v in range(rows):
        for u in range(columns):
            closest[v, u] = (own[v, u] <= learn) & (own[v, u] < others[v, u])
            body[v, u] = min(max((body[v, u] - near) / fade, zero), one)
    for y in range(height):
        v = (top + y) // 2 - first_row
        mine, far, errors = closest[v], body[v], unexplained[top + y, left : left + width]
        sure, cost = trusted[y], away[y]
        for x in range(width):
            four = np.uint64(((left + x) >> 1) - first_column)
            sure[x], cost[x] = mine[four] & (errors[x] >= least), far[four]
    return trusted, away


def trusted_background(
    config: Config, evidence: LayerEvidence, frame_evidence: FrameEvidence, side: int
) -> Array:
    """Find the cells of the frame in which the background may learn, bool.

    Near an object it learns beside its own trajectories only, or where nothing moves against the camera.
    """
    weights, shape = config.posterior, frame_evidence.shape
    scale = length_scale(*shape)
    whole = in_cells(Region(0, 0, shape[1], shape[0]), side)
    trusted = np.ones((whole.height, whole.width), np.bool_)
    end = frame_evidence.tracks_of(evidence.layer).end  # the background is the first of all layers
    own, objects = frame_evidence.positions[:end], frame_evidence.positions[end:]
    # A cell is judged up to this far from the objects, by own trajectories up to this far from it. With
    # distances of 2×2 cells, own trajectories are nearer if they are nearer by at least one such block.
    coarse = 2 * side
    near = in_cells(
        aligned(_surroundings(objects, 2.0 * weights.keep_off_px * scale, shape), coarse, shape), coarse
    )
    rows, columns = (
        slice(2 * near.y, 2 * (near.y + near.height)),
        slice(2 * near.x, 2 * (near.x + near.width)),
    )
    least = 0.0
    if frame_evidence.frame_index > frame_evidence.epoch:
        least = 0.5 * config.layers.unexplained_noise / UNEXPLAINED_STEP
    trusted[rows, columns] = _judged(
        trajectory_distance(own, near, coarse),
        trajectory_distance(objects, near, coarse),
        frame_evidence.unexplained[rows, columns].copy(),
        least,
        np.float32(weights.keep_off_px * scale),
        np.float32(weights.learn_px * scale),
        np.float32(2.0 * scale),
    )
    return trusted


@compiled
def _judged(
    own: Array, others: Array, unexplained: Array, least: float, keep_off: np.float32, learn: np.float32,
    beside: np.float32,
) -> Array:  # fmt: skip
    """Find where the background may learn near objects; a distance is that of a block of four cells."""
    trusted: Array = np.empty(unexplained.shape, np.bool_)
    for y in range(trusted.shape[0]):
        for x in range(trusted.shape[1]):
            other = others[y // 2, x // 2]
            free = other > keep_off or own[y // 2, x // 2] + beside < other
            trusted[y, x] = free or (unexplained[y, x] < least and other > learn)
    return trusted


def _surroundings(positions: Array, margin: float, shape: tuple[int, int]) -> Region:
    """Return the box of some trajectories with a margin, inside the frame."""
    if not len(positions):
        return Region(0, 0, 0, 0)
    return Region(*box_within(*bounds(positions), margin, *shape))
