"""How motion changes across borders, and inside clusters."""

from __future__ import annotations

import numpy as np
import pytest
from trajectory_graphs import at_quantile, graph_of, plain_borders, random_graph

from mlbs_actors.clustering.border_motion import border_motion, inner_motion
from mlbs_actors.clustering.label_index import UNLABELLED, label_classes


@pytest.mark.parametrize("quantile", [0.0, 0.3, 0.5, 1.0])
def test_the_motion_across_a_border_is_that_of_plain_loops(quantile: float) -> None:
    rng = np.random.default_rng(0)
    graph, labels = random_graph(rng, 40, 250), rng.choice([UNLABELLED, -2, 0, 1, 5], 40)
    known, classes = label_classes(labels, labels == UNLABELLED)
    borders, distances, edges = border_motion(
        graph.first, graph.second, graph.motion_distance, classes, len(known), quantile
    )
    expected = plain_borders(graph, labels)
    assert len(expected) == 6
    assert [tuple(one) for one in known[borders].tolist()] == sorted(expected)
    for between, distance, count in zip(sorted(expected), distances, edges, strict=True):
        assert (distance, count) == (at_quantile(expected[between], quantile), len(expected[between]))


def test_labels_that_do_not_touch_have_no_border() -> None:
    graph = graph_of([(0, 1, 1.0), (2, 3, 1.0)], 4)
    borders, *_ = border_motion(
        graph.first, graph.second, graph.motion_distance, np.array([0, 0, 1, 1]), 2, 0.3
    )
    assert len(borders) == 0


@pytest.mark.parametrize("quantile", [0.0, 0.5, 0.9, 1.0])
def test_the_motion_inside_a_class_is_that_of_plain_loops(quantile: float) -> None:
    rng = np.random.default_rng(1)
    graph, classes = random_graph(rng, 40, 250), rng.choice([-1, 0, 1, 3], 40)
    inside = inner_motion(graph.first, graph.second, graph.motion_distance, classes, 4, quantile)
    for one in range(4):
        distances = sorted(
            float(distance)
            for i, j, distance in zip(graph.first, graph.second, graph.motion_distance, strict=True)
            if classes[i] == classes[j] == one
        )
        assert inside[one] == (at_quantile(distances, quantile) if distances else 0)
    assert inside[2] == 0
