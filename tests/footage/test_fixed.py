"""What is drawn over a moving picture, and what users say is no part of the scene."""

from __future__ import annotations

import pickle
from collections.abc import Sequence

import cv2
import numpy as np
import pytest
from labelled_clip import LabelledClip

from mlbs_actors import MultilayerSubtractor, Result
from mlbs_actors.errors import ConfigError
from mlbs_actors.footage.fixed import FixedState, _completed, fixed_cells
from mlbs_actors.messages import Array
from mlbs_actors.scenes.synthetic import SyntheticScene


@pytest.fixture(scope="module")
def demo(clip: LabelledClip) -> SyntheticScene:
    return clip.scene


def with_clock(picture: Array, index: int) -> Array:
    picture = picture.copy()
    for text, place in ((f"2024-05-13 12:34:{index // 10:02d}", (8, 20)), ("CAM 03", (240, 230))):
        for colour, width in (((0, 0, 0), 4), ((255, 255, 255), 2)):
            cv2.putText(picture, text, place, cv2.FONT_HERSHEY_SIMPLEX, 0.5, colour, width)
    return picture


def with_bars(picture: Array, index: int) -> Array:
    picture = picture.copy()
    picture[:24] = picture[-24:] = 0
    return picture


def with_bonnet(picture: Array, index: int) -> Array:
    picture = picture.copy()
    cv2.ellipse(picture, (160, 250), (190, 50), 0, 0, 360, (70, 60, 50), -1)
    return picture


def labelled(frames: list[Array], ignored: Array | None = None) -> list[Result]:
    subtractor = MultilayerSubtractor(ignored=ignored)
    return [result for frame in frames for result in subtractor.apply(frame)] + subtractor.flush()


def f_score(results: Sequence[Result], demo: SyntheticScene, seen: Array) -> float:
    scores = []
    for result in results:
        found, true = (result.labels > 0) & seen, (demo.labels(result.frame_index) > 0) & seen
        scores.append(2 * int((found & true).sum()) / max(int(found.sum()) + int(true.sum()), 1))
    return float(np.mean(scores))


@pytest.mark.parametrize("draw", [with_clock, with_bars, with_bonnet])
def test_what_is_drawn_over_the_picture_is_background_and_costs_the_rest_little(
    clip: LabelledClip, demo: SyntheticScene, draw: object
) -> None:
    drawn = [draw(picture, index) for index, picture in enumerate(clip.frames)]  # type: ignore[operator]
    seen = (drawn[0] == clip.frames[0]).all(axis=2)
    results = labelled(drawn)
    assert f_score(results, demo, seen) > f_score(clip.results, demo, seen) - 0.02
    if draw is not with_clock:  # an object's hole of the width of a stroke is closed
        assert not any(result.labels[~seen].any() for result in results[10:])


def test_what_is_ignored_is_never_labelled_nor_needs_the_size_of_the_frame(demo: SyntheticScene) -> None:
    frames = [demo.frame(index) for index in range(12)]
    left = np.zeros((12, 16), bool)
    left[:, :8] = True
    results = labelled(frames, left)
    assert not any(result.labels[:, :160].any() for result in results)
    assert any(result.labels.any() for result in results)


def test_what_is_ignored_is_pickled_with_the_subtractor(demo: SyntheticScene) -> None:
    frames = [demo.frame(index) for index in range(10)]
    everything_left = np.zeros((12, 16), bool)
    everything_left[:, :8] = True
    expected = labelled(frames, everything_left)
    subtractor = MultilayerSubtractor(ignored=everything_left)
    results = [result for frame in frames[:3] for result in subtractor.apply(frame)]
    restored = pickle.loads(pickle.dumps(subtractor))
    results += [result for frame in frames[3:] for result in restored.apply(frame)] + restored.flush()
    for result, other in zip(results, expected, strict=True):
        np.testing.assert_array_equal(result.labels, other.labels)


def test_a_mask_that_is_none_is_refused() -> None:
    with pytest.raises(ConfigError, match="mask of bool"):
        MultilayerSubtractor(ignored=np.zeros((4, 4), np.uint8))


def noise(seed: int) -> Array:
    return cv2.GaussianBlur(
        np.random.default_rng(seed).integers(0, 255, (60, 200)).astype(np.uint8), (0, 0), 1.5
    )


def followed(ground: Array, step: float, drawn: Array, drift: float, frames: int) -> FixedState:
    """Pan over the ground, with something drawn that drifts in the picture."""
    state, before = None, ground[:, :80]
    for index in range(frames):
        shift = np.array([[1, 0, step * index], [0, 1, 0]])
        gray = cv2.warpAffine(ground, shift, (80, 60), flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)
        by_camera = np.roll(before, -round(step), axis=1)
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        left = 20 + drift * index
        place = np.array([[1, 0, -left], [0, 1, -20]])
        moved = cv2.warpAffine(drawn, place, (80, 60), flags=flags)
        seen = slice(20, 44), slice(int(np.ceil(left)), int(left) + 40)
        gray[seen] = moved[seen]
        if state is None:
            state = FixedState.beginning(gray)
        else:
            state = fixed_cells(state, gray, cv2.absdiff(gray, by_camera))
        before = gray
    assert state is not None
    return state


def test_edges_that_stay_are_fixed_with_the_flat_parts_between_them() -> None:
    drawn = np.full((24, 120), 20, np.uint8)
    drawn[:, ::5] = 220
    state = followed(noise(1), 3.0, drawn, 0.0, 8)
    assert state.cells[22:42, 22:58].all()
    assert not state.cells[:14].any()
    assert not state.cells[:, :14].any()


def test_a_flat_part_is_fixed_if_half_of_its_border_is_and_it_is_not_most_of_the_picture() -> None:
    voted, unchanging = np.zeros((60, 80), bool), np.zeros((60, 80), bool)
    voted[40:42, :50], unchanging[42:] = True, True  # the edge of a bonnet, but for the last third of it
    assert _completed(voted, unchanging)[42:].all()
    assert not _completed(voted, unchanging)[:36].any()
    voted[40:42, 20:] = False
    assert not _completed(voted, unchanging)[50:, 30:].any()
    voted[40:42] = True
    unchanging[:] = True  # the camera stands still
    assert not _completed(voted, unchanging)[:30].any()


def test_black_rows_at_the_border_are_bars_from_the_first_motion_on() -> None:
    gray = noise(1)[:, :80].copy()
    gray[:8], gray[-5:] = 16, 10
    state = fixed_cells(FixedState.beginning(gray), gray, np.zeros_like(gray))
    rows = np.all(state.cells, axis=1)
    assert rows[:8].all()
    assert rows[-5:].all()
    assert not state.cells[12:-9].any()


def test_a_night_that_is_black_to_the_border_has_no_bars() -> None:
    gray = np.full((80, 120), 12, np.uint8)
    gray[30:38, 50:58] = 230
    assert not fixed_cells(FixedState.beginning(gray), gray, np.zeros_like(gray)).cells.any()


def test_a_digit_may_change_and_what_moves_again_with_the_scene_is_scene() -> None:
    drawn = np.full((24, 120), 20, np.uint8)
    drawn[:, ::5] = 220
    state = followed(noise(1), 3.0, drawn, 0.0, 12)
    assert state.cells[30, 40]
    gray = state.reference.copy()
    gray[28:34, 38:44] = 255 - gray[28:34, 38:44]
    moved = np.full_like(gray, 60)
    state = fixed_cells(state, gray, moved)
    assert state.cells[30, 40]
    for seed in range(2, 12):  # another scene, which the camera's motion explains
        state = fixed_cells(state, noise(seed)[:, :80].copy(), np.zeros_like(gray))
    assert not state.cells.any()


def test_a_thing_that_the_camera_follows_is_not_fixed() -> None:
    drawn = noise(2)[:24, :120]
    assert followed(noise(1), 3.0, drawn, 0.0, 12).cells.any()
    assert followed(noise(1), 3.0, drawn, 0.5, 12).cells.mean() < 0.02
