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
from mlbs_actors.flow import DenseFlow, reliable_at
from mlbs_actors.messages import Array
from mlbs_actors.sampling import sample_flow

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
#: A square of that grid with this side takes so many trajectories, about half of what the dense grid has in
#: it: of a large mover fewer tell as much, and a small one reaches into several squares.
SQUARE, MOST_IN_SQUARE = 8, 7


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


def advance_trajectories(
    state: TrajectoryState, flow: DenseFlow, shape: tuple[int, int]
) -> tuple[TrajectoryState, Array]:
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
    (m,) intp
        Where those that live on stood in the arrays of frame t−1, ascending.
    """
    survivors, ids, positions, motions, rows, ages, evidence = _advanced(
        state.ids, state.positions, state.rows, state.ages, state.evidence, state.residuals.shape[1],
        flow.forward, flow.backward, flow.step, flow.thresholds, shape,
    )  # fmt: skip
    advanced = TrajectoryState(ids, positions, motions, state.residuals, rows, ages, evidence, state.next_id)
    return advanced, survivors


@compiled()
def _advanced(
    ids: Array, positions: Array, rows: Array, ages: Array, evidence: Array, most_age: int,
    forward: Array, backward: Array, step: tuple[float, float], checks: tuple[float, ...],
    shape: tuple[int, int],
) -> tuple[Array, Array, Array, Array, Array, Array, Array]:  # fmt: skip
    """Which points live on, and their ids, places, backward motions, rows, ages and evidence."""
    count, step_x, step_y = len(positions), np.float32(step[0]), np.float32(step[1])
    motion = sample_flow(forward, positions, step)
    cell_x, cell_y = np.empty(count, np.int64), np.empty(count, np.int64)
    for i in range(count):
        cell_x[i] = min(max(int(positions[i, 0] / step_x), 0), forward.shape[1] - 1)
        cell_y[i] = min(max(int(positions[i, 1] / step_y), 0), forward.shape[0] - 1)
    reliable = reliable_at(forward, backward, step[0], step[1], checks, cell_x, cell_y)
    moved, survivors, alive = positions + motion, np.empty(count, np.intp), 0
    for i in range(count):
        inside = 0 <= moved[i, 0] <= shape[1] - 1 and 0 <= moved[i, 1] <= shape[0] - 1
        if inside and reliable[i]:
            survivors[alive] = i
            alive += 1
    survivors = survivors[:alive]
    older = np.minimum(ages[survivors] + 1, most_age).astype(np.int32)
    return (
        survivors, ids[survivors], moved[survivors], -motion[survivors], rows[survivors], older,
        evidence[survivors],
    )  # fmt: skip


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
    advantage: Array | None = None,
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
    advantage : (h, w) float32, optional
        Of :class:`~mlbs_actors.camera.CameraEvidence`, × noise: where it is large, small movers need more
        points than the grid gives them, and there are seeds on a dense grid besides.

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
    # Nearer than the least spacing the flow cannot tell two points apart.
    spacings = (
        max(config.seed_spacing_px * scale, LEAST_SPACING * max(step)),
        max(config.dense_spacing_px * scale, LEAST_DENSE_SPACING * max(step)),
    )
    ids, positions, motions, rows, ages, evidence = _seeded(
        state.ids, state.positions, state.motions, state.rows, state.ages, state.evidence, state.next_id,
        structure, float(structure.mean()),
        np.ones(gray.shape, bool) if flow is None else flow.backward_reliable,
        np.zeros(gray.shape, np.float32) if advantage is None else advantage, config.dense_advantage,
        np.zeros((*gray.shape, 2), np.float32) if flow is None else flow.backward, flow is not None,
        (height, width), step, spacings,
    )  # fmt: skip
    next_id = state.next_id + len(ids) - len(state)
    return TrajectoryState(ids, positions, motions, state.residuals, rows, ages, evidence, next_id)


@compiled()
def _seeded(
    ids: Array, positions: Array, motions: Array, rows: Array, ages: Array, evidence: Array, next_id: int,
    structure: Array, mean: float, wanted: Array, advantage: Array, least_advantage: float, backward: Array,
    age: int, shape: tuple[int, int], step: tuple[float, float], spacings: tuple[float, float],
) -> tuple[Array, Array, Array, Array, Array, Array]:  # fmt: skip
    """Ids, positions, motions, rows, ages and evidence of trajectories, and of those that begin."""
    seeds = _seeds(positions, structure, mean, wanted, advantage, least_advantage, shape, step, spacings)
    count = len(seeds)
    return (
        np.concatenate((ids, next_id + np.arange(count))),
        np.concatenate((positions, seeds)),
        np.concatenate((motions, sample_flow(backward, seeds, step))),
        np.concatenate((rows, np.full(count, -1, np.intp))),
        np.concatenate((ages, np.full(count, age, np.int32))),
        np.concatenate((evidence, np.zeros(count, np.float32))),
    )


@compiled()
def _seeds(
    positions: Array, structure: Array, mean: float, wanted: Array, advantage: Array, least_advantage: float,
    shape: tuple[int, int], step: tuple[float, float], spacings: tuple[float, float],
) -> Array:  # fmt: skip
    """The seeds of the grid and of the dense one, (n, 2) float32."""
    taken, room = np.zeros(structure.shape, np.bool_), _room(structure.shape, positions, step)
    _take(taken, positions, step)
    seeds = _grid_seeds(structure, mean, wanted, advantage, -np.inf, taken, room, shape, step, spacings[0])
    _take(taken, seeds, step)
    more = _grid_seeds(
        structure, mean, wanted, advantage, least_advantage, taken, room, shape, step, spacings[1]
    )
    return np.concatenate((seeds, more))


@compiled()
def _room(shape: tuple[int, int], positions: Array, step: tuple[float, float]) -> Array:
    """How many more trajectories each square of the shrunk frame takes."""
    room = np.full((-(-shape[0] // SQUARE), -(-shape[1] // SQUARE)), MOST_IN_SQUARE)
    for point in range(positions.shape[0]):
        y, x = _pixel(positions, point, shape, step)
        room[y // SQUARE, x // SQUARE] -= 1
    return room


@compiled()
def _take(taken: Array, positions: Array, step: tuple[float, float]) -> None:
    """Mark the pixels of the shrunk frame where points are."""
    for point in range(positions.shape[0]):
        taken[_pixel(positions, point, taken.shape, step)] = True


@compiled(inline="always")
def _pixel(
    positions: Array, point: int, shape: tuple[int, int], step: tuple[float, float]
) -> tuple[int, int]:
    """Row and column of the pixel of the shrunk frame where a point is, or the nearest."""
    x = min(max(int(positions[point, 0] / step[0]), 0), shape[1] - 1)
    y = min(max(int(positions[point, 1] / step[1]), 0), shape[0] - 1)
    return y, x


@compiled()
def _grid_seeds(
    structure: Array,
    mean: float,
    wanted: Array,
    advantage: Array,
    least_advantage: float,
    taken: Array,
    room: Array,
    shape: tuple[int, int],
    step: tuple[float, float],
    spacing: float,
) -> Array:
    """The points of a grid in raster order that are wanted, structured and free, (n, 2) float32.

    Each takes some of its square's room.
    """
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
            square = v // SQUARE, u // SQUARE
            if not (wanted[v, u] and advantage[v, u] > least_advantage and room[square] > 0):
                continue
            border = min(min(x, y), min(width - 1 - x, height - 1 - y))
            structured = structure[v, u] > mean * (0.1 + np.exp(-0.1 * border))
            if structured and not _covered(taken, v, u, half_width):
                points[count, 0], points[count, 1] = x, y
                count += 1
                room[square] -= 1
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


@compiled()
def evenly_spread(positions: Array, chosen: Array, spacing: float) -> Array:
    """Pick at most one point a square, so that every part of the frame has the same say.

    Where trajectories are dense, on objects, they would outvote the background.

    Parameters
    ----------
    positions : (n, 2) float32
        px.
    chosen : (n,) bool
        Which of them may be picked.
    spacing : float
        Side of a square, px.

    Returns
    -------
    (m,) intp
        Ascending positions in the array; of each square the first.
    """
    candidates, side = np.flatnonzero(chosen), np.float32(spacing)
    if candidates.size == 0:
        return candidates
    column, row = np.empty(candidates.size, np.int64), np.empty(candidates.size, np.int64)
    for place, point in enumerate(candidates):
        column[place] = int(np.floor(positions[point, 0] / side))
        row[place] = int(np.floor(positions[point, 1] / side))
    left, top = column.min(), row.min()
    taken = np.zeros((column.max() - left + 1, row.max() - top + 1), np.bool_)
    first, found = np.empty(candidates.size, np.intp), 0
    for place, point in enumerate(candidates):
        square = column[place] - left, row[place] - top
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
    residuals, evidence = _remembered(
        state.residuals, state.rows, state.ages, state.motions, predicted, state.evidence, advantage
    )
    return replace(state, residuals=residuals, rows=np.arange(len(state)), evidence=evidence)


@compiled()
def _remembered(
    residuals: Array, rows: Array, ages: Array, motions: Array, predicted: Array, evidence: Array,
    advantage: Array,
) -> tuple[Array, Array]:  # fmt: skip
    """The newest residuals, 0 of those without a motion, and those before, one frame older; the evidence."""
    least, most = np.float32(EVIDENCE_BOUNDS[0]), np.float32(EVIDENCE_BOUNDS[1])
    summed = np.empty(rows.size, np.float32)
    for trajectory in range(rows.size):
        summed[trajectory] = EVIDENCE_KEPT * evidence[trajectory] + min(
            max(np.float32(advantage[trajectory]), least), most
        )
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
    return moved.reshape(rows.size, residuals.shape[1], 2), summed
