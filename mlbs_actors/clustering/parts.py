"""What belongs to an object that is known already: clusters that appear on its mask (§4).

Not in the paper. An object that turns, or swings a limb, loses the trajectories on it, and the new ones move
as the old ones never did: they are a cluster of their own. But they lie on the object's mask.
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from mlbs_actors.messages import BACKGROUND, Array, Segmentation

__all__ = ["objects_beneath"]

#: Share of a cluster's trajectories on one object's mask from which on it is a part of that.
LEAST_ON_MASK = 0.5


def objects_beneath(
    clusters: Collection[int],
    labels: Array,
    positions: Array,
    motions: Array,
    frame_index: int,
    latest: Segmentation | None,
) -> dict[int, int]:
    """Find the object that each cluster appears on.

    Parameters
    ----------
    clusters : collection of int
        Labels to look at, each of at least one trajectory.
    labels : (n,) int64
        Label of each trajectory.
    positions, motions : (n, 2) float32
        Positions and backward motions of the trajectories, px.
    frame_index : int
        Of the trajectories.
    latest : Segmentation or None
        Of a frame shortly before.

    Returns
    -------
    dict of int to int
        Label → layer id of the object; without those that lie on none.
    """
    if latest is None or not latest.layers:
        return {}
    height, width = latest.labels.shape
    beneath = {}
    for label in sorted(clusters):
        own = labels == label
        places = positions[own] + np.float32(frame_index - latest.frame_index) * motions[own]
        x, y = np.rint(places).astype(np.intp).T
        layers = latest.labels[np.clip(y, 0, height - 1), np.clip(x, 0, width - 1)]
        counts = np.bincount(layers)
        counts[BACKGROUND] = 0
        if counts.max() >= LEAST_ON_MASK * layers.size:
            beneath[label] = int(counts.argmax())
    return beneath
