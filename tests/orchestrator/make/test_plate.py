"""The background plate: what was covered is restored from other frames, the rest is made up and marked."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import cv2
import numpy as np
import pytest

from mlbs_actors.errors import FrameError
from mlbs_actors.messages import Array
from mlbs_actors.scenes.synthetic import SyntheticScene, scene
from orchestrator.make.plate import BackgroundFrame, CoveredFrame, fill_background

SIZE = {"width": 160, "height": 120}


def covered_frames(made: SyntheticScene) -> list[CoveredFrame]:
    return [(made.frame(index), made.labels(index) > 0) for index in range(len(made))]


def without_objects(made: SyntheticScene) -> SyntheticScene:
    return replace(made, surfaces=tuple(one for one in made.surfaces if one.label == 0))


def filled(frames: list[CoveredFrame]) -> list[BackgroundFrame]:
    return list(fill_background(lambda: frames))


def still(number: int, side: int = 64) -> Iterator[Array]:
    """Yield a fixed camera's frames: a texture and the sensor's noise."""
    rng = np.random.default_rng(5)
    ground = np.kron(rng.integers(40, 200, (side // 4, side // 4, 3)), np.ones((4, 4, 1)))
    for _ in range(number):
        yield np.clip(ground + rng.normal(0, 1, ground.shape), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("name", ["passer-by", "demo"])
def test_the_known_ground_of_a_moving_camera_is_restored(name: str) -> None:
    made = scene(name, frames=12, **SIZE)
    ground = without_objects(made)
    frames = covered_frames(made)
    errors = [
        np.abs(one.picture.astype(int) - ground.frame(index)).mean(axis=2)[covered & ~one.never_seen]
        for index, (one, (_, covered)) in enumerate(zip(filled(frames), frames, strict=True))
    ]
    assert np.concatenate(errors).size > 500
    assert np.concatenate(errors).mean() < 6.0


def texture(height: int, width: int, seed: int) -> Array:
    """Return a smooth pattern around 0, so that it may be moved by parts of a pixel, (h, w, 3) float32."""
    noise = np.random.default_rng(seed).normal(0, 1, (height, width, 1)).astype(np.float32)
    return np.asarray(150 * cv2.GaussianBlur(noise, (0, 0), 2.5)[..., None])


def walk_past(number: int) -> Iterator[tuple[Array, Array]]:
    """Yield frames of a camera that moves to the side, and where an object covers them.

    A wall is far away, boards are nearer, and a post is nearest; the object passes between it and the camera.
    """
    height, width = 160, 320
    # By how much each moves a frame, px; left, top, width, height, px; brightness.
    layers = [(2.0, 0, 0, 520, 160, 110), (3.0, 30, 70, 70, 60, 80), (4.0, 280, 60, 90, 80, 140)]
    layers += [(2.5, 340, 10, 70, 60, 70), (5.0, 0, 130, 520, 30, 90), (6.0, 190, 0, 18, 135, 190)]
    for index in range(number):
        frame = np.zeros((height, width, 3), np.float32)
        for seed, (speed, left, top, across, down, light) in enumerate(layers):
            drawn = np.zeros((height, 520, 4), np.float32)
            drawn[top : top + down, left : left + across, :3] = light + texture(down, across, seed)
            drawn[top : top + down, left : left + across, 3] = 1
            move = np.array([[1, 0, -speed * index], [0, 1, 0]], np.float32)
            moved = cv2.warpAffine(drawn, move, (width, height))
            frame = frame * (1 - moved[..., 3:]) + moved[..., :3]
        covered = np.zeros((height, width), np.bool_)
        covered[40:115, 8 * index : 8 * index + 44] = True
        yield np.clip(frame, 0, 255).astype(np.uint8), covered


def test_a_near_post_behind_an_object_stays_straight_and_whole() -> None:
    clip = list(walk_past(18))
    frames = [(np.where(covered[..., None], np.uint8(255), ground), covered) for ground, covered in clip]
    looked_at = 0
    for index, plate in enumerate(filled(frames)):
        ground, covered = clip[index]
        post = np.zeros_like(covered)
        post[:, 190 - 6 * index : 208 - 6 * index] = True
        inside = covered & post
        if inside.sum() > 0.9 * 18 * 75:
            looked_at += 1
            assert np.abs(plate.picture.astype(int) - ground)[inside].mean() < 15.0
            assert plate.never_seen[inside].mean() < 0.02
    assert looked_at >= 2


def test_a_fixed_camera_gives_back_the_very_ground() -> None:
    ground = next(still(1))
    frames: list[CoveredFrame] = []
    for index in range(8):
        covered = np.zeros((64, 64), np.bool_)
        covered[20:36, 7 * index : 7 * index + 10] = True
        frames.append((np.where(covered[..., None], np.uint8(0), ground), covered))
    for one in filled(frames):
        assert np.abs(one.picture.astype(int) - ground).max() <= 1
        assert not one.never_seen.any()


def test_nothing_changes_away_from_what_is_covered() -> None:
    frames = covered_frames(scene("demo", frames=5, **SIZE))
    for (frame, covered), one in zip(frames, filled(frames), strict=True):
        changed = (one.picture != frame).any(axis=2)
        rows, columns = np.nonzero(covered)
        near = np.zeros_like(covered)
        for row, column in zip(rows, columns, strict=True):
            near[max(0, row - 1) : row + 2, max(0, column - 1) : column + 2] = True
        assert changed.any()
        assert not (changed & ~near).any()
        assert not (one.never_seen & ~near).any()


def test_what_no_frame_shows_is_marked_and_stays_the_same() -> None:
    covered = np.zeros((64, 64), np.bool_)
    covered[20:40, 20:40] = True
    results = filled([(frame, covered) for frame in still(4)])
    for one in results:
        assert one.never_seen[covered].all()
        assert not one.never_seen[:10].any()
    first, last = (one.picture[24:36, 24:36].astype(int) for one in (results[0], results[-1]))
    assert np.abs(first - last).max() <= 2


def test_the_edge_of_an_object_does_not_spread_over_what_no_frame_shows() -> None:
    shown, covered = np.zeros((2, 160, 160), np.bool_)
    covered[60:101, 60:101] = True
    shown[59:102, 59:102] = True  # the mask is a pixel too narrow on each side
    frames = [np.where(shown[..., None], np.uint8(255), frame) for frame in still(4, 160)]
    for one in filled([(frame, covered) for frame in frames]):
        inner = one.picture[64:97, 64:97].astype(int)
        assert inner.max() <= 200  # as bright as the ground is anywhere


def test_an_object_that_a_few_masks_miss_leaves_no_ghost() -> None:
    frames: list[CoveredFrame] = []
    grounds = list(still(16))
    for index, ground in enumerate(grounds):
        frame, covered = ground.copy(), np.zeros((64, 64), np.bool_)
        left = 3 * index
        frame[20:36, left : left + 12] = 255
        covered[20:36, left : left + 12] = index > 2  # it is known from the fourth frame on
        frames.append((frame, covered))
    for index, one in enumerate(filled(frames)):
        if index > 4:
            inside = frames[index][1] & ~one.never_seen
            assert np.abs(one.picture.astype(int) - grounds[index])[inside].mean() < 6.0


def test_a_brighter_frame_is_filled_in_its_own_light() -> None:
    frames: list[CoveredFrame] = []
    grounds = []
    for index, ground in enumerate(still(8)):
        lit = np.clip(ground * (1.2 if index == 4 else 1.0), 0, 255).astype(np.uint8)
        covered = np.zeros((64, 64), np.bool_)
        covered[20:36, 7 * index : 7 * index + 10] = True
        frames.append((np.where(covered[..., None], np.uint8(0), lit), covered))
        grounds.append(lit)
    one = filled(frames)[4]
    inside = frames[4][1] & ~one.never_seen
    assert inside.sum() > 100
    assert np.abs(one.picture.astype(int) - grounds[4])[inside].mean() < 6.0


def test_another_shot_is_no_source() -> None:
    covered = np.zeros((64, 64), np.bool_)
    covered[20:40, 20:40] = True
    other = np.random.default_rng(1).integers(0, 255, (64, 64, 3)).astype(np.uint8)
    results = filled([(next(still(1)), covered), (other, np.zeros_like(covered))])
    assert results[0].never_seen[covered].all()


def test_the_same_frames_give_the_same_bytes() -> None:
    frames = covered_frames(scene("demo", frames=6, **SIZE))
    for one, other in zip(filled(frames), filled(frames), strict=True):
        assert one.picture.tobytes() == other.picture.tobytes()
        assert one.never_seen.tobytes() == other.never_seen.tobytes()


def test_a_clip_of_one_frame_is_made_up_where_it_is_covered() -> None:
    frame, covered = next(still(1)), np.zeros((64, 64), np.bool_)
    covered[30:34, 30:34] = True
    (one,) = filled([(frame, covered)])
    assert one.never_seen[covered].all()
    assert (one.picture[:20] == frame[:20]).all()


def test_a_clip_that_is_all_covered_is_all_marked() -> None:
    results = filled([(frame, np.ones((64, 64), np.bool_)) for frame in still(2)])
    assert all(one.never_seen.all() for one in results)


def test_a_clip_without_frames_gives_none() -> None:
    assert filled([]) == []


@pytest.mark.parametrize(("height", "width"), [(16, 16), (7, 5), (33, 50)])
def test_small_and_odd_sizes_are_filled(height: int, width: int) -> None:
    covered = np.zeros((height, width), np.bool_)
    covered[2:4, 2:4] = True
    frame = np.full((height, width, 3), 90, np.uint8)
    for one in filled([(frame, covered), (frame, np.roll(covered, 2, axis=1))]):
        assert np.abs(one.picture.astype(int) - 90).max() <= 3


GOOD = (np.zeros((8, 8, 3), np.uint8), np.zeros((8, 8), np.bool_))


@pytest.mark.parametrize(
    ("frames", "message"),
    [
        ([(GOOD[0], np.zeros((8, 9), np.bool_))], "mask of frame 0"),
        ([(GOOD[0], np.zeros((8, 8), np.uint8))], "bool"),
        ([(GOOD[0].astype(np.float32), GOOD[1])], "uint8"),
        ([GOOD, (np.zeros((9, 8, 3), np.uint8), np.zeros((9, 8), np.bool_))], "one size"),
    ],
)
def test_frames_that_do_not_fit_are_refused(frames: list[CoveredFrame], message: str) -> None:
    with pytest.raises(FrameError, match=message):
        filled(frames)


def test_a_clip_that_is_shorter_when_read_again_is_refused() -> None:
    lengths = iter([3, 2, 2])
    again: Callable[[], list[CoveredFrame]] = lambda: [GOOD] * next(lengths)  # noqa: E731
    with pytest.raises(FrameError, match="3 frames, and 2"):
        list(fill_background(again))
