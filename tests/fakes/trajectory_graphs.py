"""Graphs of trajectories for tests, and what plain loops find on them."""

from __future__ import annotations

import numpy as np

from mlbs_actors.clustering.affinity import TrajectoryGraph
from mlbs_actors.clustering.label_index import UNLABELLED
from mlbs_actors.messages import Array


def graph_of(edges: list[tuple[int, int, float]], size: int) -> TrajectoryGraph:
    """A graph from (first, second, motion distance)."""
    first, second, distance = (np.array(column) for column in zip(*edges, strict=True))
    distance = distance.astype(np.float32)
    return TrajectoryGraph(first.astype(np.int32), second.astype(np.int32), distance, np.exp(-distance), size)


def random_graph(rng: np.random.Generator, size: int, edges: int) -> TrajectoryGraph:
    pairs = sorted({tuple(sorted(rng.choice(size, 2, replace=False).tolist())) for _ in range(edges)})
    return graph_of([(i, j, float(rng.exponential(3.0))) for i, j in pairs], size)


def plain_borders(graph: TrajectoryGraph, labels: Array) -> dict[tuple[int, int], list[float]]:
    """Lower and higher label → the motion distances of the edges between them, ascending."""
    across: dict[tuple[int, int], list[float]] = {}
    for i, j, distance in zip(graph.first, graph.second, graph.motion_distance, strict=True):
        low, high = sorted((int(labels[i]), int(labels[j])))
        if low != high and UNLABELLED not in (low, high):
            across.setdefault((low, high), []).append(float(distance))
    return {between: sorted(distances) for between, distances in across.items()}


def at_quantile(distances: list[float], quantile: float) -> float:
    return distances[min(int(quantile * len(distances)), len(distances) - 1)]
