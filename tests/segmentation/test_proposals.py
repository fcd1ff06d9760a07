"""Where layers may win pixels, against NumPy."""

from __future__ import annotations

import numpy as np
from read_only import read_only

from mlbs_actors.messages import Array
from mlbs_actors.segmentation.proposals import proposal_boxes

SHAPE = (20, 30)
SIDE, CORNER = 2, (5, 7)
NO_TRACKS = np.zeros((3, 2), np.int64)


def places() -> Array:
    return np.array([(0, 20, 0, 30), (2, 14, 4, 25), (6, 20, 0, 12)], np.int64)


def proposed(cost: Array, positions: Array, tracks: Array) -> Array:
    return np.asarray(proposal_boxes(cost, places(), read_only(positions), tracks, CORNER, SIDE))


def expected(cost: Array, layer: int, cells: list[tuple[int, int]]) -> list[int]:
    """The proposal of a layer that has trajectories in some cells (row, column) of the box."""
    top, bottom, left, right = places()[layer]
    leads = cost[layer] < cost[0]
    for cell in cells:
        leads[cell] = True
    rows, columns = np.nonzero(leads[top:bottom, left:right])
    return [top + rows.min(), top + rows.max() + 1, left + columns.min(), left + columns.max() + 1]


def test_a_claim_is_the_box_around_lead_and_trajectories() -> None:
    for seed in range(8):
        rng = np.random.default_rng(seed)
        cost = np.full((3, *SHAPE), 100, np.uint8)
        cost[1:][rng.random((2, *SHAPE)) < 0.01] = 99
        cost[1, 7, 12] = cost[2, 12, 5] = 0
        cells = rng.integers((0, 0), SHAPE, (6, 2))
        positions = (SIDE * (cells[:, ::-1] + np.array(CORNER))).astype(np.float32)
        tracks = np.array([(0, 2), (2, 3), (3, 6)], np.int64)
        found = proposed(cost, positions, tracks)
        assert found[0].tolist() == places()[0].tolist()
        for layer in (1, 2):
            own = [(int(row), int(column)) for row, column in cells[slice(*tracks[layer])]]
            assert found[layer].tolist() == expected(cost, layer, own)


def test_a_layer_that_leads_nowhere_claims_nothing() -> None:
    cost = np.full((3, *SHAPE), 100, np.uint8)
    cost[1, 0, 0] = cost[2, 5, 29] = 0  # beyond their places
    empty = proposed(cost, np.zeros((0, 2), np.float32), NO_TRACKS)[1:]
    assert (empty == 0).all()
