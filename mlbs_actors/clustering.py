"""Which trajectories belong together: propagate, split, merge (§4).

Every few frames the labels are carried on to new trajectories by a random walk, every cluster is put to the
N-cut test again, and what falls apart is kept apart only if it *moves* apart.

Differs from the paper, which trusts the N-cut alone:

* Depth is not motion. Two parts of the background that an object cut apart in the image are joined again by a
  motion test: parts of a static scene join continuously somewhere along their border, while an object is
  discontinuous along all of its own. So a young label is merged into the neighbour from which its
  motion distance, at a low quantile over their common border, is within the noise.
* Flow bleeds over smooth ground. Trajectories that move without evidence of it have no part in the N-cut
  test.
* Disconnection alone never makes a label, and groups with few trajectories stay unlabelled.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
import scipy.sparse as sp

from mlbs_actors.affinity import TrajectoryGraph
from mlbs_actors.compilation import compiled
from mlbs_actors.config import AffinityConfig, LayersConfig
from mlbs_actors.label_classes import (
    UNLABELLED,
    class_medians,
    distinct_labels,
    label_classes,
    likeliest,
    median_length,
)
from mlbs_actors.label_propagation import propagate_absorbing, propagate_soft
from mlbs_actors.messages import BACKGROUND, Array
from mlbs_actors.normalized_cut import recursive_cut
from mlbs_actors.trajectories import TrajectoryState, evenly_spread

__all__ = [
    "background_first",
    "bled_trajectories",
    "border_motion",
    "label_speeds",
    "least_object_speed",
    "merge_by_motion",
    "propagate_labels",
    "split_labels",
    "split_origins",
]

#: Fewer edges across a border say nothing of it.
LEAST_BORDER = 5
#: Frames over which a trajectory's speed against the camera is averaged.
SPEED_FRAMES = 3


def propagate_labels(affinity: sp.csr_array, labels: Array, config: AffinityConfig) -> Array:
    """Carry last frame's labels to this frame's trajectories.

    Parameters
    ----------
    affinity : (n, n) sparse
    labels : (n,) int64
        Label of each trajectory in the last frame; −1 for new ones.
    config : AffinityConfig

    Returns
    -------
    (n,) int64
        −1 where no labelled trajectory can be reached, or only by so long a walk that next to none get there.
    """
    if config.propagation == "soft":
        return _decided(partial(propagate_soft, restart=config.restart), affinity, labels)
    return _decided(propagate_absorbing, affinity, labels)


def _decided(
    walk: Callable[[sp.csr_array, Array, int], Array], affinity: sp.csr_array, labels: Array
) -> Array:
    """The label to which most walks from each trajectory lead, −1 where none does."""
    known, classes = label_classes(labels, labels == UNLABELLED)
    return np.asarray(likeliest(walk(affinity, classes, len(known)), known))


def bled_trajectories(trajectories: TrajectoryState, config: LayersConfig, scale: float) -> Array:
    """Which trajectories move against the camera though the image gives no evidence of it.

    Flow bleeds from an object over the smooth ground beside it. Such trajectories move in ways between
    those of two things, and so tie together what does not belong together.

    Parameters
    ----------
    trajectories : TrajectoryState
    config : LayersConfig
    scale : float
        :func:`~mlbs_actors.config.length_scale` of the frame.

    Returns
    -------
    (n,) bool
    """
    moving = _residual_speed(trajectories) > config.camera_px * scale
    return np.asarray(moving & (trajectories.evidence < config.least_evidence))


def split_labels(
    affinity: sp.csr_array, labels: Array, config: AffinityConfig, next_label: int, bled: Array
) -> Array:
    """Put every cluster to the N-cut test; parts that fall off get fresh labels.

    The part with most trajectories keeps the label. Trajectories without a label are clustered too. Those
    that have bled tie nothing together; they, and the few that hung on them alone, go where the random walk
    takes them.

    Parameters
    ----------
    affinity : (n, n) sparse
    labels : (n,) int64
    config : AffinityConfig
    next_label : int
        From here on labels are unused.
    bled : (n,) bool
        From :func:`bled_trajectories`.

    Returns
    -------
    (n,) int64
    """
    known, classes = label_classes(labels, bled)
    clusters = recursive_cut(affinity, config.cut_threshold, config.cut_side_tracks, classes)
    result, adrift = _named(labels, bled, known, classes, clusters, next_label)
    if adrift.any():
        # All others hold still: the walk is asked only where those adrift go.
        result[adrift] = _decided(propagate_absorbing, affinity, result)[adrift]
    return result


@compiled()
def _named(
    labels: Array, bled: Array, known: Array, classes: Array, clusters: Array, next_label: int
) -> tuple[Array, Array]:
    """Labels of the clusters that each label has fallen into, and which trajectories are adrift.

    Labels that are too small to be cut stay as they are.
    """
    owner = np.full(clusters.size, -1)
    own, has_bled = classes.copy(), np.zeros(known.size, np.bool_)
    count = 0
    for i in range(labels.size):
        if bled[i]:
            place = np.searchsorted(known, labels[i])
            if place < known.size and known[place] == labels[i]:
                own[i], has_bled[place] = place, True
        elif clusters[i] >= 0:
            owner[clusters[i]] = classes[i]
            count = max(count, clusters[i] + 1)
    names, parts = np.empty(count, np.int64), np.zeros(known.size, np.int64)
    for one in range(known.size):
        for cluster in range(count):  # by falling size
            if owner[cluster] == one:
                if parts[one] == 0 and known[one] != UNLABELLED:
                    names[cluster] = known[one]
                else:
                    names[cluster] = next_label
                    next_label += 1
                parts[one] += 1
    result, adrift = labels.copy(), np.zeros(labels.size, np.bool_)
    for i in range(labels.size):
        if own[i] < 0 or parts[own[i]] == 0:
            continue
        if clusters[i] >= 0:
            result[i] = names[clusters[i]]
        elif not bled[i]:
            result[i], adrift[i] = UNLABELLED, has_bled[own[i]]
        elif parts[own[i]] > 1:
            result[i], adrift[i] = UNLABELLED, True
    return result, adrift


def split_origins(before: Array, labels: Array) -> dict[int, int]:
    """Where the labels that are new after :func:`split_labels` come from.

    Parameters
    ----------
    before, labels : (n,) int64
        Labels before and after it.

    Returns
    -------
    dict of int to int
        New label → the label that most of its trajectories had; none for those that had none.
    """
    origins = {}
    for label in sorted(distinct_labels(labels) - distinct_labels(before)):
        previous, counts = np.unique(before[labels == label], return_counts=True)
        if previous[np.argmax(counts)] != UNLABELLED:
            origins[label] = int(previous[np.argmax(counts)])
    return origins


def border_motion(
    graph: TrajectoryGraph, labels: Array, quantile: float
) -> dict[tuple[int, int], tuple[float, int]]:
    """Motion distance across the border of each pair of neighbouring labels.

    Parameters
    ----------
    graph : TrajectoryGraph
    labels : (n,) int64
    quantile : float
        In [0, 1].

    Returns
    -------
    dict
        (lower label, higher label) → (that quantile of D_M over the edges between them, number of edges).
    """
    low, high, distance = _across_borders(graph.first, graph.second, graph.motion_distance, labels)
    if len(low) == 0:
        return {}
    order = np.lexsort((distance, high, low))
    low, high, distance = low[order], high[order], distance[order]
    starts = np.flatnonzero(np.r_[True, (np.diff(low) != 0) | (np.diff(high) != 0)])
    borders = {}
    for start, end in zip(starts, np.r_[starts[1:], len(low)], strict=True):
        position = min(int(quantile * (end - start)), end - start - 1)
        borders[int(low[start]), int(high[start])] = (float(distance[start + position]), int(end - start))
    return borders


@compiled()
def _across_borders(
    first: Array, second: Array, distance: Array, labels: Array
) -> tuple[Array, Array, Array]:
    """Lower and higher label and motion distance of the edges between labels."""
    low, high = np.empty(first.size, labels.dtype), np.empty(first.size, labels.dtype)
    across, found = np.empty(first.size, distance.dtype), 0
    for edge in range(first.size):
        one, other = labels[first[edge]], labels[second[edge]]
        if one != other and one != UNLABELLED and other != UNLABELLED:
            low[found], high[found], across[found] = min(one, other), max(one, other), distance[edge]
            found += 1
    return low[:found], high[:found], across[:found]


def label_speeds(trajectories: TrajectoryState, labels: Array) -> dict[int, float]:
    """How fast each label moves against the camera.

    Parameters
    ----------
    trajectories : TrajectoryState
    labels : (n,) int64

    Returns
    -------
    dict of int to float
        Label → median over its trajectories of their mean residual motion of up to three frames, px/frame.
    """
    known, classes = label_classes(labels, labels == UNLABELLED)
    medians = class_medians(_residual_speed(trajectories), classes, len(known))
    return dict(zip(known.tolist(), medians.tolist(), strict=True))


def least_object_speed(
    trajectories: TrajectoryState, background: Array, config: LayersConfig, scale: float
) -> float:
    """Speed against the camera below which a young label is background, px/frame.

    Parameters
    ----------
    trajectories : TrajectoryState
    background : (n,) bool
    config : LayersConfig
    scale : float
        :func:`~mlbs_actors.config.length_scale` of the frame.
    """
    least = config.camera_px * scale
    if background.any():
        camera = median_length(trajectories.motions.astype(np.float64), background)
        own = np.median(_residual_speed(trajectories)[background])
        least = max(least, config.camera_relative * camera, 4.0 * float(own))
    return least


def _residual_speed(trajectories: TrajectoryState) -> Array:
    return np.asarray(_mean_speed(trajectories.residuals, trajectories.ages))


@compiled()
def _mean_speed(residuals: Array, ages: Array) -> Array:
    """Length of each trajectory's mean residual motion over its last ``SPEED_FRAMES`` frames, (n,)."""
    speed = np.empty(ages.size)
    for i in range(ages.size):
        x = y = np.float32(0)
        for age in range(min(SPEED_FRAMES, residuals.shape[1])):
            x += residuals[i, age, 0]
            y += residuals[i, age, 1]
        known = min(max(ages[i], 1), SPEED_FRAMES)
        speed[i] = np.hypot(x / known, y / known)
    return speed


def merge_by_motion(
    graph: TrajectoryGraph,
    labels: Array,
    ages: dict[int, int],
    speeds: dict[int, float],
    least_speed: float,
    config: LayersConfig,
) -> Array:
    """Merge labels into the neighbour that moves with them.

    A young label that does not move against the camera goes to the background, wherever it lies. One
    whose motion distance to a neighbour is within the noise at a low quantile of their common border goes
    to that neighbour. Parts of one object bend and turn against each other, so between objects more is
    allowed, but only where a good part of the younger touches the older: two objects that pass each other
    touch with little. Objects of any age whose motions have been the same, within the noise, all their common
    life are one, if they touch at all. Borders are measured against √n of the younger's n trajectories, for
    a border grows like the root of what it bounds.

    Parameters
    ----------
    graph : TrajectoryGraph
    labels : (n,) int64
    ages : dict of int to int
        Frames since each label's birth; a label that is not in it is new.
    speeds : dict of int to float
        From :func:`label_speeds`.
    least_speed : float
        From :func:`least_object_speed`.
    config : LayersConfig

    Returns
    -------
    (n,) int64
        The older label wins; among equals the lower one.
    """
    labels = labels.copy()
    for label, speed in speeds.items():
        if label != BACKGROUND and ages.get(label, 0) < config.young_frames and speed < least_speed:
            labels[labels == label] = BACKGROUND
    while True:
        candidates = []
        for (low, high), (distance, edges) in border_motion(graph, labels, config.merge_quantile).items():
            older, younger = sorted((low, high), key=lambda label: (-ages.get(label, 0), label))
            young = ages.get(younger, 0) < config.young_frames
            count = int((labels == younger).sum())
            if older == BACKGROUND:
                alike = young and distance < config.merge_distance
            else:
                alike = young and distance < config.object_merge_distance
                alike &= edges >= config.merge_border * np.sqrt(count)
                alike |= (
                    distance < config.same_motion_distance
                    and edges >= config.same_motion_border * np.sqrt(count)
                    and edges >= LEAST_BORDER
                )
            if alike:
                candidates.append((distance, younger, older))
        if not candidates:
            return labels
        _, younger, older = min(candidates)
        labels[labels == younger] = older


def background_first(labels: Array, trajectories: TrajectoryState, scale: float, spacing: float) -> Array:
    """Renumber the first clusters so that 0 is the one that best obeys the camera's motion.

    Parameters
    ----------
    labels : (n,) int64
        Clusters 0 … C−1, −1 = none.
    trajectories : TrajectoryState
    scale : float
        :func:`~mlbs_actors.config.length_scale` of the frame.
    spacing : float
        Trajectories count once a square of this side: it is the area that decides, px.

    Returns
    -------
    (n,) int64
        All background if there is no cluster.
    """
    clusters = np.unique(labels[labels != UNLABELLED])
    if len(clusters) == 0:
        return np.full(len(labels), BACKGROUND, np.int64)
    residual = np.hypot(trajectories.residuals[:, 0, 0], trajectories.residuals[:, 0, 1])
    obeying = [
        len(evenly_spread(trajectories.positions, (labels == cluster) & (residual < scale), spacing))
        for cluster in clusters
    ]
    background = int(clusters[int(np.argmax(obeying))])
    order = [background, *(int(cluster) for cluster in clusters if cluster != background)]
    renumbered = np.full(len(labels), UNLABELLED, np.int64)
    for position, cluster in enumerate(order):
        renumbered[labels == cluster] = position
    return renumbered
