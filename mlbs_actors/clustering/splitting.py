"""Clusters of trajectories: propagate labels, then split (§4).

Every few frames the labels are carried on to new trajectories by a random walk, every cluster is put to the
N-cut test again, and parts are kept separate only if they *move* apart
(:mod:`mlbs_actors.clustering.motion_merging`).

Differs from the paper, which trusts the N-cut alone:

* Flow bleeds over smooth ground. Trajectories that move without evidence of it are left out of the N-cut
  test.
* Disconnection alone never makes a label, and groups with few trajectories stay unlabelled.
* A cluster that holds together firmly skips the test for a while. It takes less time, and fewer clusters
  are split by an accident of the flow.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from functools import partial

import numpy as np
import scipy.sparse as sp

from mlbs_actors.clustering.label_index import (
    UNLABELLED,
    class_medians,
    distinct_labels,
    label_classes,
    likeliest,
    median_length,
)
from mlbs_actors.clustering.label_propagation import propagate_absorbing, propagate_soft
from mlbs_actors.clustering.normalized_cut import recursive_cut
from mlbs_actors.config import AffinityConfig, LayersConfig
from mlbs_actors.kernels.jit import compiled
from mlbs_actors.messages import BACKGROUND, Array
from mlbs_actors.tracking.trajectories import TrajectoryState, evenly_spread

__all__ = [
    "background_first",
    "background_kept",
    "bled_trajectories",
    "label_speeds",
    "least_object_speed",
    "outgrowing",
    "propagate_labels",
    "residual_speed",
    "split_labels",
    "split_origins",
]

#: A new label that covers so many times the background's area, and this share of the frame, is background.
OUTGROWING, LEAST_SCENE = 2.0, 0.05


def propagate_labels(affinity: sp.csr_array, labels: Array, config: AffinityConfig) -> Array:
    """Carry last frame's labels to this frame's trajectories.

    Parameters
    ----------
    affinity : (n, n) sparse
    labels : (n,) int64
        Label of each trajectory in the last frame; −1 for new ones.

    Returns
    -------
    (n,) int64
        −1 where no labelled trajectory can be reached, or too few walks arrive.
    """
    if config.propagation == "soft":
        return _decided(partial(propagate_soft, restart=config.restart), affinity, labels)
    return _decided(propagate_absorbing, affinity, labels)


def _decided(
    walk: Callable[[sp.csr_array, Array, int], Array], affinity: sp.csr_array, labels: Array
) -> Array:
    """Return the label to which most walks from each trajectory lead, −1 where none does."""
    known, classes = label_classes(labels, labels == UNLABELLED)
    return np.asarray(likeliest(walk(affinity, classes, len(known)), known))


def bled_trajectories(
    trajectories: TrajectoryState, speed: Array, config: LayersConfig, scale: float
) -> Array:
    """Find the trajectories that move against the camera without evidence of it in the image.

    Flow bleeds from an object over the smooth ground beside it. Such trajectories have motions between those
    of two things, and so tie together what does not belong together.

    Parameters
    ----------
    trajectories : TrajectoryState
    speed : (n,) float64
        :func:`residual_speed`, px/frame.
    scale : float
        :func:`~mlbs_actors.config.length_scale` of the frame.

    Returns
    -------
    (n,) bool
    """
    moving = speed > config.camera_px * scale
    return np.asarray(moving & (trajectories.evidence < config.least_evidence))


def split_labels(
    affinity: sp.csr_array,
    labels: Array,
    config: AffinityConfig,
    next_label: int,
    bled: Array,
    spared: Array | Sequence[int] = (),
) -> tuple[Array, Array]:
    """Put clusters to the N-cut test; give parts that are split off new labels.

    The part with most trajectories keeps the label. Trajectories without a label are clustered too. Those
    that have bled tie nothing together; they, and the few connected through them only, are labelled by the
    random walk.

    Parameters
    ----------
    affinity : (n, n) sparse
    labels : (n,) int64
    next_label : int
        First unused label.
    bled : (n,) bool
        From :func:`bled_trajectories`.
    spared : (k,) int64
        Labels that skip the test.

    Returns
    -------
    labels : (n,) int64
    firm : (m,) int64
        Labels of clusters that are firm (:func:`~mlbs_actors.clustering.normalized_cut.recursive_cut`).
    """
    known, classes = label_classes(labels, bled)
    tested = np.append(~np.isin(known, spared), False)  # the last entry is for those of no class
    classes = np.where(tested[classes], classes, -1)
    clusters, firm = recursive_cut(
        affinity, config.cut_threshold, config.cut_side_tracks, classes, config.firm_factor
    )
    result, adrift, names = _named(labels, bled, known, classes, clusters, next_label)
    if adrift.any():
        # All others keep their labels: the walk decides only for those adrift.
        result[adrift] = _decided(propagate_absorbing, affinity, result)[adrift]
    return result, names[firm]


@compiled
def _named(
    labels: Array, bled: Array, known: Array, classes: Array, clusters: Array, next_label: int
) -> tuple[Array, Array, Array]:
    """Return the labels of the clusters that each label was split into, which trajectories are adrift, and
    each cluster's label.

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
    return result, adrift, names


def split_origins(before: Array, labels: Array) -> dict[int, int]:
    """Map the labels that are new after :func:`split_labels` to their origins.

    Parameters
    ----------
    before, labels : (n,) int64
        Labels before and after it.

    Returns
    -------
    dict of int to int
        New label → the label that most of its trajectories had; without those that had none.
    """
    origins = {}
    for label in sorted(distinct_labels(labels) - distinct_labels(before)):
        previous, counts = np.unique(before[labels == label], return_counts=True)
        if previous[np.argmax(counts)] != UNLABELLED:
            origins[label] = int(previous[np.argmax(counts)])
    return origins


def label_speeds(speed: Array, labels: Array) -> dict[int, float]:
    """Return how fast each label moves against the camera.

    Parameters
    ----------
    speed : (n,) float64
        :func:`residual_speed`, px/frame.
    labels : (n,) int64

    Returns
    -------
    dict of int to float
        Label → median of its trajectories, px/frame.
    """
    known, classes = label_classes(labels, labels == UNLABELLED)
    medians = class_medians(speed, classes, len(known))
    return dict(zip(known.tolist(), medians.tolist(), strict=True))


def least_object_speed(
    trajectories: TrajectoryState, labels: Array, config: LayersConfig, scale: float
) -> float:
    """Return the least speed of an object against the camera, px/frame.

    Parameters
    ----------
    trajectories : TrajectoryState
    labels : (n,) int64
    scale : float
        :func:`~mlbs_actors.config.length_scale` of the frame.
    """
    least = config.camera_px * scale
    if (labels == BACKGROUND).any():
        camera = median_length(trajectories.motions.astype(np.float64), labels == BACKGROUND)
        least = max(least, config.camera_relative * camera)
    return least


def residual_speed(trajectories: TrajectoryState, frames: int) -> Array:
    """Return the length of each trajectory's mean residual motion over up to ``frames``, (n,) px/frame."""
    return np.asarray(_mean_speed(trajectories.residuals, trajectories.ages, frames))


@compiled
def _mean_speed(residuals: Array, ages: Array, frames: int) -> Array:
    speed = np.empty(ages.size)
    for i in range(ages.size):
        x = y = np.float32(0)
        for age in range(min(frames, residuals.shape[1])):
            x += residuals[i, age, 0]
            y += residuals[i, age, 1]
        known = min(max(ages[i], 1), frames)
        speed[i] = np.hypot(x / known, y / known)
    return speed


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
        A square of this side counts once, so that area decides, px.

    Returns
    -------
    (n,) int64
        All background if there are no clusters.
    """
    clusters = sorted(distinct_labels(labels) - {UNLABELLED})
    if not clusters:
        return np.full(len(labels), BACKGROUND, np.int64)
    background = _steadiest(labels, clusters, trajectories, scale, spacing)
    order = [background, *(cluster for cluster in clusters if cluster != background)]
    renumbered = np.full(len(labels), UNLABELLED, np.int64)
    for position, cluster in enumerate(order):
        renumbered[labels == cluster] = position
    return renumbered


def background_kept(
    labels: Array, parts: Collection[int], trajectories: TrajectoryState, scale: float, spacing: float
) -> Array:
    """Give the name of the background to the part of it that best obeys the camera's motion.

    An object with many trajectories would take it along when it is split off.

    Parameters
    ----------
    labels : (n,) int64
    parts : collection of int
        Labels that were split off the background.
    trajectories, scale, spacing
        As of :func:`background_first`.

    Returns
    -------
    (n,) int64
    """
    if not parts:
        return labels
    background = _steadiest(labels, sorted({BACKGROUND, *parts}), trajectories, scale, spacing)
    swapped = np.where(labels == background, BACKGROUND, labels)
    swapped[labels == BACKGROUND] = background
    return swapped


def _steadiest(
    labels: Array, among: Sequence[int], trajectories: TrajectoryState, scale: float, spacing: float
) -> int:
    """Return the label that obeys the camera's motion in the largest area."""
    residual = np.hypot(trajectories.residuals[:, 0, 0], trajectories.residuals[:, 0, 1])
    obeying = [
        len(evenly_spread(trajectories.positions, (labels == label) & (residual < scale), spacing))
        for label in among
    ]
    return among[int(np.argmax(obeying))]


def outgrowing(
    labels: Array, among: Collection[int], positions: Array, spacing: float, shape: tuple[int, int]
) -> set[int]:
    """Find new labels that cover far more of the picture than the background does.

    After an object has filled the frame, of the background only what was seen before is known as such: a
    piece of the sky, say. What appears around it is the scene.

    Parameters
    ----------
    labels : (n,) int64
    among : collection of int
        The labels to look at.
    positions : (n, 2) float32
        Of the trajectories, px.
    spacing : float
        A square of this side counts once, so that area decides, px.
    shape : (int, int)
        (H, W) of the frame.

    Returns
    -------
    set of int
    """

    def area(label: int) -> float:
        return len(evenly_spread(positions, labels == label, spacing)) * spacing**2

    least = max(OUTGROWING * area(BACKGROUND), LEAST_SCENE * shape[0] * shape[1])
    return {label for label in among if area(label) > least}
