"""The pruning against plain enumeration of all labellings, and of all moves, of small images."""

import itertools
from dataclasses import dataclass

import numpy as np
import pytest

from mlbs_actors.graphcut.energy import (
    NEIGHBOUR_OFFSETS,
    UNDECIDED,
    LabelCostEnergy,
    UndecidedEnergy,
)
from mlbs_actors.graphcut.persistency import movable, prune
from mlbs_actors.messages import Array


def laid_out(right: Array, down: Array, down_right: Array, down_left: Array) -> Array:
    """Weights by pixel and direction, from those of the four kinds of pairs."""
    weights = np.zeros((right.shape[0], down.shape[1], 4), np.int32)
    weights[:, :-1, 0], weights[:-1, :, 1] = right, down
    weights[:-1, :-1, 2], weights[:-1, 1:, 3] = down_right, down_left
    return weights


def random_energy(seed: int, shape: tuple[int, int, int], label_cost: int) -> LabelCostEnergy:
    """Small integers, so that ties and borderline cases are frequent."""
    rng = np.random.default_rng(seed)
    label_count, height, width = shape
    reach = int(rng.integers(1, 6))
    weights = laid_out(
        rng.integers(0, reach, (height, width - 1)),
        rng.integers(0, reach, (height - 1, width)),
        rng.integers(0, reach, (height - 1, width - 1)),
        rng.integers(0, reach, (height - 1, width - 1)),
    )
    return LabelCostEnergy(
        rng.integers(0, int(rng.choice([8, 20, 60])), shape).astype(np.int32),
        weights,
        rng.integers(0, label_cost + 1, label_count).astype(np.int64),
    )


@dataclass(frozen=True)
class Enumeration:
    labellings: Array  # (N, H·W)
    energies: Array  # (N,)


def enumerate_labellings(whole: LabelCostEnergy) -> Enumeration:
    label_count, height, width = whole.unary.shape
    labellings = np.array(list(itertools.product(range(label_count), repeat=height * width)))
    return Enumeration(labellings, slow_energies(whole, labellings))


def movable_of(rest: UndecidedEnergy, labels: Array, alpha: int) -> tuple[Array, Array]:
    """Pixels and kept labels; the prices are checked on the way."""
    offers = rest.offers
    own = slice(offers.first[alpha], offers.first[alpha + 1])
    pixels, price, kept = movable(
        offers.pixel[own],
        offers.cost[own],
        offers.chosen(labels),
        rest.neighbour,
        rest.weight,
        rest.label_costs,
        labels,
        np.bincount(labels, minlength=rest.label_costs.size),
        alpha,
    )
    for pixel, dearer in zip(pixels, price, strict=True):
        cost = costs_of(rest, alpha), costs_of(rest, int(labels[pixel]))
        assert dearer == cost[0][pixel] - cost[1][pixel]
    return pixels, kept


def costs_of(rest: UndecidedEnergy, label: int) -> dict[int, int]:
    offers = rest.offers
    own = slice(offers.first[label], offers.first[label + 1])
    return dict(zip(offers.pixel[own].tolist(), offers.cost[own].tolist(), strict=True))


def slow_energies(whole: LabelCostEnergy, labellings: Array) -> Array:
    label_count, height, width = whole.unary.shape
    energies = np.zeros(len(labellings), np.int64)
    for y, x in itertools.product(range(height), range(width)):
        here = labellings[:, y * width + x]
        energies += whole.unary[here, y, x]
        for k, (dy, dx) in enumerate(NEIGHBOUR_OFFSETS):
            if 0 <= y + dy < height and 0 <= x + dx < width and k < 4:
                there = labellings[:, (y + dy) * width + x + dx]
                energies += whole.weights[y, x, k] * (here != there)
    for label in range(label_count):
        energies += whole.label_costs[label] * (labellings == label).any(axis=1)
    return energies


SHAPES = [(2, 3, 3), (3, 2, 4), (3, 1, 6), (2, 4, 2)]


@pytest.mark.parametrize("label_cost", [0, 30, 150])
@pytest.mark.parametrize("shape", SHAPES)
def test_every_optimum_has_the_decided_labels(shape: tuple[int, int, int], label_cost: int) -> None:
    decided_pixels = undecided_pixels = 0
    for seed in range(60):
        whole = random_energy(seed, shape, label_cost)
        pruning = prune(whole)
        every = enumerate_labellings(whole)
        optima = every.labellings[every.energies == every.energies.min()]
        decided = pruning.labels.reshape(-1) != UNDECIDED
        assert (optima[:, decided] == pruning.labels.reshape(-1)[decided]).all()
        assert set(np.flatnonzero(pruning.rest.elsewhere)) == set(pruning.labels.reshape(-1)[decided])
        decided_pixels += int(decided.sum())
        undecided_pixels += int((~decided).sum())
    assert decided_pixels > 20
    assert undecided_pixels > 20


@pytest.mark.parametrize("shape", SHAPES)
def test_the_energy_that_is_left_differs_from_the_whole_by_a_constant(shape: tuple[int, int, int]) -> None:
    rng = np.random.default_rng(7)
    compared = 0
    for seed in range(40):
        whole = random_energy(seed, shape, 30)
        pruning = prune(whole)
        rest = pruning.rest
        differences = set()
        for _ in range(6):
            labels = pruning.labels.copy()
            undecided = rng.integers(0, shape[0], rest.pixels.size)
            labels.reshape(-1)[rest.pixels] = undecided
            slow = int(slow_energies(whole, labels.reshape(1, -1))[0])
            assert whole.energy(labels) == slow
            differences.add(slow - rest.energy(undecided))
        assert len(differences) == 1
        compared += 0 < rest.pixels.size < labels.size
    assert compared > 3


@pytest.mark.parametrize("label_cost", [0, 30])
def test_no_best_expansion_moves_a_pixel_that_is_left_out(label_cost: int) -> None:
    left_out = emptied = 0
    for seed in range(150):
        whole = random_energy(seed, (3, 3, 3), label_cost)
        rest = prune(whole).rest
        count = rest.pixels.size
        labels = np.random.default_rng(seed).integers(0, 3, count)
        for alpha in range(3):
            pixels, kept = movable_of(rest, labels, alpha)
            moves = np.array(list(itertools.product([False, True], repeat=count)), bool)
            moves = moves[~(moves & (labels == alpha)).any(axis=1)]
            energies = np.array([rest.energy(np.where(move, alpha, labels)) for move in moves])
            may_move = np.isin(np.arange(count), pixels)
            for move in moves[energies == energies.min()]:
                assert not move[~may_move].any()
                for label in set(labels[labels != alpha].tolist()):
                    if kept[label] and rest.label_costs[label] > 0:
                        assert (labels[~move] == label).any()
                    emptied += not (labels[~move] == label).any()
            left_out += int((~may_move & (labels != alpha)).sum())
    assert left_out > 50
    assert emptied > 20


def flat_energy(unary: Array, weight: int, label_costs: list[int]) -> LabelCostEnergy:
    _, height, width = unary.shape
    weights = laid_out(
        np.full((height, width - 1), weight),
        np.full((height - 1, width), weight),
        np.full((height - 1, width - 1), weight),
        np.full((height - 1, width - 1), weight),
    )
    return LabelCostEnergy(unary.astype(np.int32), weights, np.array(label_costs, np.int64))


def test_a_decided_neighbour_decides_the_next_pixel() -> None:
    # Only the first pixel beats its weight at once; in a row each decided pixel then tips the next.
    unary = np.array([[[0, 0, 0, 0]], [[10, 1, 1, 1]]])
    assert prune(flat_energy(unary, 3, [0, 0])).labels.tolist() == [[0, 0, 0, 0]]
    unary[1, 0, 0] = 3
    assert prune(flat_energy(unary, 3, [0, 0])).labels.tolist() == [[UNDECIDED] * 4]


def test_pixels_pay_for_a_label_together() -> None:
    unary = np.array([[[9, 9, 9]], [[0, 0, 0]]])  # margins 9 − 2 = 7, 9 − 4 = 5 and 7: together 19
    assert prune(flat_energy(unary, 2, [0, 18])).labels.tolist() == [[1, 1, 1]]
    assert prune(flat_energy(unary, 2, [0, 19])).labels.tolist() == [[UNDECIDED] * 3]


def test_a_margin_of_zero_decides_nothing() -> None:
    unary = np.array([[[0, 0]], [[4, 4]]])
    assert (prune(flat_energy(unary, 4, [0, 0])).labels == UNDECIDED).all()
    assert (prune(flat_energy(unary, 3, [0, 0])).labels == 0).all()


def test_a_single_label_is_decided_everywhere() -> None:
    pruning = prune(flat_energy(np.ones((1, 2, 3)), 5, [1000]))
    assert (pruning.labels == 0).all()
    assert pruning.rest.pixels.size == 0
