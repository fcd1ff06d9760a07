"""Which labels are worth a try to do without, against loops over pixels."""

import numpy as np

from mlbs_actors.graphcut.energy import UNDECIDED, LabelCostEnergy, UndecidedEnergy, undecided_energy
from mlbs_actors.graphcut.expansion_state import begin
from mlbs_actors.graphcut.label_removal import removable_labels
from mlbs_actors.messages import Array

HEIGHT, WIDTH, LABELS = 4, 5, 4


def open_energy(seed: int) -> UndecidedEnergy:
    """Of an image without a decided pixel; label 0 is free, label 3 can be in the left half alone."""
    rng = np.random.default_rng(seed)
    weights = rng.integers(0, 6, (HEIGHT, WIDTH, 4)).astype(np.int32)
    weights[:, -1, 0], weights[-1, :, 1:], weights[:, -1, 2], weights[:, 0, 3] = 0, 0, 0, 0
    places = np.tile(np.array([0, HEIGHT, 0, WIDTH]), (LABELS, 1))
    places[3, 3] = 2
    whole = LabelCostEnergy(
        rng.integers(0, 20, (LABELS, HEIGHT, WIDTH)).astype(np.int32),
        weights,
        np.append(0, rng.integers(1, 60, LABELS - 1)),
        places,
    )
    return undecided_energy(whole, np.full((HEIGHT, WIDTH), UNDECIDED, np.int16), np.zeros(LABELS, bool))


def slow_removable(rest: UndecidedEnergy, labels: Array) -> list[bool]:
    unaries = rest.unaries
    costs = [
        dict(zip(unaries.pixel[a:b].tolist(), unaries.cost[a:b].tolist(), strict=True))
        for a, b in zip(unaries.first[:-1], unaries.first[1:], strict=True)
    ]
    removable = []
    for label in range(LABELS):
        gain = int(rest.label_costs[label])
        others = set(labels.tolist()) - {label}
        for p in np.flatnonzero(labels == label).tolist():
            gain -= min(costs[k].get(p, 2**30) for k in others) if others else 2**30
            gain += costs[label][p]
            for q, weight in zip(rest.neighbour[p], rest.weight[p], strict=True):
                gain += int(weight) if q >= 0 and labels[q] != label else 0
        removable.append(label in labels and label > 0 and gain > 0)
    return removable


def test_a_label_is_removable_where_its_cost_and_outline_make_up_for_its_evidence() -> None:
    seen = set()
    for seed in range(60):
        rest, rng = open_energy(seed), np.random.default_rng(1000 + seed)
        labels = rng.integers(0, int(rng.integers(1, 4)), HEIGHT * WIDTH)
        labels[rest.unaries.pixel[rest.unaries.first[3] :][:3]] = 3
        removable = removable_labels(rest, begin(rest, labels))
        assert removable.tolist() == slow_removable(rest, labels)
        seen.update(removable[np.unique(labels)].tolist())
    assert seen == {False, True}
