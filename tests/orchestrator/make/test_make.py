"""What is made of a finished run: only what is chosen is changed, sound is kept, nothing is lost silently."""

from __future__ import annotations

import csv
import json
import os
import shutil
import signal
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import av
import cv2
import numpy as np
import pytest
from av.video.frame import VideoFrame
from made_run import FRAMES, two_objects, write_pictures, write_run_over
from PIL import Image, ImageSequence
from record_fakes import HEIGHT, WIDTH, segmentation
from sounding_video import FRAME_RATE, RATE, heard, write_sounding_video

from mlbs_actors.messages import Array, ObjectState, Segmentation
from mlbs_actors.record.recorded_stream import edits_of
from orchestrator.make.__main__ import main
from orchestrator.make.choice import parse_only
from orchestrator.make.effects import COVERS, highlighted
from orchestrator.make.footage import Footage, Shot
from orchestrator.make.ground import Ground, ground_of
from orchestrator.make.kinds import KINDS
from orchestrator.make.missed import covered_shots
from orchestrator.make.moments import ALL
from orchestrator.make.watching import Watch
from orchestrator.run.job import Job
from orchestrator.run.makings import make_of_all
from orchestrator.run.run_folder import RunFolder
from orchestrator.run.stream_state import StreamState

# pycocotools decodes through an __array__ method that NumPy 2 finds outdated.
pytestmark = pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")


@dataclass(frozen=True, slots=True)
class Spec:
    """What is looked at of a stream's specification."""

    name: str
    live: bool


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("finished")
    return write_run_over(folder / "run", {"yard": write_pictures(folder / "yard")})


@pytest.fixture
def run(finished: Path, tmp_path: Path) -> Path:
    """A copy, in which a test may write."""
    return Path(shutil.copytree(finished, tmp_path / "run"))


@pytest.fixture
def sounding(tmp_path: Path) -> Path:
    write_sounding_video(tmp_path / "a.mp4", "aac", size=(WIDTH, HEIGHT))
    return write_run_over(tmp_path / "run", {"a": tmp_path / "a.mp4"})


def made(run: Path, *words: str) -> Path:
    assert main([words[0], str(run), *words[1:]]) == 0
    return run / "yard" / "made"


def picture(path: Path) -> Array:
    with Image.open(path) as image:
        return np.asarray(image)


def frames_of(path: Path) -> list[VideoFrame]:
    with av.open(str(path)) as container:
        return list(container.decode(video=0))


def times_of(path: Path) -> list[float]:
    return [round(frame.time or 0.0, 2) for frame in frames_of(path)]


def source_of(run: Path) -> str:
    return str(json.loads((run / "run.json").read_text())["sources"]["yard"])


def shots(run: Path, only: str | None) -> list[Shot]:
    stream = run / "yard"
    footage = Footage.of(stream, source_of(run), parse_only(only), ALL, edits_of(stream), private=False)
    return list(footage.shots("test"))


def test_all_is_grey_but_what_is_chosen(run: Path) -> None:
    for shot in shots(run, "3")[::10]:
        labels = shot.whole.labels()
        changed = (highlighted(shot) != shot.picture).any(axis=2)
        assert not changed[labels == 3].any()
        assert changed[labels != 3].mean() > 0.99


@pytest.mark.parametrize("kind", sorted(COVERS))
def test_what_is_covered_changes_and_nothing_that_belongs_to_others(run: Path, kind: str) -> None:
    for shot in shots(run, "3")[::10]:
        labels = shot.whole.labels()
        changed = (COVERS[kind](shot, labels == 3) != shot.picture).any(axis=2)
        assert changed[labels == 3].mean() > 0.95
        assert not changed[labels == 5].any()
        near = cv2.dilate((labels == 3).view(np.uint8), np.ones((9, 9), np.uint8)).view(np.bool_)
        assert not changed[~near].any()


def test_pixels_are_covered_in_blocks_of_one_colour(run: Path) -> None:
    shot = shots(run, "3")[8]  # whose object begins with a block
    made_of = COVERS["pixelate"](shot, shot.masks()[0])
    mean = shot.picture[8:12, 8:12].reshape(-1, 3).mean(axis=0)
    np.testing.assert_allclose(made_of[8:12, 8:12].reshape(-1, 3), np.broadcast_to(mean, (16, 3)), atol=0.6)


def test_the_opacity_of_cut_out_pictures_is_the_mask_and_their_colours_are_the_source(
    run: Path,
) -> None:
    folder = made(run, "cutout", "--format", "png", "--only", "5") / "cutout-5"
    assert [path.name for path in sorted(folder.iterdir())] == [f"img{n:03d}.png" for n in range(FRAMES)]
    for index in range(0, FRAMES, 7):
        cut = picture(folder / f"img{index:03d}.png")
        labels = two_objects(index).labels
        np.testing.assert_array_equal(cut[..., 3], np.where(labels == 5, 255, 0))
        assert not cut[labels != 5].any()
        source = picture(Path(source_of(run)) / f"img{index:03d}.png")
        np.testing.assert_array_equal(cut[labels == 5][:, :3], source[labels == 5])


def alpha_of(path: Path) -> Array:
    """Opacity of all frames, in [0, 1], by a decoder that knows of it."""
    decoder = av.CodecContext.create("libvpx-vp9", "r") if path.suffix == ".webm" else None
    with av.open(str(path)) as container:
        if decoder is None:
            frames = list(container.decode(video=0))
        else:
            packets = [packet for packet in container.demux(video=0) if packet.size]
            frames = [frame for packet in [*packets, None] for frame in decoder.decode(packet)]
        planes = []
        for frame in frames:
            assert isinstance(frame, VideoFrame)
            assert "yuva" in frame.format.name
            plane, bits = frame.planes[3], frame.format.components[3].bits
            values: Array = np.frombuffer(bytes(plane), np.uint8 if bits == 8 else np.uint16)
            rows = values.reshape(plane.height, -1)[:, : plane.width]
            planes.append(rows / ((1 << bits) - 1))
    return np.stack(planes)


@pytest.mark.parametrize("suffix", [".mov", ".webm"])
def test_the_opacity_of_a_cut_out_video_is_the_mask(run: Path, suffix: str) -> None:
    alpha = alpha_of(made(run, "cutout", "--format", suffix) / f"cutout{suffix}")
    assert alpha.shape == (FRAMES, HEIGHT, WIDTH)
    truth = np.stack([two_objects(index).labels > 0 for index in range(FRAMES)])
    np.testing.assert_array_equal(alpha > 0.5, truth)
    assert np.abs(alpha - truth).max() < (0.02 if suffix == ".mov" else 0.5)


def write_ground(path: Path, levels: Iterable[int], rate: int) -> Path:
    """A wide video of grey frames, which are black at both sides."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=rate)
        assert isinstance(stream, av.VideoStream)
        stream.width, stream.height, stream.pix_fmt = 320, 64, "yuv420p"
        for level in levels:
            frame = np.zeros((64, 320, 3), np.uint8)
            frame[:, 80:240] = level
            container.mux(stream.encode(VideoFrame.from_ndarray(frame, format="bgr24")))
        container.mux(stream.encode(None))
    return path


def test_a_cut_out_lies_over_another_video_that_keeps_its_speed_covers_all_and_begins_again(
    sounding: Path,
) -> None:
    levels = [60, 100, 140, 180, 220]
    ground = write_ground(sounding.parent / "beach.mp4", levels, 10)
    made(sounding, "cutout", "--only", "3", "--over", str(ground))
    path = sounding / "a/made/cutout-3-over.mp4"
    frames, source = frames_of(path), frames_of(sounding.parent / "a.mp4")
    assert len(frames) == 60
    assert (frames[0].width, frames[0].height) == (WIDTH, HEIGHT)
    for index in range(0, 60, 7):
        shown, labels = frames[index].to_ndarray(format="gray"), two_objects(index).labels
        level = levels[int(index / float(FRAME_RATE) * 10 + 1e-3) % 5]
        near = cv2.dilate((labels == 3).view(np.uint8), np.ones((9, 9), np.uint8)).view(np.bool_)
        far = shown[~near].astype(int)
        assert abs(np.median(far) - level) < 12
        assert far.max() - far.min() < 40  # nothing of its black sides is seen
        inside = cv2.erode((labels == 3).view(np.uint8), np.ones((5, 5), np.uint8)).view(np.bool_)
        there = source[index].to_ndarray(format="gray")
        assert abs(float(np.mean(shown[inside])) - float(np.mean(there[inside]))) < 20
    begin, samples = heard(path)
    assert begin == 0
    np.testing.assert_array_equal(samples, heard(sounding.parent / "a.mp4")[1][: len(samples)])


def test_a_ground_keeps_its_proportions_and_its_middle(tmp_path: Path) -> None:
    picture_of = np.zeros((40, 120, 3), np.uint8)
    picture_of[:, :40, 0], picture_of[:, 40:80, 1], picture_of[:, 80:, 2] = 255, 255, 255
    (tmp_path / "still").mkdir()
    cv2.imwrite(str(tmp_path / "still/beach.png"), picture_of)
    ground = Ground(ground_of(str(tmp_path / "still")))
    for seconds in (0.0, 100.0):
        np.testing.assert_array_equal(ground.at(seconds, (80, 80), 1.0), np.full((80, 80, 3), (0, 255, 0)))
    wide = ground.at(100.0, (80, 80), 2.0)  # pixels twice as wide: half a third more on both sides
    assert wide[40, [5, 40, 75]].tolist() == [[255, 0, 0], [0, 255, 0], [0, 0, 255]]
    upright = ground.at(100.0, (80, 20), 1.0)
    assert (upright == (0, 255, 0)).all()


def test_each_object_is_a_video_of_its_own_from_its_first_frame_to_its_last(tmp_path: Path) -> None:
    source = write_pictures(tmp_path / "yard", 20)
    run = write_run_over(
        tmp_path / "run",
        {"yard": source},
        lambda index: segmentation(index, 3, 5) if 5 <= index < 12 else segmentation(index, 3),
    )
    folder = made(run, "cutout", "--each") / "cutout"
    assert {path.name: len(frames_of(path)) for path in folder.iterdir()} == {"3.mov": 20, "5.mov": 7}
    made(run, "cutout", "--each", "--format", "png", "--replace")
    assert {path.name: len(list(path.iterdir())) for path in folder.iterdir()} == {"3": 20, "5": 7}


@pytest.mark.parametrize("kind", ["overlay", "blur", "pixelate", "highlight"])
def test_a_video_has_the_frames_times_and_size_of_its_source_and_its_sound(sounding: Path, kind: str) -> None:
    made(sounding, kind)
    path = sounding / "a/made" / f"{kind}.mp4"
    frames = frames_of(path)
    assert [round((frame.time or 0) * float(FRAME_RATE)) for frame in frames] == list(range(60))
    assert (frames[0].width, frames[0].height) == (WIDTH, HEIGHT)
    (begin, samples), (_, expected) = heard(path), heard(sounding.parent / "a.mp4")
    assert begin == 0
    np.testing.assert_array_equal(samples, expected[: len(samples)])
    assert len(samples) / RATE == pytest.approx(2.0, abs=0.05)


def test_sound_is_cut_with_the_pictures(sounding: Path) -> None:
    made(sounding, "blur", "--from", "0.5", "--to", "1.5")
    path = sounding / "a/made/blur.mp4"
    assert len(frames_of(path)) == 30
    (begin, samples), (_, expected) = heard(path), heard(sounding.parent / "a.mp4")
    assert begin == pytest.approx(0.0, abs=0.03)
    assert len(samples) / RATE == pytest.approx(1.0, abs=0.06)
    # The tone rises, so where it is from can be heard; the first packets decode without those before.
    found = samples[9600:14400]
    shifts = [np.abs(found - expected[at : at + 4800]).mean() for at in range(31200, 36000, 8)]
    assert (31200 + 8 * int(np.argmin(shifts))) / RATE - 0.2 == pytest.approx(0.5005, abs=0.03)


def test_sound_that_a_file_cannot_hold_is_told_and_left_out(
    sounding: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    made(sounding, "cutout", "--format", "webm")
    assert "cutout.webm has no sound: aac cannot be copied" in capsys.readouterr().err


def test_the_sound_of_a_private_run_is_left_out_and_its_pictures_hide_what_moves(sounding: Path) -> None:
    made(sounding, "highlight", str(sounding / "plain.mp4"))
    described = json.loads((sounding / "run.json").read_text())
    (sounding / "run.json").write_text(json.dumps(described | {"private": True}))
    # What is dropped by hand is hidden all the same.
    (sounding / "a/edits.csv").write_text("drop,5\n")
    made(sounding, "overlay", "--no-labels")
    with av.open(str(sounding / "a/made/overlay-no-labels.mp4")) as container:
        assert not container.streams.audio


def test_what_is_made_with_corrections_says_so(sounding: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (sounding / "a/edits.csv").write_text("drop,5\n")
    made(sounding, "overlay")
    assert f"overlay.mp4: with 1 correction of {sounding / 'a/edits.csv'}." in capsys.readouterr().err


def test_a_removed_object_shows_the_ground_behind_it_and_the_others_stay(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "yard").mkdir()
    grey = np.random.default_rng(3).integers(80, 170, (HEIGHT // 4, WIDTH // 4), np.uint8)
    grey = np.asarray(cv2.resize(grey, (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC))
    ground = np.dstack([grey] * 3)
    for index in range(24):
        picture_of = ground.copy()
        labels = segmentation(index, 3, 5).labels
        picture_of[labels == 3], picture_of[labels == 5] = (0, 0, 255), (255, 255, 255)
        cv2.imwrite(str(tmp_path / f"yard/img{index:03d}.png"), picture_of)
    run = write_run_over(
        tmp_path / "run", {"yard": tmp_path / "yard"}, lambda index: segmentation(index, 3, 5)
    )
    folder = made(run, "remove", "--only", "3")
    assert "What the masks miss of an object may still be seen." in capsys.readouterr().err
    assert sorted(path.name for path in folder.iterdir()) == ["remove-3-made-up.mp4", "remove-3.mp4"]
    frames = frames_of(folder / "remove-3.mp4")
    assert len(frames) == len(frames_of(folder / "remove-3-made-up.mp4")) == 24
    for index in (4, 12, 20):
        shown, labels = frames[index].to_ndarray(format="bgr24"), segmentation(index, 3, 5).labels
        assert np.abs(shown[labels == 3].astype(int) - ground[labels == 3]).mean() < 15
        assert shown[labels == 5].mean() > 200


def test_parts_in_which_something_moves_are_joined_with_their_times_and_sound(sounding: Path) -> None:
    shutil.rmtree(sounding)
    spells = {*range(10, 20), *range(140, 150)}

    def found(index: int) -> Segmentation:
        made_of = segmentation(index, 3)
        state: ObjectState = "moving" if index in spells else "resting"
        return replace(made_of, layers=tuple(replace(one, state=state) for one in made_of.layers))

    write_sounding_video(sounding.parent / "a.mp4", "aac", frames=200, size=(WIDTH, HEIGHT))
    run = write_run_over(sounding, {"a": sounding.parent / "a.mp4"}, found)
    made(run, "clips")
    path = run / "a/made/clips.mp4"
    rows = list(csv.DictReader((run / "a/made/clips.csv").read_text().splitlines()))
    assert [(row["first_frame"], row["last_frame"]) for row in rows] == [("0", "33"), ("126", "163")]
    assert [row["begins"] for row in rows] == ["0:00:00.000", "0:00:04.204"]
    assert [row["objects"] for row in rows] == ["3", "3"]
    assert float(rows[1]["at_s"]) == pytest.approx(34 / float(FRAME_RATE), abs=0.002)
    frames = frames_of(path)
    assert len(frames) == 34 + 38
    # Frames grow brighter, so what they show can be told.
    assert frames[34].to_ndarray(format="gray").mean() == pytest.approx(4 * 126 % 256, abs=6)
    begin, samples = heard(path)
    assert begin == pytest.approx(0, abs=0.03)
    assert len(samples) / RATE == pytest.approx(72 / float(FRAME_RATE), abs=0.1)
    made(run, "clips", "--apart")
    folder = run / "a/made/clips"
    assert sorted(path.name for path in folder.iterdir()) == ["001.mp4", "002.mp4", "clips.csv"]
    assert len(frames_of(folder / "002.mp4")) == 38


def test_only_what_moves_can_be_chosen_frame_by_frame(run: Path) -> None:
    present = [{one.layer for one in shot.frame.objects} for shot in shots(run, "moving")]
    assert present == [{3, 5} if 10 <= index < 30 else {3} for index in range(FRAMES)]


def test_the_largest_object_is_that_of_all_frames_together(tmp_path: Path) -> None:
    def found(index: int) -> Segmentation:
        made_of = segmentation(index, 3, 5)
        three, five = made_of.layers
        return replace(made_of, layers=(replace(three, area=400 if index == 0 else 70), five))

    run = write_run_over(tmp_path / "run", {"yard": write_pictures(tmp_path / "yard")}, found)
    assert {one.layer for shot in shots(run, "largest") for one in shot.frame.objects} == {5}


def test_objects_below_a_score_are_left_as_they_are(run: Path) -> None:
    folder = made(run, "cutout", "--format", "png", "--least-score", "0.5") / "cutout"
    cut = picture(folder / "img000.png")
    np.testing.assert_array_equal(cut[..., 3] > 0, two_objects(0).labels == 3)


def test_an_object_is_covered_before_it_is_found_and_while_it_is_lost(tmp_path: Path) -> None:
    found_in = {*range(15, 22), *range(25, 30)}
    source = write_pictures(tmp_path / "yard", 30)
    run = write_run_over(
        tmp_path / "run",
        {"yard": source},
        lambda index: segmentation(index, *((3, 5) if index in found_in else (3,))),
    )
    stream = run / "yard"
    footage = Footage.of(stream, str(source), parse_only("5"), ALL, edits_of(stream), private=False)
    for shot, covered in covered_shots(footage, "test"):
        index, labels = shot.frame.index, segmentation(shot.frame.index, 3, 5).labels
        assert covered.any() == (index >= 3)  # twelve frames before the first mask
        assert not covered[labels == 3].any()
        assert covered.mean() < 0.5
        if index in found_in:
            assert covered[labels == 5].all()
        elif index >= 13:
            assert covered[labels == 5].mean() > 0.6


def test_what_a_mask_misses_is_covered_if_masks_around_it_have_it(tmp_path: Path) -> None:
    def found(index: int) -> Segmentation:
        made_of = segmentation(0, 3)
        labels = made_of.labels.copy()
        if index == 20:
            labels[13:] = 0
        return replace(made_of, frame_index=index, labels=labels)

    source = write_pictures(tmp_path / "yard")
    run = write_run_over(tmp_path / "run", {"yard": source}, found)
    stream = run / "yard"
    footage = Footage.of(stream, str(source), parse_only(None), ALL, edits_of(stream), private=False)
    whole = segmentation(0, 3).labels == 3
    for shot, covered in covered_shots(footage, "test"):
        if shot.frame.index == 20:
            assert not shot.masks()[0][13:].any()
        assert covered[whole].all()


def test_progress_is_told_every_ten_seconds_with_the_time_left() -> None:
    said: list[str] = []
    times = iter(range(0, 1000, 4))
    watch = Watch(said.append, lambda: next(times))
    for doing in ("look", "blur.mp4"):
        assert list(watch.told(range(5), doing, 5)) == list(range(5))
    assert said == [
        "look: 1 of 5 frames, 0:00:32 left",
        "look: 4 of 5 frames, 0:00:05 left",
        "blur.mp4: 1 of 5 frames, 0:00:32 left",
        "blur.mp4: 4 of 5 frames, 0:00:05 left",
    ]
    # A pass may begin long after the last line, as its first frame took so long.
    times = iter([0, 0, 11, 12])
    list(Watch(said.append, lambda: next(times)).told(range(2), "look", 2))
    assert said[-1] == "look: 0 of 2 frames"


def test_clips_are_shown_as_they_are_unless_objects_are_asked_for(run: Path) -> None:
    folder = made(run, "clips")
    for words in (["--ids"], ["--labels", "--no-ids"]):
        made(run, "clips", *words)
    names = ["clips", "clips-labels", "clips-labels-no-ids"]
    assert sorted(path.stem for path in folder.glob("*.mp4")) == names
    plain, with_ids, without = (frames_of(folder / f"{name}.mp4")[20].to_ndarray() for name in names)
    assert (plain != without).any()
    assert (with_ids != without).any()


def test_what_is_drawn_otherwise_has_a_name_of_its_own_and_the_place_may_follow_options(
    run: Path, tmp_path: Path
) -> None:
    for words in ([], ["--no-ids"], ["--no-labels"]):
        made(run, "sheet", *words)
    assert sorted(path.name for path in (run / "yard/made").iterdir()) == [
        "sheet-no-ids.jpg",
        "sheet-no-labels.jpg",
        "sheet.jpg",
    ]
    made(run, "sheet", "--stream", "yard", "--only", "3", str(tmp_path / "out"))
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["yard-sheet-3.jpg"]
    made(run, "sheet", "--no-ids", str(tmp_path / "x.png"))
    assert (tmp_path / "x.png").exists()


@pytest.mark.parametrize(
    ("words", "frames"), [(("10f", "20f"), 10), (("1.0", "2.0"), None), (("0:01", "35f"), None)]
)
def test_the_part_is_given_in_seconds_or_frames(
    run: Path, words: tuple[str, str], frames: int | None
) -> None:
    made(run, "blur", "--from", words[0], "--to", words[1])
    times = times_of(run / "yard/made/blur.mp4")
    rate = 25  # of a folder of pictures
    expected = {"2.0": rate, "35f": 35 - rate}.get(words[1], frames)
    assert len(times) == min(expected or 0, FRAMES - (rate if words[1] == "2.0" else 0))
    assert times[0] == 0


def test_a_gif_is_small_and_plays_as_long_as_its_part(run: Path) -> None:
    with Image.open(made(run, "gif", "--from", "10f") / "gif.gif") as image:
        durations = [one.info["duration"] for one in ImageSequence.Iterator(image)]
        assert image.size == (WIDTH, HEIGHT)
        assert image.info["loop"] == 0  # for ever
    assert len(durations) == 15  # 12.5 a second
    assert sum(durations) / 1000 == pytest.approx(30 / 25, abs=0.05)


def test_a_sheet_has_twenty_frames_in_rows_of_four(run: Path) -> None:
    sheet = picture(made(run, "sheet") / "sheet.jpg")
    assert sheet.shape == (5 * (HEIGHT + 6) + 6, 4 * (WIDTH + 6) + 6, 3)
    plain = picture(made(run, "sheet", "--no-labels", "--format", "png") / "sheet-no-labels.png")
    made(run, "sheet", str(run / "labelled.png"))
    assert (plain != picture(run / "labelled.png")).any()


def test_what_is_there_is_replaced_only_if_that_is_asked_for(
    run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = made(run, "blur") / "blur.mp4"
    before = path.read_bytes()
    assert main(["blur", str(run), "--only", "3"]) == 0  # a name of its own
    assert main(["blur", str(run)]) == 2
    assert "is there already" in capsys.readouterr().err
    assert path.read_bytes() == before
    assert main(["blur", str(run), "--replace", "--from", "20f"]) == 0
    assert path.read_bytes() != before
    assert sorted(one.name for one in path.parent.iterdir()) == ["blur-3.mp4", "blur.mp4"]


@pytest.mark.parametrize(
    "words",
    [
        ("cutout", "{0}.png"),
        ("cutout", "{0}.mov", "--each"),
        ("clips", "{0}.mp4", "--apart"),
    ],
)
def test_a_folder_that_something_else_has_made_is_never_replaced(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], words: tuple[str, ...]
) -> None:
    holiday = tmp_path / "holiday"
    holiday.mkdir()
    (holiday / "img000.png").write_bytes(b"a picture")
    before = sorted(tmp_path.rglob("*"))
    for folder in (holiday, run, run / "yard", tmp_path):
        place = words[1].format(folder)
        for more in ((), ("--replace",)):
            assert main([words[0], str(run), place, *words[2:], *more]) == 2
            told = capsys.readouterr().err
            assert f"is written to the folder {folder} here" in told
            assert "--replace" not in told
    assert sorted(tmp_path.rglob("*")) == before


def test_a_folder_that_was_made_before_is_replaced_wherever_it_is(run: Path, tmp_path: Path) -> None:
    for place in ([], [str(tmp_path / "cut.png")]):
        command = ["cutout", str(run), *place, "--format", "png"]
        assert main(command) == 0
        folder = tmp_path / "cut" if place else run / "yard/made/cutout"
        assert len(list(folder.glob("*.png"))) == FRAMES
        assert main(command) == 2
        assert main([*command, "--replace", "--from", "30f"]) == 0
        assert len(list(folder.glob("*.png"))) == FRAMES - 30
        (folder / "run").mkdir()
    # Somebody has put a run into it since.
    within = shutil.copytree(run, tmp_path / "cut/run", dirs_exist_ok=True)
    assert main(["cutout", str(within), str(tmp_path / "cut.png"), "--replace"]) == 2
    assert (within / "run.json").exists()


def test_a_file_and_a_folder_do_not_replace_each_other(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "notes").write_text("of a user")
    assert main(["cutout", str(run), str(tmp_path / "notes.png"), "--replace"]) == 2
    assert (tmp_path / "notes").read_text() == "of a user"
    (tmp_path / "out/yard-blur.mp4").mkdir(parents=True)
    assert main(["blur", str(run), str(tmp_path / "out"), "--replace"]) == 2
    assert "yard-blur.mp4 is a folder" in capsys.readouterr().err
    assert (tmp_path / "out/yard-blur.mp4").is_dir()


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("cutout,blur", "--each"), "goes with cutout only"),
        (("sheet,melt",), "no kind 'melt'"),
        (("sheet,blur", "--format", "png"), "blur is written as .mp4 or .mkv, not as .png"),
        (("sheet,gif", "{out}/a.jpg"), "gif is written as .gif, not as .jpg"),
        (("blur,overlay", "{out}/a.mp4", "--replace"), "blur and overlay cannot both be written to"),
        (("overlay,clips", "{out}/a.mp4"), "overlay and clips cannot both be written to"),
        (("blur,highlight", "{out}"), "yard-highlight.mp4 is there already"),
    ],
)
def test_of_several_kinds_none_is_made_unless_all_can_be_tried(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], words: tuple[str, ...], told: str
) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "yard-highlight.mp4").write_bytes(b"made before")
    assert main([words[0], str(run), *(word.format(out=out) for word in words[1:])]) == 2
    assert told in capsys.readouterr().err
    assert [path.read_bytes() for path in out.iterdir()] == [b"made before"]
    assert not (run / "yard/made").exists()


def test_a_kind_that_turns_out_impossible_does_not_prevent_the_others(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def found(index: int) -> Segmentation:
        made_of = segmentation(index, 3)
        return replace(made_of, layers=tuple(replace(one, state="resting") for one in made_of.layers))

    run = write_run_over(tmp_path / "run", {"yard": write_pictures(tmp_path / "yard")}, found)
    assert main(["clips,sheet,sheet", str(run)]) == 2
    said = capsys.readouterr()
    assert said.err == "Nothing that was asked for moves in 'yard'.\n"
    assert said.out == f"{run}/yard/made/sheet.jpg\n"


def test_streams_that_cannot_be_read_again_are_told_and_the_others_made(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    sources: dict[str, Path | str] = {name: write_pictures(tmp_path / name) for name in ("yard", "gone")}
    run = write_run_over(tmp_path / "run", sources)
    shutil.rmtree(tmp_path / "gone")
    assert main(["blur", str(run), str(tmp_path / "out")]) == 0
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["yard-blur.mp4"]
    assert "the source of 'gone', cannot be read again" in capsys.readouterr().err
    assert main(["blur", str(run), "--stream", "gone"]) == 2
    assert not list((run / "gone/made").iterdir())  # nothing half made


def soon_at_rest(index: int) -> Segmentation:
    """Object 5 moves in the first 20 frames."""
    made_of = segmentation(index, 5)
    state: ObjectState = "moving" if index < 20 else "resting"
    return replace(made_of, layers=tuple(replace(one, state=state) for one in made_of.layers))


def damage(run: Path, frames: Iterable[int]) -> None:
    """Make pictures of the source unreadable since the run."""
    for index in frames:
        (Path(source_of(run)) / f"img{index:03d}.png").write_bytes(b"no picture")


@pytest.mark.parametrize(
    "words", [("clips", "--only", "5"), ("clips", "--only", "5", "--apart"), ("gif",), ("blur",)]
)
def test_frames_that_cannot_be_read_again_are_told_of_every_kind(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], words: tuple[str, ...]
) -> None:
    # Neither the clips nor the animation reach the end of the video.
    run = write_run_over(tmp_path / "run", {"yard": write_pictures(tmp_path / "yard", 520)}, soon_at_rest)
    damage(run, range(3, 7))
    made(run, *words)
    assert "yard: 4 of 520 frames could not be read again and are left out." in capsys.readouterr().err


@pytest.mark.parametrize("apart", [(), ("--apart",)])
def test_clips_of_which_no_part_can_be_read_again_are_not_made(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], apart: tuple[str, ...]
) -> None:
    run = write_run_over(tmp_path / "run", {"yard": write_pictures(tmp_path / "yard")}, soon_at_rest)
    damage(run, range(35))
    assert main(["clips", str(run), *apart]) == 2
    assert "in which something moves in 'yard' can be read again" in capsys.readouterr().err
    assert not list((run / "yard/made").iterdir())


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["blur", "--only", "9"], "There is no object 9 in that part of the stream; there are 3, 5."),
        (["blur", "--only", "big"], "--only takes ids"),
        (["blur", "--from", "soon"], "is no moment of a video"),
        (["blur", "--from", "100"], "whose last frame is 39 at 0:00:01.560"),
        (["blur", "--least-score", "0.95"], "There is no such object"),
        (["blur", "--format", "gif"], "blur is written as .mp4 or .mkv"),
        (["blur", "--each"], "goes with cutout only"),
        (["blur", "--stream", "door"], "There is no stream 'door' in this run; there are yard."),
        (["melt"], "There is no kind 'melt'; there are overlay, remove"),
        (["sheet", "--no-labels", "--ids"], "leave one of them out"),
        (["blur", "--over", "a.mp4"], "--over goes with cutout only"),
        (["cutout", "--each", "--over", "a.mp4"], "--over goes with cutout only, without --each"),
        (["cutout", "--over", "/nowhere/beach.mp4"], "There is no file or folder /nowhere/beach.mp4"),
        (["cutout", "--over", __file__], "Cannot open"),
        (["cutout", "--over", "rtsp://bob:hunter2@cam/x"], "is a camera; record it first"),
    ],
)
def test_what_is_wrong_is_told_with_what_to_do(
    run: Path, capsys: pytest.CaptureFixture[str], words: list[str], told: str
) -> None:
    assert main([words[0], str(run), *words[1:]]) == 2
    said = capsys.readouterr().err
    assert told in said
    assert "hunter2" not in said


def test_a_folder_without_a_run_and_a_camera_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["blur", str(tmp_path)]) == 2
    assert "holds no run" in capsys.readouterr().err
    run = write_run_over(tmp_path / "run", {"gate": "rtsp://bob:hunter2@cam/x"})
    assert main(["blur", str(run), "--stream", "gate"]) == 2
    told = capsys.readouterr().err
    assert "is a camera" in told
    assert "hunter2" not in told


def test_a_run_makes_what_is_asked_of_each_file_that_has_ended(tmp_path: Path) -> None:
    sources: dict[str, Path | str] = {
        name: write_pictures(tmp_path / name) for name in ("yard", "gone", "old")
    }
    run = write_run_over(tmp_path / "run", sources | {"gate": "rtsp://cam/x"})
    shutil.rmtree(tmp_path / "gone")
    (run / "old/made").mkdir()
    (run / "old/made/sheet.jpg").write_bytes(b"of the run before")
    said: list[str] = []
    states = [StreamState(name, "done", committed=FRAMES) for name in sources]
    specs = [Spec(name, live=name == "gate") for name in (*sources, "gate")]
    job = cast(Job, SimpleNamespace(specs=specs))
    make_of_all(("blur", "sheet"), job, {"yard", "gone"}, states, RunFolder(run), said.append)
    assert sorted(str(path.relative_to(run)) for path in run.glob("*/made/*")) == [
        "old/made/blur.mp4",
        "old/made/sheet.jpg",
        "yard/made/blur.mp4",
        "yard/made/sheet.jpg",
    ]
    assert (run / "old/made/sheet.jpg").read_bytes() == b"of the run before"
    assert sum(sentence.startswith("There is no blur of gone.") for sentence in said) == 1


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_what_a_run_makes_but_not_the_run(
    run: Path, monkeypatch: pytest.MonkeyPatch, signals_exit: None, number: signal.Signals
) -> None:
    def write_until_signalled(*given: object) -> list[str]:
        os.kill(os.getpid(), number)
        raise AssertionError("the signal did not come")

    monkeypatch.setattr("orchestrator.make.making.write", write_until_signalled)
    said: list[str] = []
    job = cast(Job, SimpleNamespace(specs=[Spec("yard", live=False)]))
    states = [StreamState("yard", "done", committed=FRAMES)]
    make_of_all(("blur", "sheet"), job, {"yard"}, states, RunFolder(run), said.append)
    assert said == [
        "Making blur of yard.",
        "To make blur of yard, give the same command with --resume.",
    ]
    assert not list((run / "yard/made").iterdir())


def test_the_help_says_that_blurring_is_no_promise_of_privacy(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["--help"])
    told = capsys.readouterr().out
    assert "no promise of privacy" in told
    assert all(f"  {kind} " in told for kind in KINDS)
