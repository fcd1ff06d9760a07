"""Sparse graph of trajectories with max-over-time motion distances (§4).

Differs from the paper: only near neighbours are ever compared (no n × n matrix); distances are maxima over
the common life that forget slowly, so that one bad match cannot poison a pair for ever; and they are
recomputed from the trajectories' own bounded memory, so the graph has no state of its own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
import scipy.sparse as sp
from scipy.spatial import cKDTree

from mlbs_actors.config import AffinityConfig, length_scale
from mlbs_actors.messages import Array
from mlbs_actors.trajectories import TrajectoryState

__all__ = ["TrajectoryGraph", "displacement_spread", "trajectory_graph"]


@dataclass(frozen=True, slots=True)
class TrajectoryGraph:
    """Undirected edges between neighbouring trajectories (array positions, first < second).

    Attributes
    ----------
    first, second : (m,) int32
        Sorted by (first, second).
    motion_distance : (m,) float32
        D_M: squared difference of two-frame displacements in units of the displacement spread, its maximum
        over the common life.
    affinity : (m,) float32
        exp(−D_M − |Δp|²/radius²), in [0, 1].
    size : int
        Number of trajectories.
    """

    first: Array
    second: Array
    motion_distance: Array
    affinity: Array
    size: int

    def matrix(self) -> sp.csr_array:
        """Symmetric (n, n) sparse affinity matrix."""
        rows = np.concatenate([self.first, self.second])
        columns = np.concatenate([self.second, self.first])
        values = np.concatenate([self.affinity, self.affinity]).astype(np.float64)
        return sp.csr_array((values, (rows, columns)), shape=(self.size, self.size))


def displacement_spread(state: TrajectoryState, config: AffinityConfig, scale: float) -> float:
    """Noise scale of two-frame displacements: max(floor, factor × median camera displacement), px.

    The MATLAB takes the spread of all displacements, which one fast object inflates until slow ones drown.
    What makes the background's own motions differ, parallax and blur, grows with the camera's motion.
    """
    floor = config.motion_floor_px * scale
    known = state.ages >= 1
    if not known.any():
        return floor
    speed = float(np.median(np.hypot(state.motions[known, 0], state.motions[known, 1])))
    return max(2.0 * config.motion_relative * speed, floor)


@numba.njit(cache=True)
def _max_motion_distance(first, second, residuals, ages, units, relative, forgetting):  # type: ignore[no-untyped-def]
    distances = np.zeros(first.size, np.float32)
    for edge in range(first.size):
        i = first[edge]
        j = second[edge]
        common = min(ages[i], ages[j])
        largest = 0.0
        kept = 1.0
        for age in range(max(common - 1, min(common, 1))):
            # Two-frame displacements; with one frame in common twice its motion stands for it.
            before = age + 1 if common > 1 else age
            xi = residuals[i, age, 0] + residuals[i, before, 0]
            yi = residuals[i, age, 1] + residuals[i, before, 1]
            xj = residuals[j, age, 0] + residuals[j, before, 0]
            yj = residuals[j, age, 1] + residuals[j, before, 1]
            speed = 0.5 * relative * (np.sqrt(xi * xi + yi * yi) + np.sqrt(xj * xj + yj * yj))
            noise = units[age] * units[age] + speed * speed
            distance = kept * ((xi - xj) * (xi - xj) + (yi - yj) * (yi - yj)) / noise
            if distance > largest:
                largest = distance
            kept *= 1.0 - forgetting
        distances[edge] = largest
    return distances


def trajectory_graph(
    state: TrajectoryState, spreads: Array, shape: tuple[int, int], config: AffinityConfig
) -> TrajectoryGraph:
    """Neighbour graph of the live trajectories at one frame.

    Parameters
    ----------
    state : TrajectoryState
    spreads : (T,) float64
        :func:`displacement_spread` of the last T frames, newest first, px.
    shape : (int, int)
        (H, W), px.
    config : AffinityConfig

    Returns
    -------
    TrajectoryGraph
    """
    n = len(state)
    radius = config.radius_px * length_scale(*shape)
    if n < 2:
        none = np.zeros(0, np.int32)
        return TrajectoryGraph(none, none, np.zeros(0, np.float32), np.zeros(0, np.float32), n)
    count = min(config.neighbours + 1, n)
    nearest = cKDTree(state.positions).query(state.positions, k=count, distance_upper_bound=radius)
    distance, index = (np.asarray(one) for one in nearest)
    source = np.repeat(np.arange(n), count)
    target = index.ravel()
    valid = np.isfinite(distance.ravel()) & (target != source)
    low = np.minimum(source, target)[valid].astype(np.int64)
    high = np.maximum(source, target)[valid].astype(np.int64)
    pairs = np.unique(low * n + high)
    first, second = (pairs // n).astype(np.int32), (pairs % n).astype(np.int32)
    units = config.motion_factor * np.asarray(spreads, np.float64)
    motion = _max_motion_distance(
        first, second, state.residuals, state.ages, units, config.object_relative, config.forgetting
    )
    gap = state.positions[first] - state.positions[second]
    spatial = np.square(gap).sum(axis=1) / np.float32(radius * radius)
    return TrajectoryGraph(first, second, motion, np.exp(-motion - spatial), n)
