"""Where the flow is computed down to its finest level."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from mlbs_actors.config import FlowConfig
from mlbs_actors.flow import focus
from mlbs_actors.flow.focus import BLOCK, focus_blocks, focus_boxes
from mlbs_actors.messages import Array, Region

SHAPE = (60, 100)
SIDE = 2
CONFIG = FlowConfig()
NOBODY = np.zeros((0, 2), np.float32)


def covered(boxes: list[Region]) -> Array:
    count = np.zeros(SHAPE, int)
    for box in boxes:
        count[box.slices] += 1
    return count


def blocks_around(advantage: Array, objects: Array) -> Array:
    """Of objects that rest there, (n, 2)."""
    return focus_blocks(advantage, objects, np.zeros_like(objects), np.ones(len(objects), bool), SIDE, CONFIG)


def test_a_still_scene_has_none() -> None:
    assert focus_boxes(blocks_around(np.zeros(SHAPE, np.float32), NOBODY), SHAPE, CONFIG) == []


def test_it_is_around_objects_and_around_what_the_camera_does_not_explain() -> None:
    advantage = np.zeros(SHAPE, np.float32)
    advantage[4:12, 80:96] = 2.0
    blocks = blocks_around(advantage, np.array([[21.0, 95.0]], np.float32))
    boxes = focus_boxes(blocks, SHAPE, CONFIG)
    count = covered(boxes)
    assert count.max() == 1  # the boxes share no pixel
    assert (count[4:12, 80:96] == 1).all()
    y, x = 47, 10
    assert (count[y - 2 * BLOCK : y + 2 * BLOCK, max(x - 2 * BLOCK, 0) : x + 2 * BLOCK] == 1).all()
    assert 0 < count.mean() < 0.7


@pytest.mark.parametrize("seed", range(4))
def test_the_blocks_are_those_of_numpy(seed: int) -> None:
    rng = np.random.default_rng(seed)
    advantage = np.kron(rng.random((8, 13)) < 0.2, np.ones((BLOCK, BLOCK)))
    positions, motions = rng.uniform(-20, 220, (9, 2)), rng.normal(0, 8, (9, 2))
    objects = rng.random(9) < 0.5
    number, piece = cv2.connectedComponents(
        (advantage > 0).astype(np.uint8)[::BLOCK, ::BLOCK], connectivity=8
    )
    expected = np.zeros(piece.shape, np.uint8)
    for one in range(1, number):
        expected[piece == one] = (piece == one).sum() >= CONFIG.focus_least_blocks
    columns, rows = ((positions - motions)[objects] / (BLOCK * SIDE)).astype(int).T
    expected[np.clip(rows, 0, piece.shape[0] - 1), np.clip(columns, 0, piece.shape[1] - 1)] = 1
    size = 2 * CONFIG.focus_margin_blocks + 1
    found = focus_blocks(
        advantage.astype(np.float32),
        positions.astype(np.float32),
        motions.astype(np.float32),
        objects,
        SIDE,
        CONFIG,
    )
    np.testing.assert_array_equal(found, cv2.dilate(expected, np.ones((size, size), np.uint8)) > 0)


def test_what_leaves_the_frame_is_looked_for_at_its_border() -> None:
    blocks = blocks_around(np.zeros(SHAPE, np.float32), np.array([[-40.0, 500.0]], np.float32))
    assert blocks[-1, 0]


def test_boxes_that_would_be_most_of_the_frame_are_the_frame() -> None:
    advantage = np.zeros(SHAPE, np.float32)
    advantage[:, 10:90] = 2.0
    assert focus_boxes(blocks_around(advantage, NOBODY), SHAPE, CONFIG) == [Region(0, 0, 100, 60)]


Part = tuple[int, int, int, int]


def parted_by_numpy(cells: Array, top: int = 0, left: int = 0) -> list[Part]:
    """The same by trying each cut."""
    if not cells.any():
        return []
    rows, columns = (np.flatnonzero(cells.any(axis)) for axis in (1, 0))
    cells = cells[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    top, left = top + int(rows[0]), left + int(columns[0])

    def rectangle(side: Array) -> int:
        return int(np.ptp(np.flatnonzero(side.any(1))) + 1) * int(np.ptp(np.flatnonzero(side.any(0))) + 1)

    cuts = [(float(cells.size), -1, -1)]
    for axis, part in enumerate((cells, cells.T)):
        for at in range(1, len(part)):
            sides = sum(rectangle(side) for side in (part[:at], part[at:]))
            cuts.append((sides + CONFIG.focus_seam_blocks * int((part[at - 1] & part[at]).sum()), axis, at))
    _, axis, at = min(cuts, key=lambda cut: cut[0])
    if axis < 0:
        return [(left, top, cells.shape[1], cells.shape[0])]
    if axis == 0:
        return parted_by_numpy(cells[:at], top, left) + parted_by_numpy(cells[at:], top + at, left)
    return parted_by_numpy(cells[:, :at], top, left) + parted_by_numpy(cells[:, at:], top, left + at)


def test_cells_are_parted_where_it_costs_least() -> None:
    for seed in range(8):
        seeds = (np.random.default_rng(seed).random((30, 40)) < 0.002 * (seed + 1)).astype(np.uint8)
        cells = cv2.dilate(seeds, np.ones((5, 5), np.uint8)) > 0
        found = focus._parts(cells, CONFIG.focus_seam_blocks).tolist()
        assert sorted(map(tuple, found)) == sorted(parted_by_numpy(cells))
        count = np.zeros(cells.shape, int)
        for left, top, width, height in found:
            count[top : top + height, left : left + width] += 1
        assert count.max(initial=0) <= 1
        assert (count[cells] == 1).all()


def test_boxes_that_would_be_most_of_the_frame_are_parted_if_that_helps() -> None:
    cells = np.zeros((12, 16), bool)
    cells[:6, :6] = cells[6:, 6:] = True
    boxes = focus_boxes(cells, (12 * BLOCK, 16 * BLOCK), CONFIG)
    expected = [Region(0, 0, 6 * BLOCK, 6 * BLOCK), Region(6 * BLOCK, 6 * BLOCK, 10 * BLOCK, 6 * BLOCK)]
    assert sorted(boxes, key=lambda box: box.x) == expected
