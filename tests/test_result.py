"""What a user of the class gets for a frame: boxes, masks, the frame's own tag, and which ids come and go."""

from __future__ import annotations

import logging
import pickle
import re
import subprocess
import sys
from base64 import b64decode
from collections.abc import Iterable, Iterator
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
import pytest
from record_fakes import segmentation

from mlbs_actors import (
    Boxes,
    Config,
    ConfigError,
    FrameError,
    MlbsError,
    MultilayerSubtractor,
    Result,
    Segmentation,
    SourceError,
    load_config,
)
from mlbs_actors.messages import Array
from mlbs_actors.pictures import layer_colour
from mlbs_actors.result_log import ResultLog
from mlbs_actors.scenes.synthetic import scene
from mlbs_actors.segmentation.attached_parts import PartsState

COLOURS: tuple[Literal["bgr", "rgb"], ...] = ("bgr", "rgb")


def pictures_of(name: str, frames: int, first: int = 0) -> list[Array]:
    video = scene(name, frames=max(frames, 60), width=160, height=120)
    return [video.frame(index) for index in range(first, frames)]


def run(pictures: Iterable[Array], config: Config | None = None) -> list[Result]:
    subtractor = MultilayerSubtractor(config)
    return [one for picture in pictures for one in subtractor.apply(picture)] + subtractor.flush()


def with_layers(index: int, layers: set[int]) -> Segmentation:
    """A label map with rows of some of the objects 3, 5 and 7."""
    every = segmentation(index, 3, 5, 7)
    return replace(every, layers=tuple(one for one in every.layers if one.layer in layers))


def shown(result: Result) -> set[int]:
    return set(np.unique(result.labels).tolist()) - {0}


def ended(results: Iterable[Result]) -> list[int]:
    return [layer for one in results for layer in one.ended]


def events(results: Iterable[Result]) -> list[tuple[tuple[int, ...], ...]]:
    return [(one.born, one.absent, one.ended) for one in results]


def hold_what_they_mean(results: Iterable[Result]) -> None:
    """Check the events of a whole stream against its label maps."""
    before: set[int] = set()
    over: set[int] = set()
    for one in results:
        here = shown(one)
        assert set(one.born) == here - before
        assert not here & over
        assert set(one.ended) <= before - here - over
        before |= here
        over |= set(one.ended)
        assert set(one.absent) == before - here - over


def test_boxes_hold_all_pixels_of_their_objects_and_no_row_or_column_more() -> None:
    result = segmentation(0, 3, 5)
    boxes = result.boxes()
    assert boxes.ids.tolist() == [3, 5]
    assert boxes.xyxy.shape == (2, 4)
    for layer, (left, top, right, bottom) in zip(*boxes, strict=True):
        rows, columns = np.nonzero(result.labels == layer)
        assert (left, top) == (columns.min(), rows.min())
        assert (right, bottom) == (columns.max() + 1, rows.max() + 1)


def test_a_label_map_without_objects_has_no_boxes() -> None:
    ids, xyxy = with_layers(0, set()).boxes()
    assert (ids.shape, xyxy.shape) == ((0,), (0, 4))
    assert xyxy.dtype == Boxes(*segmentation(0, 3).boxes()).xyxy.dtype == np.int32


def test_a_mask_is_of_one_object_and_empty_for_one_that_is_not_there() -> None:
    result = segmentation(0, 3, 5)
    np.testing.assert_array_equal(result.mask(5), result.labels == 5)
    assert result.mask(5).dtype == bool
    for absent in (4, 70_000, -1):
        assert result.mask(absent).shape == result.labels.shape
        assert not result.mask(absent).any()


def test_the_repr_of_a_result_shows_its_objects_and_no_array() -> None:
    (result,) = run(pictures_of("pan", 1))
    assert repr(result) == "Result(frame 0, 160×120, objects none)"
    assert "array" not in repr(result)
    assert "LayerSummary(layer=3" in repr(segmentation(0, 3))


def test_ids_are_born_once_may_be_absent_and_end_once() -> None:
    known: set[int] = set()
    steps = [({3, 5}, {3, 5}), ({3}, {3, 5}), ({3, 5, 7}, {3, 5, 7}), ({7}, {3, 7}), (set(), set())]
    results = [
        Result.of(with_layers(index, here), index, known, possible)
        for index, (here, possible) in enumerate(steps)
    ]
    assert events(results) == [
        ((3, 5), (), ()),
        ((), (5,), ()),
        ((7,), (), ()),
        ((), (3,), (5,)),
        ((), (), (3, 7)),
    ]
    assert [one.tag for one in results] == [0, 1, 2, 3, 4]
    assert not known


@pytest.mark.parametrize("lookahead", [pytest.param(0, marks=pytest.mark.long), 3])
def test_an_object_that_leaves_is_absent_and_then_ends(lookahead: int) -> None:
    config = load_config(None, [f"layers.lookahead={lookahead}", "layers.dormant_frames=5"])
    video = scene("leave", frames=80, width=240, height=180)
    results = run([video.frame(index) for index in range(80)], config)
    hold_what_they_mean(results)
    (leaver,) = shown(results[60]) & set(ended(results))
    last_seen = max(one.frame_index for one in results if leaver in shown(one))
    (end,) = (one.frame_index for one in results if leaver in one.ended)
    assert 1 <= end - last_seen <= 15
    assert all(leaver in one.absent for one in results[last_seen + 1 : end])


@pytest.mark.parametrize("lookahead", [pytest.param(0, marks=pytest.mark.long), 20])
def test_an_object_that_comes_out_from_where_it_hid_has_not_ended(lookahead: int) -> None:
    video = scene("hidden", frames=110, width=240, height=180)
    pictures = [video.frame(index) for index in (*range(42), *range(40, 20, -1))]  # and back again
    # With the look-ahead, all frames in which it is hidden are held until the size changes.
    smaller = [cv2.resize(one, (160, 120)) for one in pictures[:8]]
    results = run([*pictures, *smaller], load_config(None, [f"layers.lookahead={lookahead}"]))
    hold_what_they_mean(results)
    absent = [one.frame_index for one in results if 1 in one.absent]
    assert 5 <= len(absent) <= 30
    assert absent[-1] < max(one.frame_index for one in results if 1 in shown(one))
    assert 1 in ended(results)


def test_an_id_has_not_ended_while_a_held_frame_or_a_part_has_it() -> None:
    subtractor = MultilayerSubtractor(load_config(None, ["layers.lookahead=2"]))
    for picture in pictures_of("pan", 10):
        subtractor.apply(picture)
    epoch = subtractor._coordinator.state.epoch
    parts = PartsState(*np.array([[88], [0], [99], [0], [0], [0]]))
    first, *others = epoch.held
    epoch.held = (replace(first, labels=np.full_like(first.labels, 77)), *others)
    subtractor._segmenter.state = replace(subtractor._segmenter.state, parts=parts)
    assert {77, 99} <= subtractor._possible_ids([])


@pytest.mark.parametrize("lookahead", [0, 3])
def test_objects_that_a_cut_has_taken_away_end_when_their_scene_is_forgotten(lookahead: int) -> None:
    results = run(
        [*pictures_of("pan", 12), *pictures_of("demo", 12)],
        load_config(None, [f"layers.lookahead={lookahead}", "layers.dormant_frames=6"]),
    )
    hold_what_they_mean(results)
    first = {layer for one in results[:12] for layer in shown(one)}
    assert first
    assert set(shown(results[11])) <= set(results[13].absent)
    assert first == set(ended(results))
    assert results[-1].boxes().ids.size


def test_a_change_of_size_ends_all_objects() -> None:
    pictures = pictures_of("pan", 10)
    results = run([*pictures, *(cv2.resize(one, (120, 90)) for one in pictures)])
    hold_what_they_mean(results)
    assert {layer for one in results[:10] for layer in shown(one)} == set(ended(results))


@pytest.mark.parametrize(
    "name", ["hidden", *(pytest.param(name, marks=pytest.mark.long) for name in ("walker", "crowd"))]
)
def test_events_agree_with_the_label_maps_where_parts_and_hidden_objects_come_and_go(name: str) -> None:
    video = scene(name, frames=90, width=240, height=180)
    blank = np.zeros((180, 240, 3), np.uint8)
    pictures = [blank if index in (30, 31) else video.frame(index) for index in range(90)]
    results = run(pictures, load_config(None, ["layers.dormant_frames=3", "layers.lookahead=2"]))
    hold_what_they_mean(results)
    assert any(one.born for one in results)


def test_each_result_has_the_tag_of_its_frame() -> None:
    pictures = pictures_of("pan", 9)
    subtractor = MultilayerSubtractor(load_config(None, ["layers.lookahead=2"]))
    results = []
    for index, picture in enumerate(pictures):
        with pytest.raises(FrameError):
            subtractor.apply(picture[0], tag="refused")
        results += subtractor.apply(picture, tag=None if index == 4 else {"number": index})
    results += subtractor.flush()
    assert [one.tag for one in results] == [None if i == 4 else {"number": i} for i in range(9)]
    (plain,) = run(pictures[:1])
    assert plain.tag is None


def test_tags_and_events_go_on_in_a_copy_from_a_pickle() -> None:
    pictures = [*pictures_of("pan", 8), *pictures_of("demo", 8)]
    config = load_config(None, ["layers.lookahead=2"])
    subtractor, results = MultilayerSubtractor(config), []
    for index, picture in enumerate(pictures):
        results += subtractor.apply(picture, tag=(index, "s"))
        if index in (2, 7, 10):
            subtractor = pickle.loads(pickle.dumps(subtractor))
    results += subtractor.flush()
    assert [one.tag for one in results] == [(index, "s") for index in range(16)]
    assert events(results) == events(run(pictures, config))
    assert pickle.loads(pickle.dumps(results[3])).tag == (3, "s")


def test_a_tag_that_cannot_be_pickled_hinders_nothing_else() -> None:
    subtractor = MultilayerSubtractor()
    subtractor.apply(pictures_of("pan", 1)[0], tag=(one for one in "x"))
    with pytest.raises(TypeError, match="generator"):
        pickle.dumps(subtractor)
    (result,) = subtractor.flush()
    assert list(result.tag) == ["x"]


def test_a_video_is_segmented_as_its_frames_are(tmp_path: Path) -> None:
    path = tmp_path / "pan.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 25, (160, 120), True)
    for picture in pictures_of("pan", 8):
        writer.write(picture)
    writer.release()
    decoded = list(iter_video(path))
    expected = run(decoded)
    for video in (path, str(path), decoded, np.stack(decoded), reusing_their_buffer(decoded)):
        pairs = list(MultilayerSubtractor().segment(video))
        assert [one.frame_index for _, one in pairs] == list(range(8))
        for (frame, result), picture, alone in zip(pairs, decoded, expected, strict=True):
            np.testing.assert_array_equal(frame, picture)
            np.testing.assert_array_equal(result.labels, alone.labels)
            frame[:] = 0  # it may be drawn on, and that changes no other result


def iter_video(path: Path) -> Iterator[Array]:
    video = cv2.VideoCapture(str(path))
    there, picture = video.read()
    while there:
        yield picture
        there, picture = video.read()


def reusing_their_buffer(pictures: list[Array]) -> Iterator[Array]:
    buffer = np.empty_like(pictures[0])
    for picture in pictures:
        buffer[:] = picture
        yield buffer
    buffer[:] = 77


def test_results_come_before_the_video_ends() -> None:
    taken: list[int] = []

    def endless() -> Iterator[Array]:
        for picture in pictures_of("pan", 60):
            taken.append(len(taken))
            yield picture

    pairs = MultilayerSubtractor().segment(endless())
    assert not taken
    for _ in range(7):
        _, result = next(pairs)
    assert result.frame_index == 6
    assert len(taken) == 7


def test_a_video_that_is_left_or_broken_off_is_closed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    closed: list[str] = []

    class Endless:
        def __init__(self, path: str) -> None:
            self.path = path

        def read(self) -> tuple[bool, Array]:
            return True, np.zeros((48, 64, 3), np.uint8)

        def release(self) -> None:
            closed.append(self.path)

    monkeypatch.setattr(cv2, "VideoCapture", Endless)
    path = tmp_path / "x.mp4"
    path.touch()
    pairs = MultilayerSubtractor().segment(path)
    next(pairs)
    assert not closed
    pairs.close()
    assert closed == [str(path)]

    monkeypatch.setattr(Endless, "read", lambda _: (True, np.zeros((48, 64), np.uint8)))
    with pytest.raises(FrameError):
        next(MultilayerSubtractor().segment(path))
    assert closed == [str(path)] * 2


@pytest.mark.parametrize("name", ["none.mp4", "text.mp4", "rtsp://user:secret@host/stream"])
def test_a_video_that_cannot_be_read_is_refused_in_a_sentence(name: str, tmp_path: Path) -> None:
    (tmp_path / "text.mp4").write_text("no video")
    path = name if "://" in name else tmp_path / name
    with pytest.raises(SourceError, match=r"[a-z]\.$") as refused:
        list(MultilayerSubtractor().segment(path))
    assert isinstance(refused.value, MlbsError)
    assert "secret" not in str(refused.value)


def result_of(index: int, *layers: int, **changed: Any) -> Result:
    values = {one.name: getattr(segmentation(index, *layers), one.name) for one in fields(Segmentation)}
    return Result(**(values | changed))


def test_a_result_shows_itself_in_a_line() -> None:
    assert repr(result_of(7, 3, 5, born=(5,))) == "Result(frame 7, 50×36, objects 3 5, born 5)"
    none = result_of(7, 3, layers=(), status="cut", ended=(3, 4))
    assert repr(none) == "Result(frame 7, 50×36, cut, objects none, ended 3 4)"


def test_a_notebook_shows_the_label_map_and_a_row_for_each_object() -> None:
    html = result_of(7, 3, 5)._repr_html_()
    (encoded,) = re.findall(r'src="data:image/png;base64,([^"]+)"', html)
    picture = cv2.imdecode(np.frombuffer(b64decode(encoded), np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    labels = segmentation(7, 3, 5).labels
    assert picture.shape == (*labels.shape, 3)
    assert all((picture[labels == layer] == layer_colour(layer)).all() for layer in (3, 5))
    assert html.count("<tr>") == 3
    many = [replace(one, layer=number) for number in range(1, 31) for one in segmentation(7).layers]
    assert "and 10 more" in result_of(7, 3, layers=tuple(many))._repr_html_()
    wide = result_of(7, labels=np.zeros((720, 1280), np.uint16), layers=())._repr_html_()
    assert len(wide) < 2000


def test_a_subtractor_shows_its_size_and_how_far_it_is() -> None:
    subtractor = MultilayerSubtractor()
    assert repr(subtractor) == "MultilayerSubtractor(no frame yet)"
    found = [one for picture in pictures_of("pan", 8) for one in subtractor.apply(picture)]
    count = len(found[-1].layers)
    assert repr(subtractor) == f"MultilayerSubtractor(160×120, frames 8, objects {count})"


def test_frames_in_rgb_have_the_same_label_maps_and_come_back_in_rgb(tmp_path: Path) -> None:
    pictures = pictures_of("pan", 8)
    swapped = [picture[..., ::-1] for picture in pictures]
    subtractor = MultilayerSubtractor(colour="rgb")
    results = [one for picture in swapped[:6] for one in subtractor.apply(picture)]
    again = pickle.loads(pickle.dumps(subtractor))
    results += [one for picture in swapped[6:] for one in again.apply(picture)] + again.flush()
    pairs = list(MultilayerSubtractor(colour="rgb").segment(swapped))
    for one, other, (frame, third), picture in zip(run(pictures), results, pairs, swapped, strict=True):
        assert np.array_equal(one.labels, other.labels)
        assert np.array_equal(one.labels, third.labels)
        assert np.array_equal(frame, picture)
        assert frame.flags.writeable
    video = cv2.VideoWriter(str(tmp_path / "pan.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 25, (160, 120), True)
    for picture in pictures:
        video.write(picture)
    video.release()
    files = (MultilayerSubtractor(colour=order).segment(tmp_path / "pan.avi") for order in COLOURS)
    for (bgr, one), (rgb, other) in zip(*files, strict=True):
        assert np.array_equal(bgr, rgb[..., ::-1])
        assert np.array_equal(one.labels, other.labels)
    with pytest.raises(ConfigError, match='"bgr" or "rgb", not \'grey\''):
        MultilayerSubtractor(colour="grey")  # type: ignore[arg-type]


def test_the_log_has_new_scenes_lost_motion_and_objects(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.DEBUG, "mlbs_actors")
    log = ResultLog()
    log.note(result_of(0, 3, born=(3,)))
    log.note(result_of(1, 3))
    for index, status in enumerate(("untracked", "untracked", "ok", "cut"), 2):
        log.note(result_of(index, 3, status=status))
    log.note(result_of(6, 3, labels=np.zeros((10, 20), np.uint16), ended=(3,)))
    assert [(one.levelname, one.getMessage()) for one in caplog.records] == [
        ("DEBUG", "frame 0: born [3], ended []"),
        ("INFO", "frame 2: the camera's motion is lost"),
        ("INFO", "frame 4: the camera's motion is found again"),
        ("INFO", "frame 5: a cut, another scene begins"),
        ("INFO", "frame 6: 20×10 px, so all begins anew"),
        ("DEBUG", "frame 6: born [], ended [3]"),
    ]
    assert {one.name for one in caplog.records} == {"mlbs_actors"}


def test_a_stream_writes_its_births_into_the_log(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.DEBUG, "mlbs_actors")
    results = run(pictures_of("pan", 8))
    born = [f"frame {one.frame_index}: born {list(one.born)}, ended []" for one in results if one.born]
    assert [one.getMessage() for one in caplog.records] == born


def test_only_warnings_are_seen_where_a_program_sets_up_no_logging() -> None:
    code = "from mlbs_actors.result_log import LOGGER as log; log.info('quiet'); log.warning('seen')"
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert (said.stdout, said.stderr) == ("", "seen\n")
