"""Where trajectories begin: a grid of seeds wherever no live one is near (§3).

Differs from the paper: a point seeded in frame t is at once followed back to frame t−1 by the (checked)
backward flow, so it has one motion and can be compared with its neighbours from its first frame on; where the
flow explains the image better than the camera's motion the grid is denser; and where many trajectories are
already there, no more begin (:mod:`mlbs_actors.tracking.density`).
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from mlbs_actors.config import TrajectoriesConfig, detail, length_scale
from mlbs_actors.flow.consistency import DenseFlow
from mlbs_actors.geometry.interpolation import sample_flow
from mlbs_actors.kernels.jit import compiled
from mlbs_actors.messages import Array
from mlbs_actors.tracking.density import SQUARE, cell_of, room_left
from mlbs_actors.tracking.trajectories import TrajectoryState

__all__ = ["seed_trajectories"]

#: Least share of a frame that has structure enough for seeds.
LEAST_STRUCTURED = 0.3
#: In a large frame the dense grid asks for less evidence, by this power of the frame's detail: a small thing
#: fills little of the window over which the evidence is a mean, and its texture is fine.
FAINTER = 4


def seed_trajectories(
    state: TrajectoryState,
    gray: Array,
    flow: DenseFlow | None,
    shape: tuple[int, int],
    side: int,
    config: TrajectoriesConfig,
    advantage: Array | None = None,
    fixed: Array | None = None,
) -> TrajectoryState:
    """Start trajectories on a grid wherever the image has structure and no live trajectory is near.

    Parameters
    ----------
    state : TrajectoryState
        At frame t.
    gray : (h, w) uint8
        Frame t as the flow sees it.
    flow : DenseFlow or None
        Between t−1 and t; None in the first frame.
    shape : (int, int)
        (H, W) of the frame.
    side : int
        Of a cell, px.
    advantage : (h, w) float32, optional
        Of :class:`~mlbs_actors.tracking.camera.CameraEvidence`, × noise: where it is large, small movers need
        more points than the grid has, so a dense grid is used, too.
    fixed : (h, w) bool, optional
        Where nothing begins (:mod:`mlbs_actors.footage.fixed`).

    Returns
    -------
    TrajectoryState
        With the new trajectories appended, each grid in raster order.

    Notes
    -----
    A seed needs a smaller structure-tensor eigenvalue above mean·(0.1 + exp(−0.1 d)), d the distance to the
    border in px. Bright text in a faint scene has nearly all of the structure: where less than
    ``LEAST_STRUCTURED`` of the frame would be above 0.1 of the mean, so much of it is.
    """
    (height, width), scale = shape, length_scale(*shape)
    structure = cv2.cornerMinEigenVal(gray, blockSize=5, ksize=3)
    reliable = np.ones(gray.shape, bool) if flow is None else flow.backward_reliable
    if fixed is not None and fixed.any():
        structure[fixed], reliable = 0.0, reliable & ~fixed
    mean = float(structure.mean())
    if (structure > 0.1 * mean).mean() < LEAST_STRUCTURED:
        mean = 10.0 * float(np.quantile(structure, 1.0 - LEAST_STRUCTURED))
    ground = _Ground(
        structure,
        mean,
        reliable,
        np.zeros(gray.shape, np.float32) if advantage is None else advantage,
        side,
        config.square_tracks,
    )
    # Closer than the least spacing the flow cannot separate two points.
    spacings = (
        max(config.seed_spacing_px * scale, config.least_spacing_cells * side),
        max(config.dense_spacing_px * scale, config.least_dense_spacing_cells * side),
    )
    least_advantage = config.dense_advantage / detail(height, width) ** FAINTER
    seeds = _seeds(state.positions, ground, least_advantage, (height, width), spacings)
    count = len(seeds)
    motions = np.zeros((count, 2), np.float32) if flow is None else sample_flow(flow.backward, seeds, side)
    return TrajectoryState(
        ids=np.concatenate((state.ids, state.next_id + np.arange(count))),
        positions=np.concatenate((state.positions, seeds)),
        motions=np.concatenate((state.motions, motions)),
        residuals=state.residuals,
        rows=np.concatenate((state.rows, np.full(count, -1, np.intp))),
        ages=np.concatenate((state.ages, np.full(count, flow is not None, np.int32))),
        evidence=np.concatenate((state.evidence, np.zeros(count, np.float32))),
        next_id=state.next_id + count,
    )


class _Ground(NamedTuple):
    """Where seeds can be.

    Attributes
    ----------
    structure : (h, w) float32
        Smaller eigenvalue of the structure tensor of each cell.
    mean : float
        Its mean.
    reliable : (h, w) bool
        Cells with flow to follow.
    advantage : (h, w) float32
    side : int
        Of a cell, px.
    most : int
        Trajectories in a square.
    """

    structure: Array
    mean: float
    reliable: Array
    advantage: Array
    side: int
    most: int


@compiled
def _seeds(
    positions: Array, ground: _Ground, dense_advantage: float, shape: tuple[int, int],
    spacings: tuple[float, float],
) -> Array:  # fmt: skip
    """Return the seeds of the grid and of the dense one, (n, 2) float32."""
    taken = np.zeros(ground.structure.shape, np.bool_)
    room = room_left(positions, ground.structure.shape, ground.side, ground.most)
    _take(taken, positions, ground.side)
    seeds = _grid_seeds(ground, -np.inf, taken, room, shape, spacings[0])
    _take(taken, seeds, ground.side)
    more = _grid_seeds(ground, dense_advantage, taken, room, shape, spacings[1])
    return np.concatenate((seeds, more))


@compiled
def _take(taken: Array, positions: Array, side: int) -> None:
    """Mark the cells where points are."""
    for point in range(positions.shape[0]):
        taken[cell_of(positions, point, taken.shape, side)] = True


@compiled
def _grid_seeds(
    ground: _Ground, least_advantage: float, taken: Array, room: Array, shape: tuple[int, int], spacing: float
) -> Array:
    """Return the points of a grid that are reliable, structured and free, (n, 2) float32, in raster order.

    Each uses up room in its square.
    """
    height, width = shape
    rows, columns = max(1, int(height / spacing)), max(1, int(width / spacing))
    # A trajectory covers a disc around it; a cell exactly at its radius is free.
    radius = 0.75 * spacing / ground.side
    half_width = np.empty(int(np.ceil(radius)), np.int64)
    for away in range(half_width.size):
        half_width[away] = int(np.ceil(np.sqrt(radius * radius - away * away))) - 1
    points = np.empty((rows * columns, 2), np.float32)
    count = 0
    for row in range(rows):
        y = np.float32((row + 0.5) * height / rows)
        v = min(int(y / ground.side), taken.shape[0] - 1)
        for column in range(columns):
            x = np.float32((column + 0.5) * width / columns)
            u = min(int(x / ground.side), taken.shape[1] - 1)
            square = v // SQUARE, u // SQUARE
            wanted = ground.reliable[v, u] and ground.advantage[v, u] > least_advantage
            if not wanted or room[square] <= 0:
                continue
            border = min(min(x, y), min(width - 1 - x, height - 1 - y))
            structured = ground.structure[v, u] > ground.mean * (0.1 + np.exp(-0.1 * border))
            if structured and not _covered(taken, v, u, half_width):
                points[count, 0], points[count, 1] = x, y
                count += 1
                room[square] -= 1
    return points[:count].copy()


@compiled
def _covered(taken: Array, y: int, x: int, half_width: Array) -> bool:
    """Whether a point is near enough to a cell, by half the width of the disc's rows."""
    reach = half_width.size - 1
    for v in range(max(y - reach, 0), min(y + reach, taken.shape[0] - 1) + 1):
        across = half_width[abs(v - y)]
        for u in range(max(x - across, 0), min(x + across, taken.shape[1] - 1) + 1):
            if taken[v, u]:
                return True
    return False
