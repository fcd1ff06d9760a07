"""A scene that comes back after something else was seen brings its objects back."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from labelled_clip import LabelledClip

from mlbs_actors import Result
from mlbs_actors.config import Config
from mlbs_actors.coordinator import Coordinator, CoordinatorState
from mlbs_actors.messages import Array
from mlbs_actors.state_file import capture

#: Frames of the clip before something else is seen.
BEFORE = 20


def near_thing(frames: int, shape: tuple[int, ...]) -> list[Array]:
    """Something that passes close to the lens, too fast to be followed."""
    rng = np.random.default_rng(8)
    coarse = rng.integers(0, 255, (40, 60, 3)).astype(np.uint8)
    texture = cv2.resize(coarse, None, fx=40, fy=40, interpolation=cv2.INTER_CUBIC)
    height, width = shape[:2]
    return [texture[:height, 180 * k : 180 * k + width].copy() for k in range(frames)]


def seen(clip: LabelledClip, between: list[Array]) -> tuple[list[Result], list[Result]]:
    """The results before and after something else is seen."""
    results, subtractor = clip.first_half()
    assert len(results) == BEFORE
    for frame in (*between, *clip.frames[BEFORE:]):
        results += subtractor.apply(frame)
    return results[:BEFORE], results[BEFORE:] + subtractor.flush()


def ids(result: Result) -> set[int]:
    return {one.layer for one in result.layers}


@pytest.mark.parametrize("frames", [2, 6, 12])
def test_objects_of_a_scene_that_comes_back_keep_their_ids(clip: LabelledClip, frames: int) -> None:
    before, after = seen(clip, near_thing(frames, clip.frames[0].shape))
    assert ids(before[-1])
    assert ids(after[-1]) == ids(before[-1])
    assert not any(result.ended for result in after)
    if frames > 5:
        assert "cut" in {result.status for result in after}


def test_a_scene_is_forgotten_as_its_objects_would_be(clip: LabelledClip) -> None:
    config = Config()
    coordinator = Coordinator(config)
    height, width = clip.frames[0].shape[:2]
    for index, frame in enumerate([*clip.frames[:BEFORE], *near_thing(6, (height, width))]):
        coordinator.step(index, frame, None)
    (scene,) = coordinator.state.left
    objects = set(scene.registry.labels[scene.registry.labels > 0].tolist())
    assert objects <= coordinator.possible_layers()
    copy = capture(coordinator.state).state(CoordinatorState)
    np.testing.assert_array_equal(copy.left[0].view.gray, scene.view.gray)
    another = near_thing(1, (height, width))[0]
    last = scene.last_frame + config.layers.dormant_frames
    for index in range(BEFORE + 6, last + 2):
        assert coordinator.state.left
        assert objects <= coordinator.possible_layers()
        coordinator.step(index, another, None)
    assert not coordinator.state.left
    assert not objects & coordinator.possible_layers()
