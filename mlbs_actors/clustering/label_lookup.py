"""Vectorised lookup of labels in the registry's sorted label array (§4)."""

from __future__ import annotations

import numpy as np

from mlbs_actors.clustering.label_index import UNLABELLED, label_places
from mlbs_actors.kernels.jit import compiled
from mlbs_actors.messages import BACKGROUND, Array

__all__ = ["layers_of", "sightings"]


@compiled
def layers_of(labels: Array, known: Array, origins: Array, pooled: Array, other: int) -> Array:
    """Return layer ids of labels (n,) int64, −1 for none; see `LayerRegistry.layers_of`."""
    rows, origin_rows = label_places(labels, known), label_places(origins, known)
    layers = np.empty(labels.size, np.int64)
    for i in range(labels.size):
        label, row = labels[i], rows[i]
        if label < BACKGROUND:
            label, row = (origins[row], origin_rows[row]) if row >= 0 else (UNLABELLED, -1)
        layers[i] = other if row >= 0 and pooled[row] else label
    return layers


@compiled
def sightings(known: Array, labels: Array, positions: Array, motions: Array) -> tuple[Array, Array, Array]:
    """Return the row of each trajectory's label, −1 if it is not known; how many each row has, and their mean
    positions and motions (k, 4)."""
    rows = label_places(labels, known)
    counts, means = np.zeros(known.size, np.int64), np.zeros((known.size, 4), np.float32)
    for i in range(labels.size):
        row = rows[i]
        if row >= 0:
            counts[row] += 1
            for axis in range(2):
                means[row, axis] += positions[i, axis]
                means[row, 2 + axis] += motions[i, axis]
    for row in range(known.size):
        means[row] /= np.float32(max(counts[row], 1))
    return rows, counts, means
