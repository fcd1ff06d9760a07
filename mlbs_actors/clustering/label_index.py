"""Labels of trajectories numbered as classes 0 … k−1, and statistics of all classes at once (§4)."""

from __future__ import annotations

import numpy as np

from mlbs_actors.kernels.jit import compiled
from mlbs_actors.messages import Array

__all__ = [
    "UNLABELLED",
    "class_medians",
    "distinct_labels",
    "label_classes",
    "label_places",
    "likeliest",
    "median_length",
]

#: Label of a trajectory that belongs to no layer.
UNLABELLED = -1
#: Size of a cache of labels by their lowest bits: there are few labels, looked up often and in no order, so
#: that the branches of a search would be mispredicted.
REMEMBERED = 256


@compiled
def label_classes(labels: Array, left_out: Array) -> tuple[Array, Array]:
    """Number the distinct labels.

    Parameters
    ----------
    labels : (n,) int64
        Few of them differ.
    left_out : (n,) bool
        Which to ignore.

    Returns
    -------
    known : (k,) int64
        The distinct labels, ascending.
    classes : (n,) int64
        Index of each one's label in ``known``, −1 for those left out.
    """
    known = _known_labels(labels, left_out)
    classes = label_places(labels, known)
    for i in range(labels.size):
        if left_out[i]:
            classes[i] = -1
    return known, classes


@compiled
def label_places(labels: Array, known: Array) -> Array:
    """Find labels among the known ones.

    Parameters
    ----------
    labels : (n,) int64
    known : (k,) int64
        Ascending.

    Returns
    -------
    (n,) int64
        Index in ``known``; −1 for a label that is not there.
    """
    places = np.empty(labels.size, np.int64)
    # Initial values that match no label: none of them has its slot's lowest bits.
    asked, answers = np.arange(1, REMEMBERED + 1), np.empty(REMEMBERED, np.int64)
    for i in range(labels.size):
        slot = labels[i] & (REMEMBERED - 1)
        if asked[slot] != labels[i]:
            place = np.searchsorted(known, labels[i])
            is_known = place < known.size and known[place] == labels[i]
            asked[slot], answers[slot] = labels[i], place if is_known else -1
        places[i] = answers[slot]
    return places


@compiled
def _known_labels(labels: Array, left_out: Array) -> Array:
    """Return the distinct labels, ascending."""
    known, count = np.empty(labels.size, np.int64), 0
    cached = np.arange(1, REMEMBERED + 1)  # no label matches: none of them has its slot's lowest bits
    for i in range(labels.size):
        slot = labels[i] & (REMEMBERED - 1)
        if left_out[i] or cached[slot] == labels[i]:
            continue
        cached[slot] = labels[i]
        place = np.searchsorted(known[:count], labels[i])
        if place == count or known[place] != labels[i]:
            for later in range(count, place, -1):
                known[later] = known[later - 1]
            known[place] = labels[i]
            count += 1
    return known[:count].copy()


def distinct_labels(labels: Array) -> set[int]:
    """Return the labels of trajectories (n,), without −1."""
    return set(_known_labels(labels, labels == UNLABELLED).tolist())


@compiled
def likeliest(share: Array, known: Array) -> Array:
    """Return the label of the largest share of each row (n, k), the first of equals; −1 where all are 0."""
    labels = np.full(len(share), UNLABELLED, np.int64)
    for i in range(len(share)):
        largest = 0.0
        for one in range(known.size):
            if share[i, one] > largest:
                largest, labels[i] = share[i, one], known[one]
    return labels


@compiled
def class_medians(values: Array, classes: Array, count: int) -> Array:
    """Return the median of each class's values (n,), (count,) float64; no class may be empty."""
    starts, medians = np.zeros(count + 1, np.int64), np.empty(count)
    for i in range(classes.size):
        if classes[i] >= 0:
            starts[classes[i] + 1] += 1
    starts = np.cumsum(starts)
    place, ordered = starts[:-1].copy(), np.empty(starts[-1], values.dtype)
    for i in range(classes.size):
        if classes[i] >= 0:
            ordered[place[classes[i]]] = values[i]
            place[classes[i]] += 1
    for one in range(count):
        medians[one] = np.median(ordered[starts[one] : starts[one + 1]])
    return medians


@compiled
def median_length(vectors: Array, chosen: Array) -> float:
    """Return the median length of the chosen vectors (n, 2); NaN if there are none."""
    lengths, found = np.empty(chosen.size, vectors.dtype), 0
    for i in range(chosen.size):
        if chosen[i]:
            lengths[found] = np.hypot(vectors[i, 0], vectors[i, 1])
            found += 1
    return float(np.median(lengths[:found])) if found else np.nan
