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
from mlbs_actors.clustering.border_motion import border_motion
from mlbs_actors.clustering.label_index import UNLABELLED, label_classes
from mlbs_actors.clustering.repulsion import Repulsion
from mlbs_actors.config import LayersConfig
from mlbs_actors.kernels.jit import compiled
from mlbs_actors.messages import BACKGROUND, Array

__all__ = ["merge_by_motion"]


def merge_by_motion(
    graph: TrajectoryGraph,
    labels: Array,
    ages: dict[int, int],
    speeds: dict[int, float],
    least_speed: float,
    config: LayersConfig,
    repulsion: Repulsion,
) -> Array:
    """Merge labels into the neighbour that moves with them.

    A young label that does not move against the camera goes to the background, wherever it lies. One whose
    motion distance to a neighbour is within the noise at a low quantile of their common border goes to that
    neighbour. Parts of one object bend and rotate against each other, so the threshold between objects is
    higher, but only where the border is long for the younger one: objects that pass each other share a short
    one. Older objects whose motions have been the same, within the noise, all their common life are one, too,
    if they touch at all; those that have been two for long stay two, as people can walk side by side. Objects
    that are more likely two things than one (:mod:`~mlbs_actors.clustering.repulsion`) are never merged.
    Borders are compared with √n of the younger's n trajectories, as a border grows with the root of the area.

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
    config : LayersConfig
    repulsion : Repulsion
        Between the labels.

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
    two = repulsion.matrix(known) > 0
    _merge(edges, labels, known, classes, known_ages, two, rules)
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
    edges: tuple[Array, Array, Array],
    labels: Array,
    known: Array,
    classes: Array,
    ages: Array,
    two: Array,
    rules: _Rules,
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
                alike &= not two[older, younger]
            if alike and (apart, younger, older) < (nearest, best_younger, best_older):
                nearest, best_younger, best_older = apart, younger, older
        if best_younger < 0:
            return
        for i in range(classes.size):
            if classes[i] == best_younger:
                classes[i], labels[i] = best_older, known[best_older]
        sizes[best_older] += sizes[best_younger]
