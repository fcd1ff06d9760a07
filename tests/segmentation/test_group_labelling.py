"""What layers win in a box of proposals, against loops over their pixels."""

from __future__ import annotations

import numpy as np
import pytest

from mlbs_actors.messages import COST_STEP
from mlbs_actors.segmentation.group_labelling import LayerStatistics, Proposals, _measure

SIDE, BOX, CORNER = 2, (3, 1, 6, 5), (9, 6)  # cells: left, top, width, height of a box, and where all begin
#: Of all layers, and those whose proposals are in the box.
IDS, OWN = np.array([0, 2, 7, 9, 3], np.uint16), np.array([0, 4, 2])
X, Y = SIDE * (CORNER[0] + BOX[0]), SIDE * (CORNER[1] + BOX[1])  # of the box in the frame


def proposals(seed: int) -> Proposals:
    rng = np.random.default_rng(seed)
    cost = rng.integers(0, 256, (5, 8, 12)).astype(np.uint8)
    normaliser = rng.integers(0, 256, (8, 12)).astype(np.uint8)
    none = np.zeros((5, 4), np.int64)
    return Proposals(cost, normaliser, none, none[:, :2].copy(), IDS, np.zeros(5), CORNER, SIDE)


@pytest.mark.parametrize("size", [(10, 12), (9, 11)])  # the frame can end in the last cells
def test_bounds_areas_centres_and_posteriors_are_those_of_each_labels_pixels(size: tuple[int, int]) -> None:
    given = proposals(size[0])
    nothing = np.tile(np.array([2**31, 2**31, -1, -1]), (5, 1))
    found = LayerStatistics(nothing, np.zeros((5, 3), np.int64), np.zeros(5))
    found.sums[[1, 3]] = 77  # of layers with proposals elsewhere
    labels = np.random.default_rng(1).choice(IDS[OWN], size)
    _measure(labels, given, OWN, BOX[:2], found)
    for own in OWN[1:]:
        rows, columns = np.nonzero(labels == IDS[own])
        bounds = [X + columns.min(), Y + rows.min(), X + columns.max(), Y + rows.max()]
        assert found.bounds[own].tolist() == bounds
        assert found.sums[own].tolist() == [rows.size, (X + columns).sum(), (Y + rows).sum()]
        expected = 0.0
        for y, x in zip(rows, columns, strict=True):
            cell = BOX[1] + y // SIDE, BOX[0] + x // SIDE
            above = int(given.cost[own][cell]) - int(given.normaliser[cell])
            expected += np.exp(-COST_STEP * max(above, 0))
        assert found.likelihood[own] == pytest.approx(expected)
    assert found.sums[[0, 1, 3]].tolist() == [[0, 0, 0], [77, 77, 77], [77, 77, 77]]
