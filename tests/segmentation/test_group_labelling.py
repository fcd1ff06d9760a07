"""What labels in a box of claims look like, against loops over their pixels."""

from __future__ import annotations

import numpy as np
import pytest

from mlbs_actors.messages import COST_STEP
from mlbs_actors.segmentation.group_labelling import Claims, Tally, tally

SIDE, BOX, CORNER = 2, (3, 1, 6, 5), (9, 6)  # cells: left, top, width, height of a box, and where all begin
#: Of all layers, and those whose claims are in the box.
IDS, OWN = np.array([0, 2, 7, 9, 3], np.uint16), np.array([0, 4, 2])
X, Y = SIDE * (CORNER[0] + BOX[0]), SIDE * (CORNER[1] + BOX[1])  # of the box in the frame


def claims(seed: int) -> Claims:
    rng = np.random.default_rng(seed)
    cost = rng.integers(0, 256, (5, 8, 12)).astype(np.uint8)
    normaliser = rng.integers(0, 256, (8, 12)).astype(np.uint8)
    none = np.zeros((5, 4), np.int64)
    return Claims(cost, normaliser, none, none[:, :2].copy(), IDS, CORNER, SIDE)


@pytest.mark.parametrize("size", [(10, 12), (9, 11)])  # the frame can end in the last cells
def test_bounds_areas_centres_and_posteriors_are_those_of_each_labels_pixels(size: tuple[int, int]) -> None:
    given, tallied = claims(size[0]), Tally.of_nothing(5)
    tallied.sums[[1, 3]] = 77  # of layers that claim elsewhere
    labels = np.random.default_rng(1).choice(IDS[OWN], size)
    tally(labels, given, OWN, BOX, tallied)
    for own in OWN[1:]:
        rows, columns = np.nonzero(labels == IDS[own])
        bounds = [X + columns.min(), Y + rows.min(), X + columns.max(), Y + rows.max()]
        assert tallied.bounds[own].tolist() == bounds
        assert tallied.sums[own].tolist() == [rows.size, (X + columns).sum(), (Y + rows).sum()]
        expected = 0.0
        for y, x in zip(rows, columns, strict=True):
            cell = BOX[1] + y // SIDE, BOX[0] + x // SIDE
            above = int(given.cost[own][cell]) - int(given.normaliser[cell])
            expected += np.exp(-COST_STEP * max(above, 0))
        assert tallied.likelihood[own] == pytest.approx(expected)
    assert tallied.sums[[0, 1, 3]].tolist() == [[0, 0, 0], [77, 77, 77], [77, 77, 77]]


def test_a_later_tally_takes_the_place_of_the_first() -> None:
    given, tallied = claims(0), Tally.of_nothing(5)
    tally(np.full((10, 12), 3, np.uint16), given, OWN, BOX, tallied)
    tally(np.full((10, 12), 7, np.uint16), given, OWN, BOX, tallied)
    assert tallied.sums[:, 0].tolist() == [0, 0, 120, 0, 0]
    assert tallied.likelihood[4] == 0.0
