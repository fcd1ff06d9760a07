"""How motion changes across the borders of classes of trajectories, and inside them (§4)."""

from __future__ import annotations

import numpy as np

from mlbs_actors.kernels.jit import compiled
from mlbs_actors.messages import Array

__all__ = ["border_motion", "inner_motion"]


@compiled
def border_motion(
    first: Array, second: Array, distance: Array, classes: Array, count: int, quantile: float
) -> tuple[Array, Array, Array]:
    """Measure the motion distance across the border of each pair of neighbouring classes.

    Parameters
    ----------
    first, second, distance : (m,) int32, (m,) int32, (m,) float32
        Of a :class:`~mlbs_actors.clustering.affinity.TrajectoryGraph`.
    classes : (n,) int64
        Class 0 … count−1 of each trajectory, −1 for none.
    count : int
    quantile : float
        In [0, 1].

    Returns
    -------
    borders : (b, 2) int64
        Lower and higher class of each pair that has edges, sorted by both.
    distances : (b,) float32
        That quantile of the motion distance over the edges between them.
    edges : (b,) int64
        Their number.
    """
    starts = np.zeros(count * count + 1, np.int64)
    pair, across, found = np.empty(first.size, np.int32), np.empty(first.size, distance.dtype), 0
    for edge in range(first.size):
        one, other = classes[np.uint32(first[edge])], classes[np.uint32(second[edge])]
        if one != other and min(one, other) >= 0:
            pair[found], across[found] = min(one, other) * count + max(one, other), distance[edge]
            starts[pair[found] + 1] += 1
            found += 1
    sizes = starts[1:].copy()
    starts = np.cumsum(starts)
    place, ordered = starts[:-1].copy(), np.empty(found, distance.dtype)
    for edge in range(found):
        ordered[place[pair[edge]]] = across[edge]
        place[pair[edge]] += 1
    present = np.flatnonzero(sizes)
    borders, distances = np.empty((present.size, 2), np.int64), np.empty(present.size, distance.dtype)
    for border, one in enumerate(present):
        borders[border, 0], borders[border, 1] = one // count, one % count
        middle = min(int(quantile * sizes[one]), sizes[one] - 1)
        distances[border] = np.sort(ordered[starts[one] : starts[one + 1]])[middle]
    return borders, distances, sizes[present]


@compiled
def inner_motion(
    first: Array, second: Array, distance: Array, classes: Array, count: int, quantile: float
) -> Array:
    """Measure the motion distance inside each class.

    Parameters
    ----------
    first, second, distance, classes, count, quantile
        As of :func:`border_motion`.

    Returns
    -------
    (count,) float64
        That quantile of the motion distance over the edges inside each; 0 for one without edges.
    """
    starts = np.zeros(count + 1, np.int64)
    for edge in range(first.size):
        one = classes[first[edge]]
        if one >= 0 and one == classes[second[edge]]:
            starts[one + 1] += 1
    starts = np.cumsum(starts)
    place, ordered = starts[:-1].copy(), np.empty(starts[-1], distance.dtype)
    for edge in range(first.size):
        one = classes[first[edge]]
        if one >= 0 and one == classes[second[edge]]:
            ordered[place[one]] = distance[edge]
            place[one] += 1
    inside = np.zeros(count)
    for one in range(count):
        size = starts[one + 1] - starts[one]
        if size:
            own = ordered[starts[one] : starts[one + 1]]
            inside[one] = np.sort(own)[min(int(quantile * size), size - 1)]
    return inside
