"""Merges labels that move together (§4): depth is not motion.

Differs from the paper, which trusts the N-cut alone. Two parts of the background that an object separates in
the image are joined again: parts of a static scene are continuous somewhere along their border, while an
object is discontinuous along all of its own. So a young label is merged into the neighbour from which its
motion distance, at a low quantile over their common border, is within the noise.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mlbs_actors.clustering.affinity import TrajectoryGraph
from mlbs_actors.clustering.label_index import UNLABELLED, label_classes
from mlbs_actors.config import LayersConfig
from mlbs_actors.kernels.jit import compiled
from mlbs_actors.messages import BACKGROUND, Array

__all__ = ["border_motion", "merge_by_motion"]


def merge_by_motion(
    graph: TrajectoryGraph,
    labels: Array,
    ages: dict[int, int],
    speeds: dict[int, float],
    least_speed: float,
    config: LayersConfig,
) -> Array:
    """Merge labels into the neighbour that moves with them.

    A young label that does not move against the camera goes to the background, wherever it lies. One whose
    motion distance to a neighbour is within the noise at a low quantile of their common border goes to that
    neighbour. Parts of one object bend and rotate against each other, so the threshold between objects is
    higher, but only where the border is long for the younger one: objects that pass each other share a short
    one. Older objects whose motions have been the same, within the noise, all their common life are one, too,
    if they touch at all; those that have been two for long stay two, as people can walk side by side. Borders
    are compared with √n of the younger's n trajectories, as a border grows with the root of the area.

    Parameters
    ----------
    graph : TrajectoryGraph
    labels : (n,) int64
    ages : dict of int to int
        Frames since each label's birth; a label that is not in it is new.
    speeds : dict of int to float
        From :func:`~mlbs_actors.clustering.splitting.label_speeds`.
    least_speed : float
        From :func:`~mlbs_actors.clustering.splitting.least_object_speed`.

    Returns
    -------
    (n,) int64
        The older label wins; among equals the lower one.
    """
    labels = labels.copy()
    for label, speed in speeds.items():
        if label != BACKGROUND and ages.get(label, 0) < config.young_frames and speed < least_speed:
            labels[labels == label] = BACKGROUND
    known, classes = label_classes(labels, labels == UNLABELLED)
    rules = _Rules(
        young_frames=config.young_frames,
        quantile=config.merge_quantile,
        most_distance=config.merge_distance,
        most_object_distance=config.object_merge_distance,
        least_border=config.merge_border,
        most_same_distance=config.same_motion_distance,
        least_same_border=config.same_motion_border,
        most_same_frames=config.same_motion_frames,
        least_edges=config.least_border,
    )
    known_ages = np.array([ages.get(label, 0) for label in known.tolist()], np.int64)
    edges = graph.first, graph.second, graph.motion_distance
    _merge(edges, labels, known, classes, known_ages, rules)
    return labels


class _Rules(NamedTuple):
    """Thresholds of `LayersConfig` below which labels are merged."""

    young_frames: int
    quantile: float
    most_distance: float
    most_object_distance: float
    least_border: float
    most_same_distance: float
    least_same_border: float
    most_same_frames: int
    least_edges: int


@compiled
def _merge(
    edges: tuple[Array, Array, Array], labels: Array, known: Array, classes: Array, ages: Array, rules: _Rules
) -> None:
    """Merge similar labels and their classes pair by pair, the nearest first."""
    first, second, distance = edges
    sizes = np.zeros(known.size, np.int64)
    for i in range(classes.size):
        if classes[i] >= 0:
            sizes[classes[i]] += 1
    while True:
        borders, distances, touching = border_motion(
            first, second, distance, classes, known.size, rules.quantile
        )
        nearest, best_younger, best_older = np.float32(np.inf), -1, -1
        for border in range(len(borders)):
            older, younger = borders[border]
            if ages[younger] > ages[older]:
                older, younger = younger, older
            young, apart, root = (
                ages[younger] < rules.young_frames,
                distances[border],
                np.sqrt(sizes[younger]),
            )
            if known[older] == BACKGROUND:
                alike = young and apart < rules.most_distance
            else:
                alike = young and apart < rules.most_object_distance
                alike &= touching[border] >= rules.least_border * root
                alike |= (
                    apart < rules.most_same_distance
                    and ages[younger] <= rules.most_same_frames
                    and touching[border] >= rules.least_same_border * root
                    and touching[border] >= rules.least_edges
                )
            if alike and (apart, younger, older) < (nearest, best_younger, best_older):
                nearest, best_younger, best_older = apart, younger, older
        if best_younger < 0:
            return
        for i in range(classes.size):
            if classes[i] == best_younger:
                classes[i], labels[i] = best_older, known[best_older]
        sizes[best_older] += sizes[best_younger]


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
