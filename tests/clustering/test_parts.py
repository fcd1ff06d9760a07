"""A cluster that appears on an object's mask is a part of it."""

from __future__ import annotations

import numpy as np
import pytest

from mlbs_actors.clustering.parts import objects_beneath
from mlbs_actors.messages import Array, LayerSummary, Region, Segmentation

SHAPE = (60, 80)


def label_map(**boxes: tuple[slice, slice]) -> Segmentation:
    """Frame 4, with a box for each layer."""
    labels = np.zeros(SHAPE, np.uint16)
    for name, box in boxes.items():
        labels[box] = int(name[1:])
    nothing = np.zeros((0, 0), np.uint8)
    layers = tuple(
        LayerSummary(int(name[1:]), "object", Region(0, 0, 1, 1), 1, (0.0, 0.0), (0.0, 0.0), 1.0)
        for name in boxes
    )
    return Segmentation(4, labels, nothing, nothing.astype(np.int8), layers, (0.0, 0.0), 0)


def cluster(x: float, y: float) -> Array:
    return np.stack([x + np.arange(10), np.full(10, y)], axis=1).astype(np.float32)


@pytest.mark.parametrize(("x", "found"), [(20.0, 3), (25.0, 3), (26.0, None), (60.0, None)])
def test_half_of_the_trajectories_on_one_objects_mask_are_enough(x: float, found: int | None) -> None:
    positions, labels = cluster(x, 20.0), np.full(10, 7)
    still = np.zeros_like(positions)
    beneath = objects_beneath({7}, labels, positions, still, 5, label_map(L3=np.s_[10:40, 10:30]))
    assert beneath == ({} if found is None else {7: found})


def test_trajectories_are_looked_up_where_they_were_in_the_label_map() -> None:
    positions, labels = cluster(40.0, 20.0), np.full(10, 7)
    back = np.full_like(positions, [-10.0, 0.0])
    latest = label_map(L3=np.s_[10:40, 10:30])
    assert objects_beneath({7}, labels, positions, back, 6, latest) == {7: 3}
    assert objects_beneath({7}, labels, positions, back, 5, latest) == {}
    outside = np.full_like(positions, [-900.0, 900.0])
    assert objects_beneath({7}, labels, positions, outside, 6, latest) == {}


def test_of_two_objects_it_is_the_one_with_more_of_it_and_only_the_clusters_asked_for_are_looked_at() -> None:
    positions = np.concatenate([cluster(20.0, 20.0), cluster(60.0, 20.0)])
    labels = np.repeat([7, 8], 10)
    latest = label_map(L3=np.s_[10:40, 10:26], L5=np.s_[10:40, 26:30], L6=np.s_[10:40, 50:80])
    still = np.zeros_like(positions)
    assert objects_beneath({7, 8}, labels, positions, still, 5, latest) == {7: 3, 8: 6}
    assert objects_beneath({7}, labels, positions, still, 5, latest) == {7: 3}
    assert objects_beneath({7, 8}, labels, positions, still, 5, None) == {}
    assert objects_beneath({7, 8}, labels, positions, still, 5, label_map()) == {}
