"""The fast way through the levels of a graph cut against the general one."""

from __future__ import annotations

import numpy as np
import pytest
from test_coarse_cut import moving_scene
from test_graph_cut import random_problem

from mlbs_actors.graphcut import graph_cut
from mlbs_actors.graphcut.energy import LabelCostEnergy
from mlbs_actors.graphcut.graph_cut import lowest_labels, minimise
from mlbs_actors.messages import Array


@pytest.fixture
def general_ways(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The levels that had to be labelled in the general way, in `lowest_labels`."""
    levels: list[int] = []
    minimise_level = graph_cut._minimise

    def noted(
        whole: LabelCostEnergy, max_sweeps: int, level: int = 0
    ) -> tuple[Array, list[int], bool, float]:
        levels.append(level)
        return minimise_level(whole, max_sweeps, level)

    monkeypatch.setattr(graph_cut, "_minimise", noted)
    return levels


@pytest.mark.parametrize("label_cost", [0.0, 5.0, 40.0])
def test_the_fast_way_gives_the_labels_of_the_general_one(label_cost: float, general_ways: list[int]) -> None:
    problems = [random_problem(seed, (4, 9, 11), label_cost) for seed in range(40)]
    fast = [lowest_labels(problem) for problem in problems]
    assert len(general_ways) < len(problems)
    for problem, labels in zip(problems, fast, strict=True):
        assert labels.dtype == np.int16
        np.testing.assert_array_equal(labels, minimise(problem).labels)


def test_what_the_fast_way_cannot_do_is_done_in_the_general_one(general_ways: list[int]) -> None:
    for seed in range(200):
        lowest_labels(random_problem(seed, (4, 9, 11), 5.0))
    assert general_ways


@pytest.mark.parametrize("large", [(8192, 8192), (1000, 8192), (1000, 500)])
def test_so_it_does_coarse_to_fine(
    large: tuple[int, ...], monkeypatch: pytest.MonkeyPatch, general_ways: list[int]
) -> None:
    monkeypatch.setattr(graph_cut, "MOST_CUT_WHOLE", large)
    fast = [lowest_labels(moving_scene(seed)) for seed in range(8)]
    assert len(general_ways) < 8
    for seed, labels in enumerate(fast):
        np.testing.assert_array_equal(labels, minimise(moving_scene(seed)).labels)
