"""A private record: no picture that it writes or serves shows what moves."""

from __future__ import annotations

import io
import json
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from mlbs_actors.actors.stream.protocol import Snapshot
from mlbs_actors.messages import Array, LayerAppearance, LayerSummary, Region, Segmentation
from mlbs_actors.source import SourceFrame
from orchestrator.events.zones import EventRules, Zone
from orchestrator.pictures.content import Drawing
from orchestrator.pictures.privacy import FRAMES_AFTER
from orchestrator.run.whole_overlays import make_whole
from orchestrator.sinks.live_picture import LivePicture
from orchestrator.sinks.private_record import PrivateRecord
from orchestrator.sinks.record import StreamRecord, ends_group
from orchestrator.working_size import FullSizeRecord

# pycocotools decodes through an __array__ method that NumPy 2 finds outdated.
pytestmark = pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")

HEIGHT, WIDTH, FRAMES = 120, 160, 40
SIDE = 40
EVERYTHING = frozenset({"masks", "parquet", "overlay", "background", "cutouts"})
DRAWING = Drawing(private=True)
RULES = EventRules((Zone(name="all", polygon=((0, 0), (1, 0), (1, 1), (0, 1)), fixed_to="scene"),))

#: What must not be seen: stripes of red and blue, as nothing else in the pictures has them.
STRIPES = np.zeros((SIDE, SIDE, 3), np.uint8)
STRIPES[:, :, 2] = np.where(np.arange(SIDE) // 4 % 2, 255, 0)
STRIPES[:, :, 0] = 255 - STRIPES[:, :, 2]


def place(index: int) -> Region:
    return Region(10 + 2 * index, 50, SIDE, SIDE)


def picture(index: int, scale: int = 1) -> Array:
    image = np.full((HEIGHT, WIDTH, 3), 120, np.uint8)
    image[place(index).slices] = STRIPES
    return np.kron(image, np.ones((scale, scale, 1), np.uint8))


def result(index: int, *, labelled: bool = True) -> Segmentation:
    """The engine's outline, which lacks the last column on either side."""
    labels = np.zeros((HEIGHT, WIDTH), np.uint16)
    region = place(index)
    seen = Region(region.x + 1, region.y, SIDE - 2, SIDE)
    labels[seen.slices] = 4 if labelled else 0
    layer = LayerSummary(
        layer=4,
        kind="object",
        region=seen,
        area=SIDE * (SIDE - 2),
        centroid=(seen.x + SIDE / 2, seen.y + SIDE / 2),
        velocity=(2.0, 0.0),
        confidence=1.0,
        score=1.0,
    )
    return Segmentation(
        frame_index=index,
        labels=labels,
        normaliser=np.zeros_like(labels, np.uint8),
        fallback=np.zeros_like(labels, np.int8),
        layers=(layer,) if labelled else (),
        camera_motion=(0.0, 0.0),
        latency_frames=1,
        stage_ms={"cut": 3.0},
        camera=np.eye(3),
    )


def frame(index: int) -> SourceFrame:
    return SourceFrame(index, picture(index), index / 10, f"{index:05d}")


def background() -> LayerAppearance:
    nothing = np.zeros((HEIGHT, WIDTH), bool)
    return LayerAppearance(0, 7, Region(0, 0, WIDTH, HEIGHT), np.zeros((HEIGHT, WIDTH, 3), np.uint8), nothing)


def shown(path: Path) -> Iterator[Array]:
    """The pictures in a file, (h, w, 3)."""
    if path.suffix == ".mp4":
        with av.open(str(path)) as container:
            for one in container.decode(video=0):
                yield one.to_ndarray(format="bgr24")
    elif path.suffix == ".npz":
        yield np.repeat(np.load(io.BytesIO(path.read_bytes()))["gray"][:, :, None], 3, axis=2)
    else:
        found = cv2.imread(str(path))
        assert found is not None
        yield np.asarray(found)


def pictures_of(folder: Path) -> list[Path]:
    """All files that hold pictures but the label maps."""
    kinds = {".mp4", ".jpg", ".png", ".npz"}
    paths = (path for path in folder.rglob("*") if path.suffix in kinds and "snapshots" not in path.parts)
    return sorted(path for path in paths if path.parent.name != "masks")


def has_stripes(image: Array) -> bool:
    """Whether red alternates with blue anywhere, or in a grey picture dark with less dark."""
    is_grey = (image == image[:, :, :1]).all()
    for stripe in (4, 8, 12, 16):  # px; some pictures are enlarged
        if image.shape[1] <= 2 * stripe:
            continue
        blue, green, red = np.moveaxis(image[:, stripe:].astype(int) - image[:, :-stripe], 2, 0)
        turns = (blue * red < 0) & (np.abs(blue - red) > 140)
        if is_grey:
            here, there = green[:, :-stripe], green[:, stripe:]
            turns = (here * there < 0) & (np.minimum(np.abs(here), np.abs(there)) > 30)
        if turns.mean() > 0.02:
            return True
    return False


def fill(record: PrivateRecord | StreamRecord, born: int = 0) -> None:
    for index in range(FRAMES):
        of_group = background() if ends_group(index) else None
        record.write(result(index, labelled=index >= born), frame(index), of_group)
    record.close(whole=True)


def opened(folder: Path, live: Path, drawing: Drawing = DRAWING) -> StreamRecord:
    picture = LivePicture(live, drawing=drawing)
    return StreamRecord(folder, "yard", EVERYTHING, picture, rules=RULES, drawing=drawing)


def test_nothing_that_a_record_writes_shows_what_moves(tmp_path: Path) -> None:
    for name in ("private", "plain"):
        (tmp_path / name).mkdir()
        open_record = partial(opened, tmp_path / name / "yard", tmp_path / name / "live.jpg")
        fill(PrivateRecord(open_record) if name == "private" else open_record())
    names = [path.relative_to(tmp_path / "plain") for path in pictures_of(tmp_path / "plain")]
    assert [path.relative_to(tmp_path / "private") for path in pictures_of(tmp_path / "private")] == names
    revealing = [path for path in names if any(map(has_stripes, shown(tmp_path / "plain" / path)))]
    assert {path.parts[1] if len(path.parts) > 1 else str(path) for path in revealing} == {
        "live.jpg",
        "overlay.mp4",
        "background",  # where the outline lags
        "cutouts",
        "events",
        ".views",
    }
    for path in names:
        assert not any(map(has_stripes, shown(tmp_path / "private" / path))), path


def test_a_thing_is_hidden_in_the_frames_before_its_first_label(tmp_path: Path) -> None:
    born = 20
    fill(PrivateRecord(partial(opened, tmp_path / "yard", tmp_path / "live.jpg")), born)
    striped = [has_stripes(image) for image in shown(tmp_path / "yard/overlay.mp4")]
    assert striped[: born - FRAMES_AFTER - 6] == [True] * (born - FRAMES_AFTER - 6)
    assert not any(striped[born - 1 :])


def test_rows_come_in_the_same_order_and_events_say_the_same(tmp_path: Path) -> None:
    for name in ("private", "plain"):
        open_record = partial(StreamRecord, tmp_path / name, "yard", frozenset({"parquet"}), rules=RULES)
        record = PrivateRecord(open_record) if name == "private" else open_record()
        for index in range(30):
            if index % 7 == 3:
                record.gap(index, index / 10, "dropped")
            else:
                record.write(result(index), frame(index))
        record.silent()
        record.gap(30, 3.0, "gap")
        assert record.close(whole=True) == 26
    for name in ("events.jsonl", "objects.csv", "commits.jsonl"):
        assert (tmp_path / "private" / name).read_bytes() == (tmp_path / "plain" / name).read_bytes()


def test_other_rules_hold_from_the_next_row_on(tmp_path: Path) -> None:
    record = PrivateRecord(partial(StreamRecord, tmp_path, "yard", frozenset({"parquet"})))
    for index in range(10):
        record.write(result(index), frame(index))
    record.configure(RULES)
    for index in range(10, 30):
        record.write(result(index), frame(index))
    record.close(whole=True)
    said = [json.loads(line) for line in (tmp_path / "events.jsonl").read_text().splitlines()]
    assert [one["frame"] for one in said if one["kind"] == "configured"] == [9]


def test_what_is_held_is_no_view_of_memory_that_is_used_again(tmp_path: Path) -> None:
    record = PrivateRecord(partial(StreamRecord, tmp_path, "yard", frozenset({"masks"})))
    first, whole = result(0), frame(0)
    expected = first.labels.copy()
    record.write(first, whole)
    first.labels[:] = 9
    for index in range(1, 10):
        record.write(result(index), frame(index))
    record.close(whole=True)
    found = cv2.imread(str(tmp_path / "masks/00000.png"), cv2.IMREAD_COLOR)
    assert found is not None
    np.testing.assert_array_equal(found.any(axis=2), expected > 0)


def test_a_camera_that_stops_keeps_its_last_frames(tmp_path: Path) -> None:
    now = [0.0]
    record = PrivateRecord(
        partial(StreamRecord, tmp_path, "yard", frozenset({"masks"}), live=True), lambda: now[0]
    )
    for index in range(12):
        record.write(result(index), replace(frame(index), taken=1e9 + index / 10))
    assert record.opening.snapshots is not None
    folder = record.opening.snapshots / "00000012"
    folder.mkdir(parents=True)
    (folder / "part").write_bytes(b"")
    snapshot = Snapshot(folder, 12, 12, ())
    assert not record.keep(snapshot)  # more may follow
    now[0] = 5.0
    assert record.keep(snapshot)
    record.provisional()
    assert record.close(whole=False) == 12


def test_a_record_in_full_size_hides_the_full_pictures(tmp_path: Path) -> None:
    open_record = partial(
        FullSizeRecord, tmp_path / "yard", "yard", EVERYTHING, LivePicture(tmp_path / "live.jpg"), rules=RULES
    )
    record = PrivateRecord(open_record)
    for index in range(12):
        record.write(result(index), replace(frame(index), original=picture(index, 3)))
    record.close(whole=True)
    assert next(shown(tmp_path / "yard/overlay.mp4")).shape == (3 * HEIGHT, 3 * WIDTH, 3)
    small = [
        cv2.resize(image, None, fx=1 / 3, fy=1 / 3, interpolation=cv2.INTER_AREA)
        for image in shown(tmp_path / "yard/overlay.mp4")
    ]
    assert not any(map(has_stripes, small))


def test_an_overlay_that_is_drawn_anew_hides_the_same(tmp_path: Path) -> None:
    source = tmp_path / "pictures"
    source.mkdir()
    for index in range(FRAMES):
        cv2.imwrite(str(source / f"{index:05d}.png"), picture(index))
    folder = tmp_path / "yard"
    record = PrivateRecord(partial(opened, folder, tmp_path / "live.jpg"))
    for index in range(FRAMES):
        # The times of a folder of images.
        record.write(result(index), replace(frame(index), pts=index / 25))
    record.close(whole=True)
    before = list(shown(folder / "overlay.mp4"))
    (folder / "overlay.mp4").rename(folder / "overlay-00000009.mp4")
    said: list[str] = []
    make_whole(folder, str(source), said.append, drawing=replace(DRAWING, zones=False))
    anew = list(shown(folder / "overlay.mp4"))
    assert len(anew) == len(before) == FRAMES
    assert not any(map(has_stripes, anew))


def test_a_private_overlay_has_no_sound(tmp_path: Path) -> None:
    from sounding_video import write_sounding_video

    from orchestrator.sources.address import parse_address

    write_sounding_video(tmp_path / "film.mp4", "aac")
    address = parse_address("film.mp4", tmp_path)
    for drawing, sounds in ((Drawing(), 1), (DRAWING, 0)):
        folder = tmp_path / f"yard-{sounds}"
        record = StreamRecord(folder, "yard", frozenset({"overlay"}), source=address, drawing=drawing)
        for index in range(8):
            record.write(result(index), frame(index))
        record.close(whole=True)
        with av.open(str(folder / "overlay.mp4")) as container:
            assert len(container.streams.audio) == sounds
