"""Frames that are no picture, changes of light, and cuts, on small scenes with exact truth."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Iterator, Sequence

import cv2
import numpy as np
import pytest
from labelled_clip import LabelledClip

from mlbs_actors import MultilayerSubtractor, Result
from mlbs_actors.footage.light import light_change, relit
from mlbs_actors.footage.pictures import is_still, repeats
from mlbs_actors.messages import Array
from mlbs_actors.scenes.synthetic import SyntheticScene, scene

FRAMES = 40
AT = 20


@pytest.fixture(scope="module")
def pictures(clip: LabelledClip) -> list[Array]:
    assert len(clip.frames) == FRAMES
    return list(clip.frames)


def labelled(frames: Sequence[Array]) -> list[Result]:
    subtractor = MultilayerSubtractor()
    results = [result for frame in frames for result in subtractor.apply(frame)] + subtractor.flush()
    assert [result.frame_index for result in results] == list(range(len(frames)))
    return results


def after_first_half(
    clip: LabelledClip, frames: Sequence[Array], concealed: int | None = None
) -> list[Result]:
    """The results of the clip with other frames from ``AT`` on."""
    assert len(clip.frames) == 2 * AT
    results, subtractor = clip.first_half()
    for index, frame in enumerate(frames, AT):
        results += subtractor.apply(frame, concealed=index == concealed)
    results += subtractor.flush()
    assert [result.frame_index for result in results] == list(range(AT + len(frames)))
    return results


def two_label_f(results: Sequence[Result], demo: SyntheticScene, indices: Sequence[int]) -> float:
    scores = []
    for index in indices:
        found, true = results[index].labels > 0, demo.labels(index) > 0
        scores.append(2 * int((found & true).sum()) / max(int(found.sum()) + int(true.sum()), 1))
    return float(np.mean(scores))


@pytest.fixture(scope="module")
def undisturbed(clip: LabelledClip) -> list[Result]:
    return list(clip.results)


def test_every_frame_of_an_undisturbed_scene_is_a_picture(undisturbed: list[Result]) -> None:
    assert {result.status for result in undisturbed} == {"ok"}


def torn(pictures: list[Array]) -> Array:
    picture = pictures[AT].copy()
    half = len(picture) // 2
    picture[half:] = np.roll(picture[half:], picture.shape[1] // 4, axis=1)
    return picture


@pytest.mark.parametrize(
    ("status", "disturb"),
    [
        ("blank", lambda pictures: np.zeros_like(pictures[AT])),
        ("blank", lambda pictures: np.full_like(pictures[AT], 255)),
        ("repeated", lambda pictures: pictures[AT - 1]),
        ("damaged", torn),
        ("damaged", lambda pictures: np.random.default_rng(0).integers(0, 255, pictures[AT].shape, np.uint8)),
        ("flash", lambda pictures: np.clip(pictures[AT].astype(int) + 120, 0, 255).astype(np.uint8)),
    ],
    ids=["black", "white", "doubled", "torn", "noise", "flash"],
)
def test_a_frame_that_is_no_picture_carries_the_labels_and_changes_nothing_after(
    clip: LabelledClip, pictures: list[Array], undisturbed: list[Result], status: str, disturb: object
) -> None:
    results = after_first_half(clip, [disturb(pictures), *pictures[AT + 1 :]])  # type: ignore[operator]
    assert results[AT].status == status
    assert {result.status for result in results if result.frame_index != AT} == {"ok"}
    np.testing.assert_array_equal(results[AT].labels, results[AT - 1].labels)
    after = range(AT + 5, FRAMES)
    assert two_label_f(results, clip.scene, after) > two_label_f(undisturbed, clip.scene, after) - 0.02
    assert [one.layer for one in results[-1].layers] == [one.layer for one in undisturbed[-1].layers]


def test_a_picture_that_is_known_to_be_damaged_is_passed_over_however_it_looks(
    clip: LabelledClip, pictures: list[Array], undisturbed: list[Result]
) -> None:
    results = after_first_half(clip, pictures[AT:], concealed=AT)
    assert [result.frame_index for result in results if result.status != "ok"] == [AT]
    assert results[AT].status == "damaged"
    np.testing.assert_array_equal(results[AT].labels, results[AT - 1].labels)
    assert [one.layer for one in results[-1].layers] == [one.layer for one in undisturbed[-1].layers]


@pytest.mark.parametrize("gain", [(1.9, 1.9, 1.9), (0.5, 0.5, 0.5), (0.8, 1.0, 1.2)])
def test_a_lasting_change_of_light_costs_little_and_no_id(
    clip: LabelledClip, pictures: list[Array], undisturbed: list[Result], gain: tuple[float, ...]
) -> None:
    lit = [np.clip(picture * np.array(gain), 0, 255).astype(np.uint8) for picture in pictures[AT:]]
    results = after_first_half(clip, lit)
    after = range(AT + 5, FRAMES)
    assert two_label_f(results, clip.scene, after) > two_label_f(undisturbed, clip.scene, after) - 0.05
    assert [one.layer for one in results[-1].layers] == [one.layer for one in undisturbed[-1].layers]


def test_a_cut_begins_a_scene_whose_objects_have_new_ids(clip: LabelledClip) -> None:
    street = scene("street", frames=FRAMES, width=320, height=240)
    other = [street.frame(index) for index in range(AT)]
    results, alone = after_first_half(clip, other), labelled(other)
    assert [result.frame_index for result in results if result.status != "ok"] == [AT]
    assert results[AT].status == "cut"
    before = {one.layer for result in results[:AT] for one in result.layers}
    after = {one.layer for result in results[AT:] for one in result.layers}
    assert before
    assert after
    assert not before & after
    for cut, result in zip(results[AT:], alone, strict=True):
        np.testing.assert_array_equal(cut.labels > 0, result.labels > 0)


@pytest.mark.parametrize(("count", "status"), [(4, "ok"), (12, "cut")])
def test_a_scene_begins_after_the_blank_frames_before_it(
    pictures: list[Array], undisturbed: list[Result], count: int, status: str
) -> None:
    blank = [np.zeros_like(pictures[0])] * count
    results = labelled([*blank, *pictures[:AT]])
    assert [result.status for result in results[: count + 1]] == ["blank"] * count + [status]
    for late, result in zip(results[count:], undisturbed[:AT], strict=True):
        np.testing.assert_array_equal(late.labels, result.labels)


def test_noise_alone_is_labelled_soon_and_makes_no_object() -> None:
    rng = np.random.default_rng(3)
    subtractor = MultilayerSubtractor()
    results: list[Result] = []
    for given in range(1, 25):
        results += subtractor.apply(rng.integers(0, 255, (120, 160, 3)).astype(np.uint8))
        assert given - len(results) <= 7
    results += subtractor.flush()
    assert [result.frame_index for result in results] == list(range(24))
    assert not any(result.labels.any() for result in results)


def test_a_subtractor_that_is_pickled_in_a_flash_goes_on_as_it_would_have(
    clip: LabelledClip, pictures: list[Array]
) -> None:
    frames = pictures[AT:]
    for index in (0, 1):
        frames[index] = np.clip(frames[index].astype(int) + 120, 0, 255).astype(np.uint8)
    expected = after_first_half(clip, frames)
    results, subtractor = clip.first_half()
    results += subtractor.apply(frames[0])
    restored = pickle.loads(pickle.dumps(subtractor))
    results += [result for frame in frames[1:] for result in restored.apply(frame)]
    results += restored.flush()
    for result, other in zip(results, expected, strict=True):
        assert result.status == other.status
        np.testing.assert_array_equal(result.labels, other.labels)


def test_only_blank_frames_give_empty_label_maps() -> None:
    for result in labelled([np.zeros((96, 128, 3), np.uint8)] * 8):
        assert result.status == "blank"
        assert not result.labels.any()


def texture(rng: np.random.Generator, height: int, width: int, contrast: float) -> Array:
    fine = cv2.GaussianBlur(rng.normal(0, 1, (height, width, 3)), (0, 0), 2.0)
    return np.asarray(contrast * fine / fine.std())


def noisy(picture: Array, rng: np.random.Generator, noise: float = 2.0) -> Array:
    return np.clip(picture + rng.normal(0, noise, picture.shape), 0, 255).astype(np.uint8)


def sky(frames: int) -> list[Array]:
    rng, (y, x) = np.random.default_rng(5), np.mgrid[0:240, 0:320]
    shades = [150 + 0.2 * y + 20 * np.sin((x + 24 * index) / 160) for index in range(frames)]
    return [noisy(np.stack([shade] * 3, axis=-1), rng) for shade in shades]


def sea(frames: int) -> list[Array]:
    rng, result = np.random.default_rng(6), []
    waves = texture(rng, 240, 320, 18)
    for _ in range(frames):
        waves = 0.75 * waves + 0.66 * texture(rng, 240, 320, 18)
        result.append(noisy(np.array([120, 90, 60]) + waves.mean(axis=2, keepdims=True), rng))
    return result


def night(frames: int) -> list[Array]:
    rng = np.random.default_rng(7)
    lights = rng.uniform((10, 10), (380, 230), (20, 2))
    result = []
    for index in range(frames):
        picture = np.full((240, 320, 3), 6.0)
        for x, y in lights:
            cv2.circle(picture, (round(x - 2 * index), round(y)), 4, (200, 220, 240), -1)
        result.append(noisy(picture, rng, 4.0))
    return result


@pytest.mark.parametrize("without_corners", [sky, sea, night])
def test_where_the_motion_of_the_camera_cannot_be_told_the_row_says_so_and_nothing_is_born(
    without_corners: Callable[[int], list[Array]],
) -> None:
    results = labelled(without_corners(16))
    statuses = [result.status for result in results[1:]]
    assert set(statuses) <= {"ok", "untracked"}  # a pair of waves is alike now and then
    assert statuses.count("untracked") >= 0.9 * len(statuses)
    assert not any(result.labels.any() for result in results)


def test_an_object_goes_on_before_a_sky_and_behind_it_the_camera_is_tracked_again() -> None:
    rng = np.random.default_rng(8)
    frames, step, edges = 80, 10, (340, 760)
    width = 320 + step * frames
    clear = np.clip((np.arange(width) - edges[0]) / 60, 0, 1) * np.clip(
        (edges[1] - np.arange(width)) / 60, 0, 1
    )
    ground = 120 + (1 - clear[None, :, None]) * texture(rng, 240, width, 35)
    patch = 120 + texture(rng, 40, 60, 45)
    pictures = []
    for index in range(frames):
        picture = ground[:, step * index : step * index + 320].copy()
        x, y = round(100 + 40 * np.sin(index / 6)), round(100 + 20 * np.cos(index / 9))
        picture[y : y + 40, x : x + 60] = patch
        pictures.append(noisy(picture, rng))
    results = labelled(pictures)
    untracked = [result.frame_index for result in results if result.status == "untracked"]
    # Where hardly anything but the sky is seen, and not where much of the ground is.
    assert set(range(38, 42)) <= set(untracked) <= set(range(30, 50))
    assert {result.status for result in results} == {"ok", "untracked"}
    (thing,) = {one.layer for result in results[30:] for one in result.layers if one.layer}
    assert all((result.labels == thing).mean() > 0.02 for result in results[30:])


def test_noise_of_a_codec_is_a_repetition_and_a_moving_thing_is_none() -> None:
    gray = np.random.default_rng(0).integers(0, 255, (60, 80)).astype(np.uint8)
    assert repeats(gray, gray)
    moved = gray.copy()
    moved[10:20, 10:20] = gray[10:20, 11:21]
    assert not repeats(moved, gray)


def test_sensor_noise_alone_is_still_and_a_dim_little_thing_is_not() -> None:
    rng = np.random.default_rng(0)
    place = rng.integers(20, 235, (120, 160)).astype(np.float64)

    def seen(light: float = 0.0) -> Array:
        return np.clip(place + light + rng.normal(0, 1.5, place.shape), 0, 255).astype(np.uint8)

    before = seen()
    assert is_still(seen(), before)
    assert not is_still(seen(light=5), before)
    place[40:46, 60:66] += 12
    assert not is_still(seen(), before)
    assert not is_still(before[:-1], before)


def _driven(thing: Array, lefts: Sequence[float], rng: np.random.Generator) -> Iterator[Array]:
    """A still camera; a thing's left edge is at each of these columns in turn."""
    made = scene("static-empty", frames=len(lefts), width=320, height=240)
    for t, left in enumerate(lefts):
        place = np.array([[1, 0, left], [0, 1, 120]], np.float32)
        share = cv2.warpAffine(np.ones(thing.shape[:2], np.float32), place, (320, 240))[..., None]
        there = noisy(cv2.warpAffine(thing, place, (320, 240)), rng)
        yield (made.frame(t) * (1 - share) + there * share).astype(np.uint8)


def _creeping(frames: int, speed: float) -> Iterator[Array]:
    """A still camera; from frame 30 on something creeps through the picture."""
    rng = np.random.default_rng(3)
    thing = cv2.resize(
        rng.integers(80, 176, (8, 8, 3)).astype(np.uint8), (40, 40), interpolation=cv2.INTER_CUBIC
    )
    return _driven(thing, [100 + max(0, t - 30) * speed for t in range(frames)], rng)


@pytest.mark.long
def test_an_empty_place_is_passed_over_and_what_comes_into_it_is_found(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    frames = list(_creeping(60, 0.5))
    results = labelled(frames)
    assert {result.status for result in results[6:29]} == {"repeated"}
    assert {result.status for result in results[40:]} == {"ok"}
    monkeypatch.setattr("mlbs_actors.coordinator.gate.is_still", lambda gray, before: False)
    looked_at = labelled(frames)
    assert {result.status for result in looked_at} == {"ok"}

    def birth(those: list[Result]) -> int:
        return next(result.frame_index for result in those if result.labels.any())

    assert 30 < birth(results) <= birth(looked_at)
    assert all(result.labels.any() for result in results[birth(results) :])


def _parking(frames: int) -> Iterator[Array]:
    """A still camera; something drives in for 40 frames, parks until the last 20, and drives on."""
    rng = np.random.default_rng(3)
    thing = cv2.resize(
        rng.integers(0, 256, (5, 8, 3)).astype(np.uint8), (72, 44), interpolation=cv2.INTER_CUBIC
    )
    driven = [3.5 * (min(t, 40) + max(t - (frames - 20), 0)) - 20 for t in range(frames)]
    return _driven(thing, driven, rng)


def test_a_place_in_which_all_has_come_to_rest_is_passed_over_until_something_moves(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    frames = list(_parking(100))
    results = labelled(frames)
    # Noise may exceed the threshold once in a while.
    assert [result.status for result in results[60:80]].count("repeated") > 15
    assert {result.status for result in results[82:]} == {"ok"}
    monkeypatch.setattr("mlbs_actors.coordinator.gate.is_still", lambda gray, before: False)
    looked_at = labelled(frames)
    assert {result.status for result in looked_at} == {"ok"}
    for passed, seen in zip(results, looked_at, strict=True):
        both = (passed.labels > 0) & (seen.labels > 0)
        assert both.sum() >= 0.9 * ((passed.labels > 0) | (seen.labels > 0)).sum()
        assert {one.layer for one in passed.layers} == {one.layer for one in seen.layers}


def test_an_empty_place_of_another_size_is_looked_at_before_it_is_passed_over() -> None:
    small = scene("static-empty", frames=14, width=160, height=120)
    large = scene("static-empty", frames=14, width=320, height=240)
    results = labelled([one.frame(index) for one in (small, large) for index in range(14)])
    for begin in (0, 14):
        assert {result.status for result in results[begin : begin + 5]} == {"ok"}
        assert {result.status for result in results[begin + 6 : begin + 14]} == {"repeated"}


def test_objects_of_a_video_that_shows_each_picture_three_times_are_found(pictures: list[Array]) -> None:
    results = labelled([pictures[0], *(picture for picture in pictures[:24] for _ in range(3))])
    assert all(result.labels.any() for result in results[40:])


@pytest.mark.parametrize(("gain", "offset"), [(1.2, 0.0), (0.6, 10.0), (1.0, -20.0)])
def test_the_change_of_light_is_that_of_matched_colours(gain: float, offset: float) -> None:
    rng = np.random.default_rng(1)
    before = rng.integers(40, 160, (2000, 3)).astype(np.uint8)
    after = np.clip(gain * before + offset + rng.normal(0, 2, before.shape), 0, 255).astype(np.uint8)
    after[:60] = rng.integers(0, 255, (60, 3))  # of something that moves
    levels = np.stack([np.arange(50, 150, dtype=np.uint8)] * 3, axis=1)
    expected = np.clip(gain * levels + offset, 0, 255)
    assert np.abs(relit(levels, light_change(before, after)) - expected).max() < 5.0


@pytest.mark.parametrize("gain", [1.03, 1 / 1.03])
@pytest.mark.parametrize(("brightest", "sharpness"), [(330, 1.0), (230, 0.9)])
def test_a_small_gain_of_the_light_is_told_where_much_is_cut_off_and_in_motion_blur(
    gain: float, brightest: float, sharpness: float
) -> None:
    rng = np.random.default_rng(3)
    scene = rng.uniform(60, brightest, (2000, 3))
    before = np.clip(scene + rng.normal(0, 4, scene.shape), 0, 255).astype(np.uint8)
    blurred = scene.mean() + sharpness * (scene - scene.mean())
    after = np.clip(gain * blurred + rng.normal(0, 4, scene.shape), 0, 255).astype(np.uint8)
    change = light_change(before, after)
    assert change.size
    np.testing.assert_allclose(change[:, 200] / 200, gain, atol=0.012)


def test_noise_and_moving_things_are_no_change_of_light() -> None:
    rng = np.random.default_rng(2)
    before = rng.integers(20, 230, (2000, 3)).astype(np.uint8)
    after = np.clip(before + rng.normal(0, 3, before.shape), 0, 255).astype(np.uint8)
    assert light_change(before, after).size == 0
