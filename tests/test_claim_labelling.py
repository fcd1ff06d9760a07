"""What labels in a box of claims look like, against loops over their pixels."""

from __future__ import annotations

import numpy as np
import pytest

from mlbs_actors.claim_labelling import Claimants, tally
from mlbs_actors.messages import COST_STEP

IDS = np.array([0, 3, 7], np.uint16)
SIDE, BOX = 2, (3, 1, 6, 5)  # cells: left, top, width, height


def claimants(seed: int) -> Claimants:
    rng = np.random.default_rng(seed)
    cost = rng.integers(0, 256, (5, 8, 12)).astype(np.uint8)
    normaliser = rng.integers(0, 256, (8, 12)).astype(np.uint8)
    none = np.zeros((5, 4), np.int64)
    return Claimants(cost, normaliser, none, none[:, :2].copy(), np.array([0, 4, 2]), BOX, (9, 6), SIDE)


@pytest.mark.parametrize("size", [(10, 12), (9, 11)])  # the frame can end in the last cells
def test_bounds_areas_centres_and_posteriors_are_those_of_each_labels_pixels(size: tuple[int, int]) -> None:
    given = claimants(size[0])
    labels = np.random.default_rng(1).choice(IDS, size)
    bounds, sums, likelihood = tally(labels, IDS, given)
    for own, label in enumerate(IDS):
        if label == 0:
            assert sums[own].tolist() == [0, 0, 0]
            continue
        rows, columns = np.nonzero(labels == label)
        assert bounds[own].tolist() == [columns.min(), rows.min(), columns.max(), rows.max()]
        assert sums[own].tolist() == [rows.size, columns.sum(), rows.sum()]
        expected = 0.0
        for y, x in zip(rows, columns, strict=True):
            cell = BOX[1] + y // SIDE, BOX[0] + x // SIDE
            above = int(given.cost[given.own[own]][cell]) - int(given.normaliser[cell])
            expected += np.exp(-COST_STEP * max(above, 0))
        assert likelihood[own] == pytest.approx(expected)


def test_a_label_without_pixels_has_no_area() -> None:
    _, sums, likelihood = tally(np.full((10, 12), 3, np.uint16), IDS, claimants(0))
    assert (sums[2, 0], likelihood[2]) == (0, 0.0)
