"""Expansions that may free labels of their cost, against enumeration of all moves."""

import itertools

import numpy as np
import pytest
from energy_fakes import energy_of

from mlbs_actors.graphcut.energy import (
    UNDECIDED,
    LabelCostEnergy,
    undecided_energy,
    undecided_energy_of,
)
from mlbs_actors.graphcut.expansion import (
    free_expansion,
    freeing_expansion,
    may_free,
    paid_expansion,
    paid_for,
)
from mlbs_actors.messages import Array

HEIGHT, WIDTH, LABELS = 3, 4, 3


def random_energy(seed: int) -> LabelCostEnergy:
    rng = np.random.default_rng(seed)
    weights = rng.integers(0, int(rng.integers(1, 9)), (HEIGHT, WIDTH, 4)).astype(np.int32)
    weights[:, -1, 0], weights[-1, :, 1:], weights[:, -1, 2], weights[:, 0, 3] = 0, 0, 0, 0
    unary = rng.integers(0, 20, (LABELS, HEIGHT, WIDTH)).astype(np.int32)
    return energy_of(unary, weights, rng.integers(0, 60, LABELS))


def expect_best_expansion(seed: int, paid: tuple[int, ...]) -> None:
    """Compare an expansion that may free some labels of their costs with all moves that there are."""
    whole = random_energy(seed)
    rest = undecided_energy(whole, np.full((HEIGHT, WIDTH), UNDECIDED, np.int16), np.zeros(LABELS, bool))
    rng = np.random.default_rng(1000 + seed)
    labels: Array = rng.integers(0, LABELS, HEIGHT * WIDTH)
    alpha = 0
    # All pixels of the labels that can be freed may move; of a label that is kept, some.
    nodes = np.flatnonzero((labels != alpha) & (np.isin(labels, paid) | (rng.random(labels.size) < 0.6)))
    kept = ~np.isin(np.arange(LABELS), paid)
    paid = tuple(label for label in paid if label in labels)
    costs = whole.unary.reshape(LABELS, -1)
    price = (costs[alpha, nodes] - costs[labels[nodes], nodes]).astype(np.int64)

    def change(moves: Array) -> int:
        after = labels.copy()
        after[nodes[moves]] = alpha
        terms = undecided_energy_of(rest, after) - undecided_energy_of(rest, labels)
        freed = [k for k in range(LABELS) if k in labels and k not in after and k not in paid]
        began = int(whole.label_costs[alpha]) * (alpha in after and alpha not in labels)
        return terms + int(whole.label_costs[freed].sum()) - began

    all_moves = [np.array(moves, bool) for moves in itertools.product((0, 1), repeat=len(nodes))]
    least = min(change(moves) for moves in all_moves)
    found, stated = paid_expansion(rest, labels, alpha, nodes, price, paid_for(labels, nodes, kept))
    assert change(found) == stated == least
    if len(paid) == 1:
        moves, change_of_moves = freeing_expansion(rest, labels, alpha, nodes, price, paid[0])
        assert change(moves) == change_of_moves == least


@pytest.mark.parametrize("paid", [(1,), (1, 2)])
def test_an_expansion_frees_labels_where_that_is_best(paid: tuple[int, ...]) -> None:
    for seed in range(60):
        expect_best_expansion(seed, paid)


def test_a_label_is_kept_without_a_second_cut_only_where_that_is_best() -> None:
    alpha, seen = 0, set()
    for seed in range(100):
        whole = random_energy(seed)
        whole.unary[alpha] += np.random.default_rng(2000 + seed).integers(0, 40, (HEIGHT, WIDTH), np.int32)
        rest = undecided_energy(whole, np.full((HEIGHT, WIDTH), UNDECIDED, np.int16), np.zeros(LABELS, bool))
        labels: Array = np.random.default_rng(1000 + seed).integers(0, LABELS, HEIGHT * WIDTH)
        nodes = np.flatnonzero(labels != alpha)
        costs = whole.unary.reshape(LABELS, -1)
        price = (costs[alpha, nodes] - costs[labels[nodes], nodes]).astype(np.int64)
        paid = paid_for(labels, nodes, np.zeros(LABELS, bool))
        best, least = paid_expansion(rest, labels, alpha, nodes, price, paid)
        moves, change, left = free_expansion(rest, labels, alpha, nodes, price)
        seen.add(freeing := may_free(rest, labels, nodes, left, paid))
        if not freeing:
            assert change == least
            np.testing.assert_array_equal(moves, best)
    assert seen == {False, True}
