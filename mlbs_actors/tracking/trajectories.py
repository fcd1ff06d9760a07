"""Point trajectories on dense flow: advance and check (§3; Sundaram, Brox, Keutzer, ECCV 2010).

Differs from the paper: a trajectory keeps a bounded number of motions; and a point is lost, too, where the
image around it has changed, however well forward and backward flow agree
(``TrajectoriesConfig.most_mismatch``).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from mlbs_actors.config import TrajectoriesConfig
from mlbs_actors.errors import FrameError
from mlbs_actors.flow.consistency import DenseFlow, reliable_at
from mlbs_actors.geometry.interpolation import sample_flow
from mlbs_actors.kernels.jit import compiled
from mlbs_actors.messages import Array
from mlbs_actors.wording import described

__all__ = [
    "TrackFunction",
    "TrajectoryState",
    "advance_trajectories",
    "empty_trajectories",
    "evenly_spread",
    "follow_trajectories",
    "selected",
    "with_residuals",
]

#: Follows points from one frame to another, both (H, W, 3) uint8 BGR. The third argument is where they are in
#: the first, (n, 2) float32, (x, y) in px. Returns where they are in the second, (n, 2) float, and which of
#: them are seen there, (n,) bool.
TrackFunction = Callable[[Array, Array, Array], tuple[Array, Array]]


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
        Backward motions less the camera's own motion, newest first, px. Zero past a trajectory's age. Within
        a frame, until :func:`with_residuals`, those of the frame before.
    rows : (n,) intp
        Row of ``residuals`` that is each trajectory's: that array is by far the largest and is moved once a
        frame. After :func:`with_residuals` 0 … n−1; −1 for one that has none yet.
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
    """Return the state without any trajectory."""
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
        Indices of the survivors in the arrays of frame t−1, ascending.
    """
    survivors, positions, motions = _carried(
        state.positions, flow.forward, flow.backward, flow.side, flow.thresholds, shape
    )
    return _advanced(state, survivors, positions, motions), survivors


def follow_trajectories(
    state: TrajectoryState, function: TrackFunction, previous: Array, current: Array
) -> tuple[TrajectoryState, Array]:
    """Have a function carry every point into the next frame; drop those that it loses or that leave.

    Parameters
    ----------
    state : TrajectoryState
        At frame t−1.
    function : TrackFunction
    previous, current : (H, W, 3) uint8
        Frames t−1 and t, BGR.

    Returns
    -------
    TrajectoryState, (m,) intp
        As of :func:`advance_trajectories`.

    Raises
    ------
    FrameError
        If the function does not return places and a mask.
    """
    count = len(state)
    if count == 0:
        return state, np.zeros(0, np.intp)
    places, seen = _places_and_mask(function(previous, current, state.positions.copy()), count)
    if places.shape != (count, 2) or not np.issubdtype(places.dtype, np.floating):
        raise FrameError(
            f"The tracks function returned places {places.shape} {places.dtype}; it must return that of each "
            f"of the points, {(count, 2)} float32, px."
        )
    if seen.shape != (count,) or seen.dtype != bool:
        raise FrameError(
            f"The tracks function returned a mask {seen.shape} {seen.dtype}; it must return which of the "
            f"points are seen in the second frame, {(count,)} bool."
        )
    if not np.isfinite(places[seen]).all():
        raise FrameError("The tracks function returned NaN or infinite places of points that it sees.")
    height, width = current.shape[:2]
    with np.errstate(invalid="ignore"):  # those that are not seen may be NaN
        inside = (places >= 0).all(axis=1) & (places <= (width - 1, height - 1)).all(axis=1)
    survivors = np.flatnonzero(seen & inside)
    positions = places[survivors].astype(np.float32)
    return _advanced(state, survivors, positions, state.positions[survivors] - positions), survivors


def _places_and_mask(returned: object, count: int) -> tuple[Array, Array]:
    """Take what a function has returned apart."""
    if isinstance(returned, (tuple, list)) and len(returned) == 2:
        try:
            return np.asarray(returned[0]), np.asarray(returned[1])
        except (TypeError, ValueError, RuntimeError):  # lists of several lengths, a tensor on another device
            pass
    raise FrameError(
        f"The tracks function returned {described(returned)}; it must return two arrays: the place of each "
        f"of the points in the second frame, {(count, 2)} float32, px, and which of them are seen there, "
        f"{(count,)} bool."
    )


def _advanced(state: TrajectoryState, survivors: Array, positions: Array, motions: Array) -> TrajectoryState:
    """Return the survivors one frame on, but for their residuals."""
    ages = np.minimum(state.ages[survivors] + 1, state.residuals.shape[1]).astype(np.int32)
    return TrajectoryState(
        state.ids[survivors], positions, motions, state.residuals, state.rows[survivors], ages,
        state.evidence[survivors], state.next_id,
    )  # fmt: skip


@compiled
def _carried(
    positions: Array, forward: Array, backward: Array, side: int, checks: tuple[float, ...],
    shape: tuple[int, int],
) -> tuple[Array, Array, Array]:  # fmt: skip
    """Return which points live on, with their places and backward motions."""
    count, step = len(positions), np.float32(side)
    motion = sample_flow(forward, positions, side)
    cell_x, cell_y = np.empty(count, np.int64), np.empty(count, np.int64)
    for i in range(count):
        cell_x[i] = min(max(int(positions[i, 0] / step), 0), forward.shape[1] - 1)
        cell_y[i] = min(max(int(positions[i, 1] / step), 0), forward.shape[0] - 1)
    reliable = reliable_at(forward, backward, side, checks, cell_x, cell_y)
    moved, survivors, alive = positions + motion, np.empty(count, np.intp), 0
    for i in range(count):
        inside = 0 <= moved[i, 0] <= shape[1] - 1 and 0 <= moved[i, 1] <= shape[0] - 1
        if inside and reliable[i]:
            survivors[alive] = i
            alive += 1
    survivors = survivors[:alive]
    return survivors, moved[survivors], -motion[survivors]


def selected(state: TrajectoryState, positions: Array) -> TrajectoryState:
    """Keep the trajectories at some ascending indices (n,) intp; drop the others."""
    return TrajectoryState(
        state.ids[positions], state.positions[positions], state.motions[positions], state.residuals,
        state.rows[positions], state.ages[positions], state.evidence[positions], state.next_id,
    )  # fmt: skip


@compiled
def evenly_spread(positions: Array, chosen: Array, spacing: float) -> Array:
    """Pick at most one point a square, so that every part of the frame has the same weight.

    Trajectories are dense on objects and would outvote the background.

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
        Ascending indices of the first point in each square.
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


def with_residuals(
    state: TrajectoryState, predicted: Array, advantage: Array, config: TrajectoriesConfig
) -> TrajectoryState:
    """Add the newest residuals and evidence against the camera.

    Parameters
    ----------
    state : TrajectoryState
    predicted : (n, 2) float32
        Backward motion of a background point at each trajectory, px.
    advantage : (n,) float32
        :class:`~mlbs_actors.tracking.camera.CameraEvidence` at each trajectory, × the frame's noise.
    """
    # A step has bounds: one bad match must not decide for long.
    rules = (1.0 - config.evidence_forgetting, config.least_evidence_step, config.most_evidence_step)
    residuals, evidence = _remembered(
        state.residuals, state.rows, state.ages, state.motions, predicted, state.evidence, advantage, rules
    )
    return replace(state, residuals=residuals, rows=np.arange(len(state)), evidence=evidence)


@compiled
def _remembered(
    residuals: Array, rows: Array, ages: Array, motions: Array, predicted: Array, evidence: Array,
    advantage: Array, rules: tuple[float, float, float],
) -> tuple[Array, Array]:  # fmt: skip
    """Return the residuals with the newest first, 0 for those without a motion, and the evidence."""
    kept, least, most = np.float32(rules[0]), np.float32(rules[1]), np.float32(rules[2])
    summed = np.empty(rows.size, np.float32)
    for trajectory in range(rows.size):
        summed[trajectory] = kept * evidence[trajectory] + min(
            max(np.float32(advantage[trajectory]), least), most
        )
    length = 2 * residuals.shape[1]
    moved, old = np.empty((rows.size, length), np.float32), residuals.reshape(residuals.shape[0], length)
    for trajectory in range(rows.size):
        row = rows[trajectory]
        for axis in range(2):
            known = motions[trajectory, axis] - predicted[trajectory, axis]
            moved[trajectory, axis] = known if ages[trajectory] > 0 else np.float32(0)
        for place in range(length - 2):
            moved[trajectory, place + 2] = old[row, place] if row >= 0 else np.float32(0)
    return moved.reshape(rows.size, residuals.shape[1], 2), summed
