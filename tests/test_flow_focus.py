"""Where the flow is computed down to its finest level."""

from __future__ import annotations

import numpy as np

from mlbs_actors.flow_focus import CELL, focus_boxes, focus_cells
from mlbs_actors.messages import Array, Region

SHAPE = (60, 100)
STEP = (2.0, 2.0)
NOBODY = np.zeros((0, 2), np.float32)


def covered(boxes: list[Region]) -> Array:
    count = np.zeros(SHAPE, int)
    for box in boxes:
        count[box.slices] += 1
    return count


def test_a_still_scene_has_none() -> None:
    assert focus_boxes(focus_cells(np.zeros(SHAPE, np.float32), NOBODY, STEP), SHAPE) == []


def test_it_is_around_objects_and_around_what_the_camera_does_not_explain() -> None:
    advantage = np.zeros(SHAPE, np.float32)
    advantage[4:12, 80:96] = 2.0
    cells = focus_cells(advantage, np.array([[21.0, 95.0]], np.float32), STEP)
    boxes = focus_boxes(cells, SHAPE)
    count = covered(boxes)
    assert count.max() == 1  # the boxes share no pixel
    assert (count[4:12, 80:96] == 1).all()
    y, x = 47, 10
    assert (count[y - 2 * CELL : y + 2 * CELL, max(x - 2 * CELL, 0) : x + 2 * CELL] == 1).all()
    assert 0 < count.mean() < 0.7


def test_what_leaves_the_frame_is_looked_for_at_its_border() -> None:
    cells = focus_cells(np.zeros(SHAPE, np.float32), np.array([[-40.0, 500.0]], np.float32), STEP)
    assert cells[-1, 0]


def test_boxes_that_would_be_most_of_the_frame_are_the_frame() -> None:
    advantage = np.zeros(SHAPE, np.float32)
    advantage[:, 10:90] = 2.0
    assert focus_boxes(focus_cells(advantage, NOBODY, STEP), SHAPE) == [Region(0, 0, 100, 60)]
