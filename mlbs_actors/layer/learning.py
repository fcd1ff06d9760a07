"""Where a layer may learn the colours that it won, and how far an object reaches from its trajectories (§6).

A pixel that is labelled wrongly once, and learnt, would be taken for the layer's own ever after; so only
cells are learnt whose label is sure. Not in the paper.
"""

from __future__ import annotations

import cv2
import numpy as np

from mlbs_actors.appearance.cells import aligned, in_cells
from mlbs_actors.config import Config, length_scale
from mlbs_actors.kernels.jit import compiled
from mlbs_actors.layer.object_regions import bounds, box_within
from mlbs_actors.layer.trajectory_distance import (
    closed_distance,
    occupied_cells,
    occupy,
    to_occupied,
    trajectory_distance,
)
from mlbs_actors.messages import UNEXPLAINED_STEP, Array, FrameEvidence, LayerEvidence, Region

__all__ = ["near_trajectories", "trusted_background", "unexplained_cells"]


@compiled
def near_trajectories(
    positions: Array, start: int, end: int, side: int, left: int, top: int, unexplained: Array, least: float,
    close: np.float32, learn: np.float32, near: np.float32, fade: np.float32, trusted: Array, away: Array,
) -> None:  # fmt: skip
    """Cells in which an object may learn, and their cost in [0, 1] away from its trajectories.

    What is labelled wrongly near an outline must not be learnt: an object learns close to its own
    trajectories, where the camera's motion fails to explain the image.

    Parameters
    ----------
    positions : (n, 2) float32
        Of all layers' trajectories, px; the object's are those from ``start`` to ``end``.
    start, end, side, left, top : int
        Side of a cell, px, and where the object's cells begin.
    unexplained : (rows, columns) uint8
        :func:`unexplained_cells` of the whole frame.
    least : float
        What of it counts as a failure.
    close, learn, near, fade : float32
        Lengths of :class:`~mlbs_actors.config.PosteriorConfig`, px of this frame.
    trusted : (h, w) bool
    away : (h, w) float32
        Room for the two results.
    """
    height, width = trusted.shape
    # Distances are told for 2×2 cells of the frame at once.
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


def trusted_background(
    config: Config, evidence: LayerEvidence, frame_evidence: FrameEvidence, side: int
) -> Array:
    """Cells of the frame in which the background may learn, bool.

    Near an object it learns beside its own trajectories only, or where nothing moves against the camera.
    """
    weights, shape = config.posterior, frame_evidence.shape
    scale = length_scale(*shape)
    whole = in_cells(Region(0, 0, shape[1], shape[0]), side)
    trusted = np.ones((whole.height, whole.width), np.bool_)
    end = frame_evidence.tracks_of(evidence.layer).end  # the background is the first of all layers
    own, objects = frame_evidence.positions[:end], frame_evidence.positions[end:]
    # A cell is judged up to this far from the objects, by own trajectories up to this far from it. Distances
    # are told for 2×2 cells at once: the lead of own trajectories is then "in a nearer one of these".
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
        unexplained_cells(frame_evidence, side)[rows, columns].copy(),
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
    """Where the background may learn near objects; the distances are of four cells each."""
    trusted: Array = np.empty(unexplained.shape, np.bool_)
    for y in range(trusted.shape[0]):
        for x in range(trusted.shape[1]):
            other = others[y // 2, x // 2]
            free = other > keep_off or own[y // 2, x // 2] + beside < other
            trusted[y, x] = free or (unexplained[y, x] < least and other > learn)
    return trusted


def _surroundings(positions: Array, margin: float, shape: tuple[int, int]) -> Region:
    """Box of some trajectories with a margin, inside the frame."""
    if not len(positions):
        return Region(0, 0, 0, 0)
    return Region(*box_within(*bounds(positions), margin, *shape))


def unexplained_cells(evidence: FrameEvidence, side: int) -> Array:
    """How badly the camera's motion explains the image, at the frame's cells of this side, uint8; to read."""
    height, width = evidence.shape
    grid = (-(-height // side), -(-width // side))
    if evidence.unexplained.shape == grid:
        return evidence.unexplained
    resized = cv2.resize(evidence.unexplained, grid[::-1])
    resized.setflags(write=False)  # as what is received: for Numba others are of another type
    return resized
