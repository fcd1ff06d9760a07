"""One stream in one process: what a user of the class can rely on, on small synthetic scenes."""

from __future__ import annotations

import pickle
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np
import pytest
from threadpoolctl import threadpool_info  # type: ignore[import-untyped]

from mlbs_actors import Config, ConfigError, FrameError, MlbsError, MultilayerSubtractor, Result
from mlbs_actors.inspection import FrameInspection
from mlbs_actors.messages import Array
from mlbs_actors.scenes.synthetic import SyntheticScene, scene
from mlbs_actors.subtractor import _say_if_it_compiles


def run(pictures: Iterable[Array], config: Config | None = None) -> list[Result]:
    subtractor = MultilayerSubtractor(config)
    return [one for picture in pictures for one in subtractor.apply(picture)] + subtractor.flush()


def pictures_of(video: SyntheticScene, frames: int) -> list[Array]:
    return [video.frame(t) for t in range(frames)]


def overlap(labels: Array, truth: Array) -> float:
    """Intersection over union of everything that is not background."""
    return float(((labels > 0) & (truth > 0)).sum() / ((labels > 0) | (truth > 0)).sum())


def as_bytes(results: list[Result]) -> list[tuple[object, ...]]:
    """All that is published, without the times."""
    return [
        (
            one.frame_index,
            one.labels.tobytes(),
            one.normaliser.tobytes(),
            one.fallback.tobytes(),
            one.layers,
            one.camera_motion,
        )
        for one in results
    ]


@pytest.fixture(scope="module")
def pan() -> tuple[SyntheticScene, list[Array], list[Result]]:
    """A panning camera and two objects, twelve frames of it, and what was found."""
    video = scene("pan", frames=60)
    pictures = pictures_of(video, 12)
    return video, pictures, run(pictures)


def test_a_flow_function_is_asked_once_for_each_pair_of_frames_whatever_happens_between_them(
    pan: tuple[SyntheticScene, list[Array], list[Result]],
) -> None:
    dis = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_ULTRAFAST)
    asked: list[tuple[int, int]] = []

    def flow(one: Array, other: Array) -> Array:
        asked.append((hash(one.tobytes()), hash(other.tobytes())))
        first, second = (cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY) for picture in (one, other))
        motion: Array = dis.calc(first, second, None)  # type: ignore[call-overload]
        return motion

    _, pictures, _ = pan
    darker = [(0.5 * picture).astype(np.uint8) for picture in pictures[6:8]]
    elsewhere = pictures_of(scene("pan", frames=60, seed=1), 7)
    shown = [*pictures[:6], *darker, *pictures[8:10], *elsewhere, *pictures[10:12]]
    subtractor = MultilayerSubtractor(flow=flow)
    results = [one for picture in shown for one in subtractor.apply(picture)] + subtractor.flush()
    assert [one.status for one in results].count("cut") == 2  # there and back
    assert len(asked) == len(set(asked))
    assert len(asked) > 2 * (len(shown) - 1)  # frames that wait are compared with the next one, too


def test_a_call_from_another_thread_while_a_frame_is_worked_on_is_refused_and_does_no_harm(
    pan: tuple[SyntheticScene, list[Array], list[Result]],
) -> None:
    _, pictures, expected = pan
    refusals: list[BaseException | None] = []

    def call_from_another_thread(_: FrameInspection) -> None:
        with ThreadPoolExecutor(1) as other:
            refusals.append(other.submit(subtractor.apply, pictures[0]).exception())
            refusals.append(other.submit(subtractor.flush).exception())

    subtractor = MultilayerSubtractor(inspector=call_from_another_thread)
    results = [one for picture in pictures for one in subtractor.apply(picture)] + subtractor.flush()
    assert len(refusals) == 2 * len(pictures)
    assert all(isinstance(one, MlbsError) and "of its own" in str(one) for one in refusals)
    assert as_bytes(results) == as_bytes(expected)


def test_subtractors_in_threads_of_their_own_do_not_disturb_each_other(
    pan: tuple[SyntheticScene, list[Array], list[Result]],
) -> None:
    _, pictures, expected = pan
    with ThreadPoolExecutor(3) as threads:
        for results in threads.map(run, [pictures] * 3):
            assert as_bytes(results) == as_bytes(expected)


@pytest.mark.parametrize("taken", [2, 7])  # while frames are held, and later
def test_what_is_restored_from_a_pickle_goes_on_as_the_original(
    pan: tuple[SyntheticScene, list[Array], list[Result]], taken: int
) -> None:
    _, pictures, expected = pan
    original = MultilayerSubtractor(Config())
    results = [one for picture in pictures[:taken] for one in original.apply(picture)]
    pickled = pickle.dumps(original)
    original.apply(pictures[0])  # what becomes of the original is nothing to the copy
    restored = pickle.loads(pickled)
    assert restored.config == original.config
    results += [one for picture in pictures[taken:] for one in restored.apply(picture)] + restored.flush()
    assert as_bytes(results) == as_bytes(expected)


@pytest.mark.parametrize("compiled", [True, False])
def test_the_first_use_says_that_it_compiles(
    compiled: bool, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr("mlbs_actors.subtractor.has_machine_code", lambda: compiled)
    _say_if_it_compiles.cache_clear()
    MultilayerSubtractor().apply(np.zeros((96, 128, 3), np.uint8))
    assert ("compiles for one to three minutes" in caplog.text) != compiled


def test_something_else_than_a_configuration_is_refused() -> None:
    with pytest.raises(ConfigError, match="load_config"):
        MultilayerSubtractor("my.yaml")  # type: ignore[arg-type]


def test_every_frame_gets_one_label_map_in_order(
    pan: tuple[SyntheticScene, list[Array], list[Result]],
) -> None:
    _, pictures, results = pan
    assert [one.frame_index for one in results] == list(range(len(pictures)))
    for one in results:
        assert one.labels.shape == pictures[0].shape[:2]
        assert one.labels.dtype == np.uint16
        assert one.layers == tuple(sorted(one.layers, key=lambda layer: layer.layer))
        assert {layer.layer for layer in one.layers} == set(np.unique(one.labels).tolist()) - {0}


def test_moving_objects_are_found_each_with_a_label_of_its_own_that_lasts(
    pan: tuple[SyntheticScene, list[Array], list[Result]],
) -> None:
    video, _, results = pan
    owners: dict[int, set[int]] = {1: set(), 2: set()}
    for one in results[1:]:
        truth = video.labels(one.frame_index)
        assert overlap(one.labels, truth) > 0.75
        for thing, labels in owners.items():
            labels.add(int(np.bincount(one.labels[truth == thing]).argmax()))
    assert all(len(labels) == 1 for labels in owners.values())
    assert len(owners[1] | owners[2]) == 2
    assert 0 not in owners[1] | owners[2]


def test_the_motions_of_camera_and_objects_are_told(
    pan: tuple[SyntheticScene, list[Array], list[Result]],
) -> None:
    video, _, results = pan
    for one in results[1:]:
        truth, flow = video.labels(one.frame_index), -video.flow(one.frame_index)
        assert one.camera_motion == pytest.approx(np.median(flow[truth == 0], axis=0).tolist(), abs=0.5)
        for layer in one.layers:
            if layer.area > 200:
                expected = np.median(flow[(one.labels == layer.layer) & (truth > 0)], axis=0)
                assert layer.velocity == pytest.approx(expected.tolist(), abs=0.5)


def test_the_caller_may_use_its_frame_buffer_again(
    pan: tuple[SyntheticScene, list[Array], list[Result]],
) -> None:
    _, pictures, results = pan
    buffer = np.empty_like(pictures[0])
    subtractor = MultilayerSubtractor()
    got = []
    for picture in pictures:
        buffer[:] = picture
        got += subtractor.apply(buffer)
        buffer[:] = 77
    assert as_bytes(got + subtractor.flush()) == as_bytes(results)


def test_a_frame_may_be_a_view_and_is_left_as_it_was(
    pan: tuple[SyntheticScene, list[Array], list[Result]],
) -> None:
    _, pictures, results = pan
    views = [np.ascontiguousarray(picture[:, ::-1])[:, ::-1] for picture in pictures]
    for view in views:
        view.flags.writeable = False
        assert not view.flags.c_contiguous
    assert as_bytes(run(views)) == as_bytes(results)


@pytest.mark.parametrize("name", ["no-mover", "near-scene", "static-empty"])
def test_without_a_mover_every_label_is_background(name: str) -> None:
    results = run(pictures_of(scene(name, frames=60), 16))
    assert len(results) == 16
    for one in results:
        assert not one.labels.any()
        assert one.layers == ()


def test_a_walker_before_a_still_camera_is_found() -> None:
    video = scene("static-walker", frames=60)
    results = run(pictures_of(video, 20))
    found = [overlap(one.labels, video.labels(one.frame_index)) for one in results[10:]]
    assert np.mean(found) > 0.4


@pytest.mark.parametrize(
    ("name", "frames"), [("walker", 60), pytest.param("rest", 240, marks=pytest.mark.long)]
)
def test_a_walker_and_a_car_that_rests_keep_one_id(name: str, frames: int) -> None:
    video = scene(name, frames=frames, width=240, height=180)
    results = run(pictures_of(video, frames))
    found = [overlap(one.labels == 1, video.labels(one.frame_index)) for one in results[10:]]
    assert np.mean(found) > 0.7
    assert min(found[-10:]) > 0.6


def test_a_look_ahead_delays_every_result_and_says_so() -> None:
    config = Config.model_validate({"layers": {"lookahead": 3, "init_frames": 2}})
    video = scene("pan", frames=60)
    subtractor = MultilayerSubtractor(config)
    for t in range(9):
        results = subtractor.apply(video.frame(t))
        assert [one.frame_index for one in results] == ([t - 3] if t >= 3 else [])
        assert all(one.latency_frames == 3 for one in results)
    rest = subtractor.flush()
    assert [(one.frame_index, one.latency_frames) for one in rest] == [(6, 2), (7, 1), (8, 0)]
    assert overlap(rest[-1].labels, video.labels(8)) > 0.75


@pytest.mark.parametrize("frames", [0, 1, 2, 3])
def test_a_short_video_gives_one_result_a_frame(frames: int) -> None:
    results = run(pictures_of(scene("pan", frames=60, width=160, height=120), frames))
    assert [one.frame_index for one in results] == list(range(frames))
    assert all(one.labels.shape == (120, 160) for one in results)


def test_flushing_again_gives_nothing_more() -> None:
    subtractor = MultilayerSubtractor()
    assert subtractor.flush() == []
    assert subtractor.apply(scene("pan", width=64, height=48).frame(0)) == []
    assert len(subtractor.flush()) == 1
    assert subtractor.flush() == []


def noise(height: int, width: int, frames: int) -> list[Array]:
    rng = np.random.default_rng(0)
    return [rng.integers(0, 256, (height, width, 3)).astype(np.uint8) for _ in range(frames)]


def flat(level: int, frames: int = 8) -> list[Array]:
    return [np.full((60, 80, 3), level, np.uint8)] * frames


@pytest.mark.parametrize(
    "pictures",
    [
        flat(0),
        flat(255),
        flat(128),
        flat(0, 4) + flat(255, 4),
        [np.dstack([np.tile(np.arange(80, dtype=np.uint8), (60, 1))] * 3)] * 8,
    ],
    ids=["black", "white", "grey", "black, then white", "a gradient"],
)
def test_frames_without_texture_are_background(pictures: list[Array]) -> None:
    results = run(pictures)
    assert len(results) == len(pictures)
    assert not any(one.labels.any() for one in results)


@pytest.mark.parametrize(("height", "width"), [(16, 16), (1, 40), (40, 1), (1, 1), (33, 47), (8, 300)])
def test_frames_of_any_size_are_taken(height: int, width: int) -> None:
    results = run(noise(height, width, 8))
    assert [one.labels.shape for one in results] == [(height, width)] * 8


def test_a_scene_cut_and_a_frozen_video_are_survived() -> None:
    one = pictures_of(scene("pan", frames=60, width=160, height=120), 7)
    other = pictures_of(scene("demo", frames=60, width=160, height=120), 4)
    results = run([*one, *other, *[other[-1]] * 4])
    assert [result.frame_index for result in results] == list(range(15))


@pytest.mark.parametrize(("before", "lookahead"), [(6, 0), (2, 2)])
def test_a_change_of_size_begins_anew_and_no_id_is_given_again(before: int, lookahead: int) -> None:
    config = Config.model_validate({"layers": {"lookahead": lookahead}})
    large = pictures_of(scene("pan", frames=60, width=144, height=108), before)
    small = pictures_of(scene("pan", frames=60, width=120, height=90), 8)
    results = run([*large, *small, *large], config)
    assert [one.frame_index for one in results] == list(range(2 * before + 8))
    used = 0
    for begin, alone in (
        (0, run(large, config)),
        (before, run(small, config)),
        (before + 8, run(large, config)),
    ):
        epoch = results[begin : begin + len(alone)]
        ids = {layer.layer for one in epoch for layer in one.layers}
        # By how much ids are larger; a layer before may have owned no pixel, so that nobody saw its id.
        larger = min(ids) - min(layer.layer for one in alone for layer in one.layers)
        for here, there in zip(epoch, alone, strict=True):
            expected = np.where(there.labels > 0, there.labels + larger, 0)
            np.testing.assert_array_equal(here.labels, expected)
            np.testing.assert_array_equal(here.normaliser, there.normaliser)
            assert here.camera_motion == there.camera_motion
        assert all(one > used for one in ids)
        used = max([used, *ids])
    assert used > 0, "a scene without a layer proves little"


def test_frames_whose_size_changes_all_the_time_are_all_labelled() -> None:
    sizes = [(48, 64), (40, 64), (48, 64), (48, 63), (1, 5), (48, 64)]
    rng = np.random.default_rng(0)
    results = run([rng.integers(0, 255, (*size, 3)).astype(np.uint8) for size in sizes])
    assert [one.labels.shape for one in results] == sizes
    assert [one.latency_frames for one in results] == [1] * 5 + [0]


def test_a_refused_frame_is_told_in_a_sentence_and_the_stream_goes_on() -> None:
    video = scene("pan", frames=60, width=160, height=120)
    subtractor = MultilayerSubtractor()
    results = []
    for t in range(7):
        with pytest.raises(FrameError, match="uint8 BGR image"):
            subtractor.apply(video.frame(t)[..., 0])
        results += subtractor.apply(video.frame(t))
    assert as_bytes(results + subtractor.flush()) == as_bytes(run(pictures_of(video, 7)))


def test_the_numbers_of_threads_are_as_before() -> None:
    def thread_counts() -> dict[str, int]:
        pools = {str(pool["filepath"]): int(pool["num_threads"]) for pool in threadpool_info()}
        return {"OpenCV": cv2.getNumThreads(), **pools}

    opencv_threads = cv2.getNumThreads()
    cv2.setNumThreads(2)
    try:
        before = thread_counts()
        subtractor = MultilayerSubtractor()
        for picture in noise(32, 48, 6):
            subtractor.apply(picture)
            assert thread_counts() == before
        with pytest.raises(FrameError):
            subtractor.apply(np.zeros((32, 48), np.uint8))
        assert thread_counts() == before
        subtractor.flush()
        assert thread_counts() == before
    finally:
        cv2.setNumThreads(opencv_threads)


def test_only_the_frames_that_are_still_needed_are_kept() -> None:
    subtractor = MultilayerSubtractor()
    video = scene("pan", frames=60, width=160, height=120)
    for t in range(10):
        subtractor.apply(video.frame(t))
    assert len(subtractor._published) <= 3
    assert len(subtractor._waiting) == 0
