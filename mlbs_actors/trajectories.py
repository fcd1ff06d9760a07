"""Point trajectories on dense flow: advance, check, re-seed (§3; Sundaram, Brox, Keutzer, ECCV 2010).

Differs from the paper: a point seeded in frame t is at once followed back to frame t−1 by the (checked)
backward flow, so it brings one motion with it and can be compared with its neighbours from its first
frame on; a trajectory remembers a bounded number of motions; and a point is lost, too, where the image
around it is no longer what it was, however well forward and backward flow agree
(``TrajectoriesConfig.most_mismatch``).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from mlbs_actors.compilation import compiled
from mlbs_actors.config import TrajectoriesConfig, length_scale
from mlbs_actors.flow import DenseFlow, sample_flow
from mlbs_actors.messages import Array

__all__ = [
    "TrajectoryState",
    "advance_trajectories",
    "empty_trajectories",
    "evenly_spread",
    "seed_trajectories",
    "selected",
    "with_residuals",
]


#: Share of a trajectory's evidence against the camera that lasts to the next frame.
EVIDENCE_KEPT = np.float32(0.95)
#: Bounds of what one frame adds to it, × the frame's noise: one bad match must not decide for long.
EVIDENCE_BOUNDS = (-2.0, 8.0)
#: Least spacing of seeds, steps of the flow's grid, and where they are dense.
LEAST_SPACING, LEAST_DENSE_SPACING = 3.0, 2.0


@dataclass(frozen=True, slots=True)
class TrajectoryState:
    """The live trajectories.

    Attributes
    ----------
    ids : (n,) int64
        Ascending, never reused.
    positions : (n, 2) float32
        (x, y) in the newest frame, px.
    motions : (n, 2) float32
        Backward motion t → t−1, px.
    residuals : (m, T, 2) float32
        What the camera's own motion leaves of the backward motions, newest first, px. Zero past a
        trajectory's age. Within a frame, until :func:`with_residuals`, those of the frame before.
    rows : (n,) intp
        Whose of the residuals are each trajectory's: by far the most of what is remembered, they are moved
        once a frame. After :func:`with_residuals` 0 … n−1; −1 for one that has none yet.
    ages : (n,) int32
        How many of those motions are known, 0 … T.
    evidence : (n,) float32
        Evidence against the camera: by how much the flow has explained the image around the trajectory better
        than the camera's motion did, summed over its life and slowly forgotten, × the frame's noise.
    next_id : int
    """

    ids: Array
    positions: Array
    motions: Array
    residuals: Array
    rows: Array
    ages: Array
    evidence: Array
    next_id: int

    def __len__(self) -> int:
        return len(self.ids)


def empty_trajectories(config: TrajectoriesConfig) -> TrajectoryState:
    """No trajectory yet."""
    return TrajectoryState(
        np.zeros(0, np.int64),
        np.zeros((0, 2), np.float32),
        np.zeros((0, 2), np.float32),
        np.zeros((0, config.history_frames, 2), np.float32),
        np.zeros(0, np.intp),
        np.zeros(0, np.int32),
        np.zeros(0, np.float32),
        0,
    )


def advance_trajectories(state: TrajectoryState, flow: DenseFlow, shape: tuple[int, int]) -> TrajectoryState:
    """Carry every point into the next frame; drop those that leave or that the flow does not confirm.

    Parameters
    ----------
    state : TrajectoryState
        At frame t−1.
    flow : DenseFlow
        Between t−1 and t.
    shape : (int, int)
        (H, W), px.

    Returns
    -------
    TrajectoryState
        At frame t, but for the residuals (:func:`with_residuals`).
    """
    motion = sample_flow(flow.forward, state.positions, flow.step)
    positions, cell_x, cell_y, inside = _moved(
        state.positions, motion, flow.step, flow.forward.shape[:2], (shape[0], shape[1])
    )
    alive = np.flatnonzero(inside & flow.forward_reliable_at(cell_x, cell_y))
    kept = selected(state, alive)
    return replace(
        kept,
        positions=positions[alive],
        motions=-motion[alive],
        ages=np.minimum(kept.ages + np.int32(1), np.int32(state.residuals.shape[1])),
    )


@compiled()
def _moved(
    positions: Array, motion: Array, step: tuple[float, float], grid: tuple[int, int], shape: tuple[int, int]
) -> tuple[Array, Array, Array, Array]:
    """Where points get to, column and row of the flow's grid they come from, and who stays in the frame."""
    count = positions.shape[0]
    moved, inside = positions + motion, np.empty(count, np.bool_)
    cell_x, cell_y = np.empty(count, np.int64), np.empty(count, np.int64)
    step_x, step_y = np.float32(step[0]), np.float32(step[1])
    for i in range(count):
        cell_x[i] = min(max(int(positions[i, 0] / step_x), 0), grid[1] - 1)
        cell_y[i] = min(max(int(positions[i, 1] / step_y), 0), grid[0] - 1)
        inside[i] = 0 <= moved[i, 0] <= shape[1] - 1 and 0 <= moved[i, 1] <= shape[0] - 1
    return moved, cell_x, cell_y, inside


def selected(state: TrajectoryState, positions: Array) -> TrajectoryState:
    """The trajectories at some positions of the arrays, ascending (n,) intp; the others are lost."""
    ids, places, motions, rows, ages, evidence = _at(
        positions, state.ids, state.positions, state.motions, state.rows, state.ages, state.evidence
    )
    return TrajectoryState(ids, places, motions, state.residuals, rows, ages, evidence, state.next_id)


@compiled()
def _at(
    chosen: Array, ids: Array, positions: Array, motions: Array, rows: Array, ages: Array, evidence: Array
) -> tuple[Array, Array, Array, Array, Array, Array]:
    return ids[chosen], positions[chosen], motions[chosen], rows[chosen], ages[chosen], evidence[chosen]


def seed_trajectories(
    state: TrajectoryState,
    gray: Array,
    flow: DenseFlow | None,
    shape: tuple[int, int],
    config: TrajectoriesConfig,
    dense: Array | None = None,
) -> TrajectoryState:
    """Start trajectories on a grid wherever the image has structure and no live trajectory is near.

    Parameters
    ----------
    state : TrajectoryState
        At frame t.
    gray : (h, w) uint8
        Frame t, shrunk as for the flow.
    flow : DenseFlow or None
        Between t−1 and t; None in the first frame.
    shape : (int, int)
        (H, W) of the full frame.
    config : TrajectoriesConfig
    dense : (h, w) bool, optional
        Where to seed on the dense grid besides.

    Returns
    -------
    TrajectoryState
        With the new trajectories appended, each grid in raster order.

    Notes
    -----
    A seed needs a smaller structure-tensor eigenvalue above mean·(0.1 + exp(−0.1 d)), d the distance to the
    border in px.
    """
    structure = cv2.cornerMinEigenVal(gray, blockSize=5, ksize=3)
    mean = float(structure.mean())
    wanted = np.ones(gray.shape, bool) if flow is None else flow.backward_reliable
    state = _seeded(state, structure, mean, flow, shape, config.seed_spacing_px, LEAST_SPACING, wanted)
    if dense is not None:
        state = _seeded(
            state, structure, mean, flow, shape, config.dense_spacing_px, LEAST_DENSE_SPACING, wanted & dense
        )
    return state


def _seeded(
    state: TrajectoryState,
    structure: Array,
    mean: float,
    flow: DenseFlow | None,
    shape: tuple[int, int],
    spacing_px: float,
    least: float,
    wanted: Array,
) -> TrajectoryState:
    """Seed one grid; nearer than ``least`` px of the shrunk frame the flow cannot tell two points apart."""
    height, width = shape
    step = (width / structure.shape[1], height / structure.shape[0])
    spacing = max(spacing_px * length_scale(height, width), least * max(step))
    grid = (max(1, int(height / spacing)), max(1, int(width / spacing)))
    # A live trajectory covers a disc around it.
    free = _uncovered(state.positions, structure.shape, step, 0.75 * spacing / (0.5 * (step[0] + step[1])))
    points = _grid_seeds(structure, mean, wanted, free, shape, step, grid)
    age, back = 0, np.zeros_like(points)
    if flow is not None:
        age, back = 1, sample_flow(flow.backward, points, flow.step)
    return TrajectoryState(
        np.concatenate([state.ids, state.next_id + np.arange(len(points), dtype=np.int64)]),
        np.concatenate([state.positions, points]),
        np.concatenate([state.motions, back]),
        state.residuals,
        np.concatenate([state.rows, np.full(len(points), -1, np.intp)]),
        np.concatenate([state.ages, np.full(len(points), age, np.int32)]),
        np.concatenate([state.evidence, np.zeros(len(points), np.float32)]),
        state.next_id + len(points),
    )


@compiled()
def _uncovered(positions: Array, shape: tuple[int, int], step: tuple[float, float], radius: float) -> Array:
    """Pixels of the shrunk frame at least so many of its px from every point's, (h, w) bool."""
    height, width = shape
    free = np.ones((height, width), np.bool_)
    reach = int(np.ceil(radius)) - 1  # a pixel at the very radius is free
    half_width = np.empty(reach + 1, np.int64)
    for v in range(reach + 1):
        half_width[v] = int(np.ceil(np.sqrt(radius * radius - v * v))) - 1
    for point in range(positions.shape[0]):
        x = min(max(int(positions[point, 0] / step[0]), 0), width - 1)
        y = min(max(int(positions[point, 1] / step[1]), 0), height - 1)
        for v in range(max(y - reach, 0), min(y + reach, height - 1) + 1):
            across = half_width[abs(v - y)]
            for u in range(max(x - across, 0), min(x + across, width - 1) + 1):
                free[v, u] = False
    return free


@compiled()
def _grid_seeds(
    structure: Array,
    mean: float,
    wanted: Array,
    free: Array,
    shape: tuple[int, int],
    step: tuple[float, float],
    grid: tuple[int, int],
) -> Array:
    """The points of a grid in raster order that are wanted, free and structured, (n, 2) float32."""
    height, width = shape
    rows, columns = grid
    points = np.empty((rows * columns, 2), np.float32)
    count = 0
    for row in range(rows):
        y = np.float32((row + 0.5) * height / rows)
        v = min(int(y / step[1]), wanted.shape[0] - 1)
        for column in range(columns):
            x = np.float32((column + 0.5) * width / columns)
            u = min(int(x / step[0]), wanted.shape[1] - 1)
            if not (wanted[v, u] and free[v, u]):
                continue
            border = min(min(x, y), min(width - 1 - x, height - 1 - y))
            if structure[v, u] > mean * (0.1 + np.exp(-0.1 * border)):
                points[count, 0], points[count, 1] = x, y
                count += 1
    return points[:count].copy()


def evenly_spread(positions: Array, spacing: float) -> Array:
    """Pick at most one point a square, so that every part of the frame has the same say.

    Where trajectories are dense, on objects, they would outvote the background.

    Parameters
    ----------
    positions : (n, 2) float32
        px.
    spacing : float
        Side of a square, px.

    Returns
    -------
    (m,) intp
        Ascending positions in the array; of each square the first.
    """
    if len(positions) == 0:
        return np.zeros(0, np.intp)
    return np.asarray(_first_of_each(positions, np.float32(spacing)))


@compiled()
def _first_of_each(positions: Array, spacing: np.float32) -> Array:
    """Positions in the array of the first point of each square."""
    column, row = np.empty(len(positions), np.int64), np.empty(len(positions), np.int64)
    for point in range(len(positions)):
        column[point] = int(np.floor(positions[point, 0] / spacing))
        row[point] = int(np.floor(positions[point, 1] / spacing))
    left, top = column.min(), row.min()
    taken = np.zeros((column.max() - left + 1, row.max() - top + 1), np.bool_)
    first = np.empty(len(positions), np.intp)
    found = 0
    for point in range(len(positions)):
        square = column[point] - left, row[point] - top
        if not taken[square]:
            taken[square] = True
            first[found] = point
            found += 1
    return first[:found]


def with_residuals(state: TrajectoryState, predicted: Array, advantage: Array) -> TrajectoryState:
    """Fill in what the camera's own motion leaves of the newest motions and images.

    Parameters
    ----------
    state : TrajectoryState
    predicted : (n, 2) float32
        Backward motion of a background point at each trajectory, px.
    advantage : (n,) float32
        :class:`~mlbs_actors.camera.CameraEvidence` at each trajectory, × the frame's noise.
    """
    evidence = EVIDENCE_KEPT * state.evidence + np.clip(advantage, *EVIDENCE_BOUNDS).astype(np.float32)
    residuals = _remembered(state.residuals, state.rows, state.ages, state.motions, predicted)
    return replace(state, residuals=residuals, rows=np.arange(len(state)), evidence=evidence)


@compiled()
def _remembered(residuals: Array, rows: Array, ages: Array, motions: Array, predicted: Array) -> Array:
    """The newest residuals, 0 of those without a motion, and those before, one frame older."""
    moved = np.empty((rows.size, *residuals.shape[1:]), np.float32)
    for trajectory in range(rows.size):
        for axis in range(2):
            known = motions[trajectory, axis] - predicted[trajectory, axis]
            moved[trajectory, 0, axis] = known if ages[trajectory] > 0 else np.float32(0)
        row = rows[trajectory]
        if row < 0:
            moved[trajectory, 1:] = 0
        else:
            moved[trajectory, 1:] = residuals[row, :-1]
    return moved
