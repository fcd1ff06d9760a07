"""What a cut of a dense graph costs, for the tests of the clustering."""

from __future__ import annotations

import numpy as np

from mlbs_actors.messages import Array


def ncut_value(affinity: Array, side: Array) -> float:
    """N-cut of the nodes (n,) bool on one side from the others; inf if one side has no volume."""
    degree = affinity.sum(axis=1)
    inside, outside = float(degree[side].sum()), float(degree[~side].sum())
    if inside <= 0 or outside <= 0:
        return float("inf")
    across = float(affinity[np.ix_(side, ~side)].sum())
    return across / inside + across / outside
