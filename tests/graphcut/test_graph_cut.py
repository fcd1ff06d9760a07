"""The graph cut against enumeration, and against textbook cuts of the whole pixel grid built edge by edge."""

import itertools
import math
from dataclasses import replace
from typing import Any

import maxflow
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mlbs_actors.errors import ConfigError, FrameError
from mlbs_actors.graphcut import expansion_state
from mlbs_actors.graphcut.energy import NEIGHBOUR_OFFSETS, LabelCostEnergy
from mlbs_actors.graphcut.graph_cut import minimise
from mlbs_actors.messages import Array
from mlbs_actors.segmentation.contrast import COST_QUANTUM, MAX_COST, contrast_weights


def in_quanta(nats: Array | float) -> Array:
    return np.rint(np.asarray(nats) / COST_QUANTUM).astype(np.int32)


def laid_out(right: Array, down: Array, down_right: Array, down_left: Array) -> Array:
    """Weights by pixel and direction, from those of the four kinds of pairs."""
    weights = np.zeros((right.shape[0], down.shape[1], 4), np.int32)
    weights[:, :-1, 0], weights[:-1, :, 1] = right, down
    weights[:-1, :-1, 2], weights[:-1, 1:, 3] = down_right, down_left
    return weights


def problem_of(unary: Array, weights: Array, label_costs: Array) -> LabelCostEnergy:
    """From unary and label costs in nats."""
    return LabelCostEnergy(in_quanta(unary), weights, in_quanta(label_costs).astype(np.int64))


def random_problem(seed: int, shape: tuple[int, int, int], label_cost: float) -> LabelCostEnergy:
    rng = np.random.default_rng(seed)
    count, height, width = shape
    unary = rng.uniform(0, rng.choice([1.0, 3.0, 8.0]), shape)
    strength = float(rng.choice([0.2, 0.8, 2.0]))
    shapes = ((height, width - 1), (height - 1, width), (height - 1, width - 1), (height - 1, width - 1))
    weights = laid_out(*(in_quanta(rng.uniform(0, strength, one)) for one in shapes))
    return problem_of(unary, weights, rng.uniform(0, label_cost, count))


def pairs(weights: Array) -> list[tuple[tuple[int, int], tuple[int, int], int]]:
    height, width, _ = weights.shape
    found = []
    for (y, x, k), w in np.ndenumerate(weights):
        other = (y + int(NEIGHBOUR_OFFSETS[k, 0]), x + int(NEIGHBOUR_OFFSETS[k, 1]))
        if other[0] < height and 0 <= other[1] < width:
            found.append(((y, x), other, int(w)))
        else:
            assert w == 0
    return found


def slow_energy(labels: Array, problem: LabelCostEnergy) -> int:
    total = sum(int(problem.unary[label, y, x]) for (y, x), label in np.ndenumerate(labels))
    total += sum(w for one, other, w in pairs(problem.weights) if labels[one] != labels[other])
    return total + sum(int(problem.label_costs[label]) for label in set(labels.ravel().tolist()))


def enumerated_minimum(problem: LabelCostEnergy) -> int:
    count, height, width = problem.unary.shape
    labellings = itertools.product(range(count), repeat=height * width)
    return min(slow_energy(np.reshape(labels, (height, width)), problem) for labels in labellings)


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
    weights = contrast_weights(image, strength=0.8, scale=200.0)
    assert weights.shape == (*shape[:2], 4)
    assert weights.dtype == np.int32
    for one, other, w in pairs(weights):
        squared = float(((image[one].astype(float) - image[other].astype(float)) ** 2).sum())
        length = math.hypot(one[0] - other[0], one[1] - other[1])
        assert abs(w - 0.8 * math.exp(-squared / 200.0) / length / COST_QUANTUM) <= 0.5 + 1e-6


def test_contrast_weights_vanish_between_black_and_white_and_for_no_strength() -> None:
    image = np.zeros((2, 2, 3), np.uint8)
    image[:, 1] = 255
    assert contrast_weights(image)[..., 0].tolist() == [[0, 0], [0, 0]]
    assert contrast_weights(image)[..., 1].tolist() == [[round(0.8 / COST_QUANTUM)] * 2, [0, 0]]
    assert not contrast_weights(image, strength=0.0).any()


def test_an_outline_costs_the_same_along_an_axis_and_along_a_diagonal() -> None:
    weights = contrast_weights(np.zeros((64, 64, 3), np.uint8))
    y, x = np.mgrid[:64, :64]
    none = problem_of(np.zeros((2, 64, 64)), weights, np.zeros(2))
    upright = none.energy((x < 32).astype(int)) / 64
    diagonal = none.energy((x < y).astype(int)) / (64 * math.sqrt(2))
    assert upright == pytest.approx(diagonal, rel=0.03)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(st.integers(0, 10**6), st.integers(1, 4), st.integers(1, 5), st.integers(1, 5))
def test_energy_is_the_sum_over_pixels_pairs_and_labels(
    seed: int, count: int, height: int, width: int
) -> None:
    problem = random_problem(seed, (count, height, width), 5.0)
    labels = np.random.default_rng(seed).integers(0, count, (height, width))
    assert problem.energy(labels) == slow_energy(labels, problem)


@settings(max_examples=80, deadline=None, derandomize=True)
@given(
    st.integers(0, 10**6),
    st.integers(1, 5),
    st.integers(1, 8),
    st.integers(1, 8),
    st.sampled_from([0.0, 4.0]),
)
def test_the_energy_never_rises_and_is_that_of_the_labels(
    seed: int, count: int, height: int, width: int, label_cost: float
) -> None:
    problem = random_problem(seed, (count, height, width), label_cost)
    result = minimise(problem)
    assert list(result.energies) == sorted(result.energies, reverse=True)
    assert result.energy == result.energies[-1] == slow_energy(result.labels, problem)
    assert len(result.energies) == result.sweeps + 1
    assert result.converged


@pytest.mark.parametrize("label_cost", [0.0, 1.0, 6.0])
def test_two_labels_are_cut_exactly(label_cost: float) -> None:
    for seed in range(40):
        problem = random_problem(seed, (2, 3, 3), label_cost)
        assert minimise(problem).energy == enumerated_minimum(problem)


def test_two_labels_on_a_larger_grid_are_cut_as_without_pruning() -> None:
    undecided = 0.0
    for seed in range(6):
        unary, image = blocks_scene(seed, 2, 24, 28)
        problem = problem_of(unary, contrast_weights(image, 1.5), np.zeros(2))
        whole = textbook_expansion(np.zeros((24, 28), int), 1, problem)
        result = minimise(problem)
        assert result.energy == slow_energy(whole, problem)
        assert result.decided_fraction > 0.1
        undecided += 1 - result.decided_fraction
    assert undecided > 0


@pytest.mark.parametrize("label_cost", [0.0, 1.0, 6.0])
def test_three_labels_stay_within_the_expansion_bound_and_mostly_reach_the_optimum(label_cost: float) -> None:
    reached = 0
    for seed in range(20):
        problem = random_problem(seed, (3, 2, 3), label_cost)
        result, optimum = minimise(problem).energy, enumerated_minimum(problem)
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
                free = LabelCostEnergy(problem.unary[allowed], problem.weights, np.zeros(size, np.int64))
                oracle = min(oracle, minimise(free).energy + int(problem.label_costs[allowed].sum()))
        assert minimise(problem).energy <= oracle * 1.005


@pytest.mark.parametrize("label_cost", [0.0, 3.0, 25.0])
def test_no_expansion_on_the_full_graph_lowers_the_pruned_result(label_cost: float) -> None:
    cut = 0.0
    for seed in range(12):
        unary, image = blocks_scene(seed, 4, 14, 16)
        problem = problem_of(unary, contrast_weights(image, 1.2), np.full(4, label_cost))
        result = minimise(problem)
        for alpha in range(4):
            expanded = textbook_expansion(result.labels, alpha, problem)
            assert slow_energy(expanded, problem) >= result.energy
        cut += 1 - result.decided_fraction
    assert cut > 0.1


@pytest.mark.parametrize("label_cost", [0.0, 6.0])
def test_no_expansion_lowers_the_result_where_every_label_meets_every_other(label_cost: float) -> None:
    for seed in range(15, 30):
        problem = random_problem(seed, (4, 7, 8), label_cost)
        result = minimise(problem)
        for alpha in range(4):
            expanded = textbook_expansion(result.labels, alpha, problem)
            assert slow_energy(expanded, problem) >= result.energy


def test_no_expansion_lowers_the_result_although_few_are_tried_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # Three objects, two of them near each other, under weights so strong that hardly a pixel is decided.
    tried, left_out = 0, 0
    worth_expanding = expansion_state._worth_expanding

    def counted(*arguments: Any) -> Array:
        nonlocal tried, left_out
        worth: Array = worth_expanding(*arguments)
        tried, left_out = tried + int(worth.sum()), left_out + int((~worth).sum())
        return worth

    compiled: Any = expansion_state.expand_in_turn
    monkeypatch.setattr(expansion_state, "expand_in_turn", compiled.py_func)
    for seed in range(30):
        rng = np.random.default_rng(seed)
        unary = rng.uniform(0, 3, (4, 12, 30))
        for label, (y, x) in enumerate([(2, 2), (3, 10), (4, 21)], start=1):
            near = np.zeros((12, 30), bool)
            near[y - 2 : y + 8, x - 2 : x + 9] = True
            unary[label][~near] = MAX_COST * COST_QUANTUM
            unary[label, y : y + 5, x : x + 6] -= 2.0
        weights = contrast_weights(rng.integers(90, 110, (12, 30, 3)).astype(np.uint8), 1.5)
        for costs in (np.zeros(4), rng.uniform(0, 30, 4) * (rng.random(4) < 0.5)):
            problem = problem_of(unary, weights, costs)
            with monkeypatch.context() as few:
                few.setattr(expansion_state, "_worth_expanding", counted)
                result = minimise(problem)
            with monkeypatch.context() as all_again:
                all_again.setattr(expansion_state, "_nothing_new", lambda *_: False)
                all_again.setattr(
                    expansion_state, "_worth_expanding", lambda *given: np.ones(given[-1].size, bool)
                )
                np.testing.assert_array_equal(result.labels, minimise(problem).labels)
            for alpha in range(4):
                expanded = textbook_expansion(result.labels, alpha, problem)
                assert slow_energy(expanded, problem) >= result.energy
    assert left_out > tried / 10


def test_the_pruned_result_is_as_low_as_expansion_of_the_full_graph() -> None:
    for seed in range(3):
        unary, image = blocks_scene(seed, 4, 20, 24)
        problem = problem_of(unary, contrast_weights(image, 1.2), np.full(4, 6.0))
        labels, lowest = unary.argmin(axis=0), math.inf
        while (value := slow_energy(labels, problem)) < lowest:
            lowest = value
            for alpha in range(4):
                proposal = textbook_expansion(labels, alpha, problem)
                if slow_energy(proposal, problem) < slow_energy(labels, problem):
                    labels = proposal
        assert minimise(problem).energy <= 1.001 * lowest


def test_a_label_whose_cost_outweighs_its_evidence_disappears() -> None:
    unary = np.full((3, 12, 12), 3.0)
    unary[0] = 0.0
    unary[0, 2:5, 2:5], unary[1, 2:5, 2:5] = 3.0, 0.0  # 27 nats for the label 1
    unary[0, 7:11, 7:11], unary[2, 7:11, 7:11] = 3.0, 0.0  # 48 nats for the label 2
    weights = contrast_weights(np.zeros((12, 12, 3), np.uint8), strength=0.1)

    def used(label_cost: float) -> list[int]:
        result = minimise(problem_of(unary, weights, np.full(3, label_cost)))
        return sorted(set(result.labels.ravel().tolist()))

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
        contrast_weights(np.zeros((8, 12, 3), np.uint8), strength=0.05),
        np.array([0.0, 40.0, 0.0]),
    )
    spurious = np.where(np.arange(12) < 6, 0, 2) * np.ones((8, 1), int)
    shared = spurious.copy()
    spurious[2:6, 4:8] = 1
    for heir in (0, 2):
        handed = np.where(spurious == 1, heir, spurious)
        assert problem.energy(handed) > problem.energy(spurious)
    assert minimise(problem).labels.tolist() == shared.tolist()


def test_an_unused_label_is_not_paid_for() -> None:
    unary = np.stack([np.zeros((4, 4)), np.full((4, 4), 9.0)])
    weights = contrast_weights(np.zeros((4, 4, 3), np.uint8))
    result = minimise(problem_of(unary, weights, np.array([2.0, 100.0])))
    assert result.energy * COST_QUANTUM == 2.0


def test_equal_input_gives_equal_bytes_and_leaves_the_input_alone() -> None:
    unary, image = blocks_scene(2, 4, 30, 40)
    problem = problem_of(unary, contrast_weights(image), np.full(4, 5.0))
    for array in (problem.unary, problem.weights, problem.label_costs):
        array.flags.writeable = False
    first, second = minimise(problem), minimise(problem)
    assert first.labels.tobytes() == second.labels.tobytes()
    assert first.energies == second.energies


def test_max_sweeps_ends_the_search_early_and_says_so() -> None:
    unary, image = blocks_scene(3, 4, 30, 40)
    problem = problem_of(unary, contrast_weights(image, 2.0), np.full(4, 5.0))
    assert minimise(problem).sweeps > 1
    short = minimise(problem, max_sweeps=1)
    assert (short.sweeps, short.converged) == (1, False)


@pytest.mark.parametrize("bad", [2 * MAX_COST, -2 * MAX_COST])
def test_costs_that_cannot_be_cut_are_refused(bad: int) -> None:
    problem = random_problem(0, (2, 4, 4), 1.0)
    unary, weights = problem.unary.copy(), problem.weights.copy()
    unary[1, 2, 3] = weights[1, 1, 0] = bad
    with pytest.raises(ConfigError, match="clip"):
        minimise(replace(problem, unary=unary))
    with pytest.raises(ConfigError, match="clip"):
        minimise(replace(problem, unary=problem.unary.astype(np.float32)))
    with pytest.raises(ConfigError, match="pair weights"):
        minimise(replace(problem, weights=weights))
    for place in ((1, 3, 0), (3, 1, 1), (3, 1, 2), (1, 3, 2), (3, 1, 3), (1, 0, 3)):
        outward = problem.weights.copy()
        outward[place] = 1
        with pytest.raises(ConfigError, match="outside the image"):
            minimise(replace(problem, weights=outward))
    with pytest.raises(ConfigError, match="label costs"):
        minimise(replace(problem, label_costs=np.array([0, -1 if bad < 0 else 2**51])))


def test_arrays_that_do_not_fit_together_are_refused() -> None:
    problem = random_problem(0, (2, 4, 4), 1.0)
    with pytest.raises(ConfigError, match="unary costs of shape"):
        minimise(replace(problem, unary=problem.unary[0]))
    with pytest.raises(ConfigError, match="pair weights of shape"):
        minimise(replace(problem, unary=problem.unary[:, :3]))
    with pytest.raises(ConfigError, match="2 label costs"):
        minimise(replace(problem, label_costs=problem.label_costs[:1]))
    with pytest.raises(ConfigError, match="max_sweeps"):
        minimise(problem, max_sweeps=0)


def test_images_and_parameters_without_contrast_weights_are_refused() -> None:
    image = np.zeros((4, 4, 3), np.uint8)
    for wrong in (image[..., 0], image.astype(np.float32), image[:0]):
        with pytest.raises(FrameError, match="uint8"):
            contrast_weights(wrong)
    for strength, scale in ((-1.0, 200.0), (math.nan, 200.0), (0.8, 0.0), (0.8, math.nan), (0.8, math.inf)):
        with pytest.raises(ConfigError, match="contrast"):
            contrast_weights(image, strength, scale)
