"""What can be looked at inside a stream, and that looking changes nothing."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from scipy.spatial import cKDTree

from mlbs_actors import Config, MultilayerSubtractor, Result
from mlbs_actors.inspection import FrameInspection
from mlbs_actors.motion_field.field import MotionField, motion_field
from mlbs_actors.scenes.synthetic import scene

FRAMES = 10


def results(subtractor: MultilayerSubtractor) -> list[Result]:
    video = scene("pan", frames=60, width=320, height=240)
    return [one for t in range(FRAMES) for one in subtractor.apply(video.frame(t))] + subtractor.flush()


@pytest.fixture(scope="module")
def inside() -> tuple[list[FrameInspection], list[Result], list[MotionField]]:
    """What was seen, what came out, and the motion fields that the layers worked with."""
    used: list[MotionField] = []

    def noted(*given: Any) -> MotionField:
        used.append(motion_field(*given))
        return used[-1]

    seen: list[FrameInspection] = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("mlbs_actors.layer.layer.motion_field", noted)
        labelled = results(MultilayerSubtractor(Config(), seen.append))
    return seen, labelled, used


Inside = tuple[list[FrameInspection], list[Result], list[MotionField]]


def test_who_looks_on_changes_no_byte(inside: Inside) -> None:
    plain = results(MultilayerSubtractor())
    assert [one.labels.tobytes() for one in inside[1]] == [one.labels.tobytes() for one in plain]


def test_every_labelled_frame_is_seen_in_order_with_its_layers(inside: Inside) -> None:
    seen, labelled, _ = inside
    assert [one.frame_index for one in seen] == list(range(FRAMES))
    for one, result in zip(seen, labelled, strict=True):
        ids = [layer.layer for layer in one.layers]
        assert ids == sorted(ids)
        assert ids[0] == 0
        assert {layer.layer for layer in result.layers} <= set(ids)
        assert one.shape == result.labels.shape
    assert any(len(one.layers) > 1 for one in seen), "a scene without an object proves little"


def test_a_trajectory_was_where_one_ended_in_the_frame_before(inside: Inside) -> None:
    seen, _, _ = inside
    for before, now in pairwise(seen):
        old = np.concatenate([layer.positions for layer in before.layers])
        points = np.concatenate([layer.positions + layer.motions for layer in now.layers])
        distance, _ = cKDTree(old).query(points)
        assert np.mean(distance < 0.001) > 0.5  # the others have just been seeded


def test_the_motion_field_is_the_one_that_the_layer_worked_with(inside: Inside) -> None:
    seen, _, used = inside
    assert [layer.motion_field for one in seen for layer in one.layers] == used
    for one in seen:
        for layer in one.layers:
            assert layer.motion_field.shape == (layer.home.height, layer.home.width)


def test_the_posteriors_of_a_pixel_sum_to_one_and_the_label_map_follows_them(inside: Inside) -> None:
    seen, labelled, _ = inside
    for one, result in zip(seen, labelled, strict=True):
        total, best = np.zeros(one.shape), np.zeros((len(one.layers), *one.shape))
        best[0] = 1.0
        for place, layer in enumerate(one.layers):
            assert layer.posterior.dtype == np.float32
            assert 0 <= layer.posterior.min(initial=1) <= layer.posterior.max(initial=0) <= 1
            best[place][layer.region.slices] = layer.posterior
        total = best.sum(axis=0)
        assert np.mean(np.abs(total - 1) < 0.07) > 0.99
        ids = np.array([layer.layer for layer in one.layers])
        assert np.mean(ids[best.argmax(axis=0)] == result.labels) > 0.95
