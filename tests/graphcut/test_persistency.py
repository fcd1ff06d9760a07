"""The pruning against plain enumeration of all labellings, and of all moves, of small images."""

import itertools
from dataclasses import dataclass

import numpy as np
import pytest
from energy_fakes import energy_of, laid_out, slow_energies

from mlbs_actors.graphcut.energy import (
    UNDECIDED,
    LabelCostEnergy,
    UndecidedEnergy,
    cost_of_labels,
    undecided_energy_of,
)
from mlbs_actors.graphcut.persistency import movable, prune
from mlbs_actors.messages import Array


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
    return energy_of(
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
    used = np.bincount(labels, minlength=rest.label_costs.size)
    pixels, price, kept = movable(rest, labels, cost_of_labels(rest.unaries, labels), used, alpha)
    for pixel, dearer in zip(pixels, price, strict=True):
        cost = costs_of(rest, alpha), costs_of(rest, int(labels[pixel]))
        assert dearer == cost[0][pixel] - cost[1][pixel]
    return pixels, kept


def costs_of(rest: UndecidedEnergy, label: int) -> dict[int, int]:
    unaries = rest.unaries
    own = slice(unaries.first[label], unaries.first[label + 1])
    return dict(zip(unaries.pixel[own].tolist(), unaries.cost[own].tolist(), strict=True))


SHAPES = [(2, 3, 3), (3, 2, 4), (3, 1, 6), (2, 4, 2)]


@pytest.mark.parametrize("label_cost", [0, 30, 150])
@pytest.mark.parametrize("shape", SHAPES)
def test_every_optimum_has_the_decided_labels(shape: tuple[int, int, int], label_cost: int) -> None:
    decided_pixels = undecided_pixels = 0
    for seed in range(60):
        whole = random_energy(seed, shape, label_cost)
        pruned, rest = prune(whole)
        every = enumerate_labellings(whole)
        optima = every.labellings[every.energies == every.energies.min()]
        decided = pruned.reshape(-1) != UNDECIDED
        assert (optima[:, decided] == pruned.reshape(-1)[decided]).all()
        assert set(np.flatnonzero(rest.elsewhere)) == set(pruned.reshape(-1)[decided])
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
        pruned, rest = prune(whole)
        differences = set()
        for _ in range(6):
            labels = pruned.copy()
            undecided = rng.integers(0, shape[0], rest.pixels.size)
            labels.reshape(-1)[rest.pixels] = undecided
            slow = int(slow_energies(whole, labels.reshape(1, -1))[0])
            differences.add(slow - undecided_energy_of(rest, undecided))
        assert len(differences) == 1
        compared += 0 < rest.pixels.size < labels.size
    assert compared > 3


@pytest.mark.parametrize("label_cost", [0, 30])
def test_no_best_expansion_moves_a_pixel_that_is_left_out(label_cost: int) -> None:
    left_out = emptied = 0
    for seed in range(150):
        whole = random_energy(seed, (3, 3, 3), label_cost)
        _, rest = prune(whole)
        count = rest.pixels.size
        labels = np.random.default_rng(seed).integers(0, 3, count)
        for alpha in range(3):
            pixels, kept = movable_of(rest, labels, alpha)
            moves = np.array(list(itertools.product([False, True], repeat=count)), bool)
            moves = moves[~(moves & (labels == alpha)).any(axis=1)]
            energies = np.array([undecided_energy_of(rest, np.where(move, alpha, labels)) for move in moves])
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
    return energy_of(unary.astype(np.int32), weights, np.array(label_costs, np.int64))


def test_a_decided_neighbour_decides_the_next_pixel() -> None:
    # Only the first pixel beats its weight at once; in a row each decided pixel then tips the next.
    unary = np.array([[[0, 0, 0, 0]], [[10, 1, 1, 1]]])
    assert prune(flat_energy(unary, 3, [0, 0]))[0].tolist() == [[0, 0, 0, 0]]
    unary[1, 0, 0] = 3
    assert prune(flat_energy(unary, 3, [0, 0]))[0].tolist() == [[UNDECIDED] * 4]


def test_pixels_pay_for_a_label_together() -> None:
    unary = np.array([[[9, 9, 9]], [[0, 0, 0]]])  # margins 9 − 2 = 7, 9 − 4 = 5 and 7: together 19
    assert prune(flat_energy(unary, 2, [0, 18]))[0].tolist() == [[1, 1, 1]]
    assert prune(flat_energy(unary, 2, [0, 19]))[0].tolist() == [[UNDECIDED] * 3]


def test_a_margin_of_zero_decides_nothing() -> None:
    unary = np.array([[[0, 0]], [[4, 4]]])
    assert (prune(flat_energy(unary, 4, [0, 0]))[0] == UNDECIDED).all()
    assert (prune(flat_energy(unary, 3, [0, 0]))[0] == 0).all()


def test_a_single_label_is_decided_everywhere() -> None:
    labels, rest = prune(flat_energy(np.ones((1, 2, 3)), 5, [1000]))
    assert (labels == 0).all()
    assert rest.pixels.size == 0
