"""The graph cut against enumeration, and against textbook cuts of the whole pixel grid built edge by edge."""

import copy
import itertools
import math
from typing import Any

import maxflow
import numpy as np
import pytest
from energy_fakes import (
    MAX_COST,
    MOST_WHOLE,
    energy_of,
    enumerated_minimum,
    pairs,
    problem_of,
    random_problem,
    slow_energy,
    weights_of_image,
)
from hypothesis import given, settings
from hypothesis import strategies as st

from mlbs_actors.graphcut.energy import LabelCostEnergy
from mlbs_actors.graphcut.graph_cut import minimise
from mlbs_actors.graphcut.persistency import prune
from mlbs_actors.messages import Array
from mlbs_actors.segmentation.contrast import COST_QUANTUM


def energy_found(problem: LabelCostEnergy) -> int:
    return slow_energy(minimise(problem, MOST_WHOLE), problem)


def undecided_share(problem: LabelCostEnergy) -> float:
    labels, rest = prune(problem)
    return rest.pixels.size / labels.size


def textbook_expansion(labels: Array, alpha: int, problem: LabelCostEnergy) -> Array:
    """The best expansion: every pixel a node, every label a star, the cost of alpha in the graph too."""
    unary, label_costs = problem.unary, problem.label_costs
    graph: Any = maxflow.GraphFloat()
    node = graph.add_grid_nodes(labels.shape)
    for place, label in np.ndenumerate(labels):
        stay = math.inf if label == alpha else float(unary[(label, *place)])
        graph.add_tedge(node[place], float(unary[(alpha, *place)]), min(stay, 1e12))
    for one, other, w in pairs(problem.weights):
        apart = w if labels[one] != labels[other] else 0.0
        one_stays = w if labels[one] != alpha else 0.0
        other_stays = w if labels[other] != alpha else 0.0
        # Source side: stay. E(stay, stay) = apart, E(move, move) = 0.
        graph.add_tedge(node[one], 0.0, apart - other_stays)
        graph.add_tedge(node[other], 0.0, other_stays)
        graph.add_edge(node[one], node[other], one_stays + other_stays - apart, 0.0)
    for label in set(labels.ravel().tolist()) - {alpha}:
        (hub,) = graph.add_nodes(1)
        graph.add_tedge(hub, 0.0, float(label_costs[label]))
        for member in node[labels == label]:
            graph.add_edge(member, hub, float(label_costs[label]), 0.0)
    if alpha not in labels:
        (hub,) = graph.add_nodes(1)
        graph.add_tedge(hub, float(label_costs[alpha]), 0.0)
        for pixel in node.ravel():
            graph.add_edge(hub, pixel, float(label_costs[alpha]), 0.0)
    graph.maxflow()
    return np.where(graph.get_grid_segments(node), alpha, labels)


def blocks_scene(seed: int, label_count: int, height: int, width: int) -> tuple[Array, Array]:
    """Noisy unary costs of a few rectangles on label 0, and an image of them."""
    rng = np.random.default_rng(seed)
    truth = np.zeros((height, width), int)
    for label in range(1, label_count):
        y, x = rng.integers(0, height - 8), rng.integers(0, width - 8)
        truth[y : y + 8, x : x + 8] = label
    unary = 2.0 * (np.arange(label_count)[:, None, None] != truth) + rng.normal(
        0, 1.2, (label_count, height, width)
    )
    image = np.clip(40 * truth[..., None] + rng.normal(80, 6, (height, width, 3)), 0, 255).astype(np.uint8)
    return np.clip(unary, 0, None), image


@pytest.mark.parametrize("shape", [(7, 9, 3), (1, 6, 3), (6, 1, 3), (1, 1, 3)])
def test_contrast_weights_follow_the_formula_pixel_by_pixel(shape: tuple[int, int, int]) -> None:
    image = np.random.default_rng(0).integers(90, 130, shape).astype(np.uint8)
    weights = weights_of_image(image, strength=0.8, scale=200.0)
    assert weights.shape == (*shape[:2], 4)
    assert weights.dtype == np.int32
    for one, other, w in pairs(weights):
        squared = float(((image[one].astype(float) - image[other].astype(float)) ** 2).sum())
        length = math.hypot(one[0] - other[0], one[1] - other[1])
        assert abs(w - 0.8 * math.exp(-squared / 200.0) / length / COST_QUANTUM) <= 0.5 + 1e-6


def test_contrast_weights_vanish_between_black_and_white_and_for_no_strength() -> None:
    image = np.zeros((2, 2, 3), np.uint8)
    image[:, 1] = 255
    assert weights_of_image(image)[..., 0].tolist() == [[0, 0], [0, 0]]
    assert weights_of_image(image)[..., 1].tolist() == [[round(0.8 / COST_QUANTUM)] * 2, [0, 0]]
    assert not weights_of_image(image, strength=0.0).any()


def test_an_outline_costs_the_same_along_an_axis_and_along_a_diagonal() -> None:
    weights = weights_of_image(np.zeros((64, 64, 3), np.uint8))
    y, x = np.mgrid[:64, :64]
    none = problem_of(np.zeros((2, 64, 64)), weights, np.zeros(2))
    upright = slow_energy((x < 32).astype(int), none) / 64
    diagonal = slow_energy((x < y).astype(int), none) / (64 * math.sqrt(2))
    assert upright == pytest.approx(diagonal, rel=0.03)


@settings(max_examples=80, deadline=None, derandomize=True)
@given(
    st.integers(0, 10**6),
    st.integers(1, 5),
    st.integers(1, 8),
    st.integers(1, 8),
    st.sampled_from([0.0, 4.0]),
)
def test_no_labelling_with_one_label_is_better(
    seed: int, count: int, height: int, width: int, label_cost: float
) -> None:
    problem = random_problem(seed, (count, height, width), label_cost)
    labels = minimise(problem, MOST_WHOLE)
    assert labels.dtype == np.int16
    for label in range(count):
        assert slow_energy(labels, problem) <= slow_energy(np.full((height, width), label), problem)


@pytest.mark.parametrize("label_cost", [0.0, 1.0, 6.0])
def test_two_labels_are_cut_exactly(label_cost: float) -> None:
    for seed in range(40):
        problem = random_problem(seed, (2, 3, 3), label_cost)
        assert energy_found(problem) == enumerated_minimum(problem)


def test_two_labels_on_a_larger_grid_are_cut_as_without_pruning() -> None:
    undecided = 0.0
    for seed in range(6):
        unary, image = blocks_scene(seed, 2, 24, 28)
        problem = problem_of(unary, weights_of_image(image, 1.5), np.zeros(2))
        whole = textbook_expansion(np.zeros((24, 28), int), 1, problem)
        assert energy_found(problem) == slow_energy(whole, problem)
        undecided += undecided_share(problem)
        assert undecided_share(problem) < 0.9
    assert undecided > 0


@pytest.mark.parametrize("label_cost", [0.0, 1.0, 6.0])
def test_three_labels_stay_within_the_expansion_bound_and_mostly_reach_the_optimum(label_cost: float) -> None:
    reached = 0
    for seed in range(20):
        problem = random_problem(seed, (3, 2, 3), label_cost)
        result, optimum = energy_found(problem), enumerated_minimum(problem)
        assert optimum <= result <= 2 * optimum + int(problem.label_costs.sum())
        reached += result == optimum
    assert reached >= 18


def test_label_costs_act_as_the_best_choice_among_all_sets_of_labels() -> None:
    # Oracle: for each set of allowed labels, the cut without label costs plus the costs of the set.
    for seed in range(25):
        problem = random_problem(seed, (3, 4, 4), 8.0)
        oracle = math.inf
        for size in (1, 2, 3):
            for allowed in map(list, itertools.combinations(range(3), size)):
                free = energy_of(problem.unary[allowed], problem.weights, np.zeros(size, np.int64))
                oracle = min(oracle, energy_found(free) + int(problem.label_costs[allowed].sum()))
        assert energy_found(problem) <= oracle * 1.005


@pytest.mark.parametrize("label_cost", [0.0, 3.0, 25.0])
def test_no_expansion_on_the_full_graph_lowers_the_pruned_result(label_cost: float) -> None:
    cut = 0.0
    for seed in range(12):
        unary, image = blocks_scene(seed, 4, 14, 16)
        problem = problem_of(unary, weights_of_image(image, 1.2), np.full(4, label_cost))
        labels = minimise(problem, MOST_WHOLE)
        for alpha in range(4):
            expanded = textbook_expansion(labels, alpha, problem)
            assert slow_energy(expanded, problem) >= slow_energy(labels, problem)
        cut += undecided_share(problem)
    assert cut > 0.1


@pytest.mark.parametrize("label_cost", [0.0, 6.0])
def test_no_expansion_lowers_the_result_where_every_label_meets_every_other(label_cost: float) -> None:
    for seed in range(15, 30):
        problem = random_problem(seed, (4, 7, 8), label_cost)
        labels = minimise(problem, MOST_WHOLE)
        for alpha in range(4):
            expanded = textbook_expansion(labels, alpha, problem)
            assert slow_energy(expanded, problem) >= slow_energy(labels, problem)


def test_no_expansion_lowers_the_result_where_objects_are_near_each_other() -> None:
    # Three objects, two of them near each other, under weights so strong that hardly a pixel is decided: what
    # has not changed since it was last expanded is left out.
    for seed in range(30):
        rng = np.random.default_rng(seed)
        unary = rng.uniform(0, 3, (4, 12, 30))
        for label, (y, x) in enumerate([(2, 2), (3, 10), (4, 21)], start=1):
            near = np.zeros((12, 30), bool)
            near[y - 2 : y + 8, x - 2 : x + 9] = True
            unary[label][~near] = MAX_COST * COST_QUANTUM
            unary[label, y : y + 5, x : x + 6] -= 2.0
        weights = weights_of_image(rng.integers(90, 110, (12, 30, 3)).astype(np.uint8), 1.5)
        for costs in (np.zeros(4), rng.uniform(0, 30, 4) * (rng.random(4) < 0.5)):
            problem = problem_of(unary, weights, costs)
            labels = minimise(problem, MOST_WHOLE)
            assert undecided_share(problem) > 0.5
            for alpha in range(4):
                expanded = textbook_expansion(labels, alpha, problem)
                assert slow_energy(expanded, problem) >= slow_energy(labels, problem)


def test_the_pruned_result_is_as_low_as_expansion_of_the_full_graph() -> None:
    for seed in range(3):
        unary, image = blocks_scene(seed, 4, 20, 24)
        problem = problem_of(unary, weights_of_image(image, 1.2), np.full(4, 6.0))
        labels, lowest = unary.argmin(axis=0), math.inf
        while (value := slow_energy(labels, problem)) < lowest:
            lowest = value
            for alpha in range(4):
                proposal = textbook_expansion(labels, alpha, problem)
                if slow_energy(proposal, problem) < slow_energy(labels, problem):
                    labels = proposal
        assert energy_found(problem) <= 1.001 * lowest


def test_a_label_whose_cost_outweighs_its_evidence_disappears() -> None:
    unary = np.full((3, 12, 12), 3.0)
    unary[0] = 0.0
    unary[0, 2:5, 2:5], unary[1, 2:5, 2:5] = 3.0, 0.0  # 27 nats for the label 1
    unary[0, 7:11, 7:11], unary[2, 7:11, 7:11] = 3.0, 0.0  # 48 nats for the label 2
    weights = weights_of_image(np.zeros((12, 12, 3), np.uint8), strength=0.1)

    def used(label_cost: float) -> list[int]:
        labels = minimise(problem_of(unary, weights, np.full(3, label_cost)), MOST_WHOLE)
        return sorted(set(labels.ravel().tolist()))

    assert used(0.0) == [0, 1, 2]
    assert used(15.0) == [0, 1, 2]
    assert used(35.0) == [0, 2]
    assert used(60.0) == [0]


def test_a_label_that_lies_on_two_others_is_shared_out_to_both() -> None:
    # Label 1 lies across the border of 0 and 2. To hand it to either one alone costs more than it saves.
    unary = np.full((3, 8, 12), 30.0)
    unary[0, :, :6] = unary[2, :, 6:] = 1.0
    unary[1, 2:6, 4:8] = 0.0
    problem = problem_of(
        unary,
        weights_of_image(np.zeros((8, 12, 3), np.uint8), strength=0.05),
        np.array([0.0, 40.0, 0.0]),
    )
    spurious = np.where(np.arange(12) < 6, 0, 2) * np.ones((8, 1), int)
    shared = spurious.copy()
    spurious[2:6, 4:8] = 1
    for heir in (0, 2):
        handed = np.where(spurious == 1, heir, spurious)
        assert slow_energy(handed, problem) > slow_energy(spurious, problem)
    assert minimise(problem, MOST_WHOLE).tolist() == shared.tolist()


def test_an_unused_label_is_not_paid_for() -> None:
    unary = np.stack([np.zeros((4, 4)), np.full((4, 4), 9.0)])
    weights = weights_of_image(np.zeros((4, 4, 3), np.uint8))
    assert energy_found(problem_of(unary, weights, np.array([2.0, 100.0]))) * COST_QUANTUM == 2.0


def test_what_is_given_is_only_read() -> None:
    unary, image = blocks_scene(2, 4, 30, 40)
    problem = problem_of(unary, weights_of_image(image), np.full(4, 5.0))
    before = copy.deepcopy(problem)
    for most in (MOST_WHOLE, (600,)):  # the whole image, and blocks first
        assert minimise(problem, most).any()
    for array, as_it_was in zip(problem, before, strict=True):
        np.testing.assert_array_equal(array, as_it_was)
