"""Sparse graph of trajectories with max-over-time motion distances (§4).

Differs from the paper: only near neighbours are ever compared (no n × n matrix); distances are maxima over
the common life that forget slowly, so that one bad match cannot poison a pair for ever; and they are
recomputed from the trajectories' own bounded memory, so the graph has no state of its own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from mlbs_actors.clustering.label_index import median_length
from mlbs_actors.clustering.nearest_neighbours import neighbour_pairs
from mlbs_actors.config import AffinityConfig, length_scale
from mlbs_actors.kernels.jit import compiled
from mlbs_actors.messages import Array
from mlbs_actors.tracking.trajectories import TrajectoryState

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
        """Symmetric (n, n) sparse affinity matrix, the columns of a row ascending."""
        pointers, columns, values = _symmetric(self.first, self.second, self.affinity, self.size)
        return sp.csr_array((values, columns, pointers), shape=(self.size, self.size))


def displacement_spread(state: TrajectoryState, config: AffinityConfig, scale: float) -> float:
    """Noise scale of two-frame displacements: max(floor, factor × median camera displacement), px.

    The MATLAB program takes the spread of all displacements, which one fast object inflates until slow ones
    are lost. Parallax and blur, which spread the background, grow with the camera's motion.
    """
    floor = config.motion_floor_px * scale
    # In this order, as the median of nothing is NaN.
    return max(floor, 2.0 * config.motion_relative * median_length(state.motions, state.ages >= 1))


@compiled
def _symmetric(first: Array, second: Array, values: Array, size: int) -> tuple[Array, Array, Array]:
    """Return row pointers, columns and values of the symmetric matrix of some sorted pairs."""
    pointers, before = np.zeros(size + 1, np.int32), np.zeros(size, np.int32)
    for edge in range(first.size):
        pointers[np.uint32(first[edge]) + 1] += 1
        before[np.uint32(second[edge])] += 1
    for row in range(size):
        pointers[row + 1] += pointers[row] + before[row]
    # Columns left of the diagonal come first; on either side they come in ascending order.
    left = pointers[:-1].copy()
    right = left + before
    columns, filled = np.empty(2 * first.size, np.int32), np.empty(2 * first.size)
    for edge in range(first.size):
        one, other = np.uint32(first[edge]), np.uint32(second[edge])
        columns[right[one]], filled[right[one]] = other, values[edge]
        columns[left[other]], filled[left[other]] = one, values[edge]
        right[one] += 1
        left[other] += 1
    return pointers, columns, filled


@compiled
def _distances(
    edges: tuple[Array, Array], trajectories: tuple[Array, Array, Array], units: Array,
    squared_radius: np.float32, relative: float, forgetting: float,
) -> tuple[Array, Array]:  # fmt: skip
    """Compute D_M and −D_M − |Δp|²/radius² of every edge, from positions, residuals and ages."""
    (first, second), (positions, residuals, ages) = edges, trajectories
    count, memory = residuals.shape[:2]
    # Two-frame displacements, their lengths, and their weight after forgetting.
    x, y = np.zeros((count, memory), np.float32), np.zeros((count, memory), np.float32)
    speed = np.zeros((count, memory), np.float32)
    for i in range(count):
        for age in range(memory - 1):
            x[i, age] = residuals[i, age, 0] + residuals[i, age + 1, 0]
            y[i, age] = residuals[i, age, 1] + residuals[i, age + 1, 1]
            speed[i, age] = np.sqrt(x[i, age] ** 2 + y[i, age] ** 2)
    noise, kept = np.empty(memory, np.float32), np.empty(memory, np.float32)
    for age in range(memory):
        noise[age] = units[age] ** 2
        kept[age] = (1.0 - forgetting) ** age
    half, two = np.float32(0.5 * relative), np.float32(2)
    distances, exponents = np.empty(first.size, np.float32), np.empty(first.size, np.float32)
    for edge in range(first.size):
        i, j = first[edge], second[edge]
        common = min(ages[i], ages[j])
        if common == 1:  # twice the one motion they have in common replaces it
            dx = two * (residuals[i, 0, 0] - residuals[j, 0, 0])
            dy = two * (residuals[i, 0, 1] - residuals[j, 0, 1])
            lengths = np.hypot(residuals[i, 0, 0], residuals[i, 0, 1])
            lengths += np.hypot(residuals[j, 0, 0], residuals[j, 0, 1])
            spread = two * half * lengths
            distance = (dx * dx + dy * dy) / (noise[0] + spread * spread)
        else:
            # Non-negative floats are ordered as their bits are, whose maximum is vectorised.
            largest = np.int32(0)
            for age in range(common - 1):
                dx, dy = x[i, age] - x[j, age], y[i, age] - y[j, age]
                spread = half * (speed[i, age] + speed[j, age])
                ratio = np.float32(kept[age] * (dx * dx + dy * dy) / (noise[age] + spread * spread))
                largest = max(largest, np.int32(ratio.view(np.int32)))
            distance = np.int32(largest).view(np.float32)
        across, down = positions[i, 0] - positions[j, 0], positions[i, 1] - positions[j, 1]
        distances[edge] = distance
        exponents[edge] = -distance - (across * across + down * down) / squared_radius
    return distances, exponents


def trajectory_graph(
    state: TrajectoryState, spreads: Array, shape: tuple[int, int], config: AffinityConfig
) -> TrajectoryGraph:
    """Build the neighbour graph of the live trajectories at one frame.

    Parameters
    ----------
    state : TrajectoryState
    spreads : (T,) float64
        :func:`displacement_spread` of the last T frames, newest first, px.
    shape : (int, int)
        (H, W), px.

    Returns
    -------
    TrajectoryGraph
    """
    n = len(state)
    radius = config.radius_px * length_scale(*shape)
    if n < 2:
        none = np.zeros(0, np.int32)
        return TrajectoryGraph(none, none, np.zeros(0, np.float32), np.zeros(0, np.float32), n)
    first, second = neighbour_pairs(state.positions, min(config.neighbours, n - 1), radius)
    units = config.motion_factor * np.asarray(spreads, np.float64)
    motion, exponents = _distances(
        (first, second),
        (state.positions, state.residuals, state.ages),
        units,
        np.float32(radius * radius),
        config.object_relative,
        config.forgetting,
    )
    affinity = np.exp(exponents, out=exponents)
    return TrajectoryGraph(first, second, motion, affinity, n)
