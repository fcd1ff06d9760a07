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
    (height, width), scale = shape, length_scale(*shape)
    step = (width / gray.shape[1], height / gray.shape[0])
    structure = cv2.cornerMinEigenVal(gray, blockSize=5, ksize=3)
    wanted = np.ones(gray.shape, bool) if flow is None else flow.backward_reliable
    # Nearer than the least spacing the flow cannot tell two points apart.
    spacings = (
        max(config.seed_spacing_px * scale, LEAST_SPACING * max(step)),
        max(config.dense_spacing_px * scale, LEAST_DENSE_SPACING * max(step)),
    )
    seeds = _seeds(
        state.positions, structure, float(structure.mean()), wanted,
        np.zeros(gray.shape, bool) if dense is None else dense, (height, width), step, spacings,
    )  # fmt: skip
    motions = np.zeros_like(seeds) if flow is None else sample_flow(flow.backward, seeds, flow.step)
    return TrajectoryState(
        *_joined(state.ids, state.positions, state.motions, seeds, motions, state.next_id),
        state.residuals,
        *_begun(state.rows, state.ages, state.evidence, len(seeds), 0 if flow is None else 1),
        state.next_id + len(seeds),
    )


@compiled()
def _joined(
    ids: Array, positions: Array, motions: Array, seeds: Array, seed_motions: Array, next_id: int
) -> tuple[Array, Array, Array]:
    """Ids, positions and motions of trajectories and of those that begin."""
    begun = next_id + np.arange(len(seeds))
    return (
        np.concatenate((ids, begun)),
        np.concatenate((positions, seeds)),
        np.concatenate((motions, seed_motions)),
    )


@compiled()
def _begun(rows: Array, ages: Array, evidence: Array, count: int, age: int) -> tuple[Array, Array, Array]:
    """Rows, ages and evidence of trajectories and of as many that begin."""
    return (
        np.concatenate((rows, np.full(count, -1, np.intp))),
        np.concatenate((ages, np.full(count, age, np.int32))),
        np.concatenate((evidence, np.zeros(count, np.float32))),
    )


@compiled()
def _seeds(
    positions: Array,
    structure: Array,
    mean: float,
    wanted: Array,
    dense: Array,
    shape: tuple[int, int],
    step: tuple[float, float],
    spacings: tuple[float, float],
) -> Array:
    """The seeds of the grid and of the dense one, (n, 2) float32."""
    taken = np.zeros(structure.shape, np.bool_)
    _take(taken, positions, step)
    seeds = _grid_seeds(structure, mean, wanted, wanted, taken, shape, step, spacings[0])
    _take(taken, seeds, step)
    return np.concatenate(
        (seeds, _grid_seeds(structure, mean, wanted, dense, taken, shape, step, spacings[1]))
    )


@compiled()
def _take(taken: Array, positions: Array, step: tuple[float, float]) -> None:
    """Mark the pixels of the shrunk frame where points are."""
    for point in range(positions.shape[0]):
        x = min(max(int(positions[point, 0] / step[0]), 0), taken.shape[1] - 1)
        y = min(max(int(positions[point, 1] / step[1]), 0), taken.shape[0] - 1)
        taken[y, x] = True


@compiled()
def _grid_seeds(
    structure: Array,
    mean: float,
    wanted: Array,
    besides: Array,
    taken: Array,
    shape: tuple[int, int],
    step: tuple[float, float],
    spacing: float,
) -> Array:
    """The points of a grid in raster order that are wanted, structured and free, (n, 2) float32."""
    height, width = shape
    rows, columns = max(1, int(height / spacing)), max(1, int(width / spacing))
    # A trajectory covers a disc around it; a pixel at its very radius is free.
    radius = 0.75 * spacing / (0.5 * (step[0] + step[1]))
    half_width = np.empty(int(np.ceil(radius)), np.int64)
    for away in range(half_width.size):
        half_width[away] = int(np.ceil(np.sqrt(radius * radius - away * away))) - 1
    points = np.empty((rows * columns, 2), np.float32)
    count = 0
    for row in range(rows):
        y = np.float32((row + 0.5) * height / rows)
        v = min(int(y / step[1]), wanted.shape[0] - 1)
        for column in range(columns):
            x = np.float32((column + 0.5) * width / columns)
            u = min(int(x / step[0]), wanted.shape[1] - 1)
            if not (wanted[v, u] and besides[v, u]):
                continue
            border = min(min(x, y), min(width - 1 - x, height - 1 - y))
            structured = structure[v, u] > mean * (0.1 + np.exp(-0.1 * border))
            if structured and not _covered(taken, v, u, half_width):
                points[count, 0], points[count, 1] = x, y
                count += 1
    return points[:count].copy()


@compiled()
def _covered(taken: Array, y: int, x: int, half_width: Array) -> bool:
    """Whether a point is so near to a pixel, by half the width of the disc's rows."""
    reach = half_width.size - 1
    for v in range(max(y - reach, 0), min(y + reach, taken.shape[0] - 1) + 1):
        across = half_width[abs(v - y)]
        for u in range(max(x - across, 0), min(x + across, taken.shape[1] - 1) + 1):
            if taken[v, u]:
                return True
    return False


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
    length = 2 * residuals.shape[1]
    moved, old = np.empty((rows.size, length), np.float32), residuals.reshape(residuals.shape[0], length)
    for trajectory in range(rows.size):
        one, row = moved[trajectory], rows[trajectory]
        for axis in range(2):
            known = motions[trajectory, axis] - predicted[trajectory, axis]
            one[axis] = known if ages[trajectory] > 0 else np.float32(0)
        if row < 0:
            one[2:] = 0
        else:
            before = old[row]
            for place in range(length - 2):
                one[place + 2] = before[place]
    return moved.reshape(rows.size, residuals.shape[1], 2)
