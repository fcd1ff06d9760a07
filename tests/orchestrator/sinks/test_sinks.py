"""The record of a stream: label maps, tables, commits and the overlay derived from them."""

from __future__ import annotations

import io
import json
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pyarrow.dataset as ds
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from PIL import Image
from pycocotools import mask as coco_mask
from record_fakes import HEIGHT, WIDTH, frame, segmentation

from mlbs_actors.errors import SinkError
from mlbs_actors.messages import Array, Region, Segmentation
from mlbs_actors.record.frame_row import run_length_code
from mlbs_actors.record.record_tables import read_table
from orchestrator.sinks.label_image import davis_palette, encode_label_image, voc_colours
from orchestrator.sinks.labelled_picture import LabelledPicture
from orchestrator.sinks.overlay import OverlayVideo
from orchestrator.sinks.record import FIRST_COMMIT, GROUP_FRAMES, StreamRecord
from orchestrator.storage import commit_log, durable_files

EVERYTHING = frozenset({"masks", "parquet", "overlay"})


def fill(folder: Path, count: int, save: frozenset[str] = EVERYTHING) -> StreamRecord:
    record = StreamRecord(folder, "yard", save)
    for index in range(count):
        record.write(segmentation(index), frame(index))
    return record


def commits(folder: Path) -> list[dict[str, object]]:
    return [json.loads(line) for line in (folder / "commits.jsonl").read_text().splitlines()]


# Label maps


def test_the_palette_begins_as_that_of_davis() -> None:
    palette = davis_palette().tolist()
    assert palette[:10] == [
        [0, 0, 0],
        [128, 0, 0],
        [0, 128, 0],
        [128, 128, 0],
        [0, 0, 128],
        [128, 0, 128],
        [0, 128, 128],
        [128, 128, 128],
        [64, 0, 0],
        [191, 0, 0],
    ]
    assert palette[19:24] == [[128, 191, 0], [0, 64, 128], [128, 64, 128], [22, 22, 22], [23, 23, 23]]
    assert palette[255] == [255, 255, 255]


def test_voc_colours_are_those_of_the_bit_by_bit_rule() -> None:
    for index, colour in enumerate(voc_colours().tolist()):
        expected, bits = [0, 0, 0], index
        for level in range(8):
            for channel in range(3):
                expected[channel] |= (bits >> channel & 1) << (7 - level)
            bits >>= 3
        assert colour == expected


@pytest.mark.parametrize(
    ("largest", "mode"), [(0, "P"), (1, "P"), (254, "P"), (255, "I;16"), (40000, "I;16")]
)
def test_a_label_image_gives_back_its_ids_whatever_the_largest(largest: int, mode: str) -> None:
    labels = np.zeros((7, 5), np.uint16)
    labels[2:4, 1] = largest
    labels[6, 4] = largest // 2
    image = Image.open(io.BytesIO(encode_label_image(labels)))
    assert image.mode == mode
    np.testing.assert_array_equal(np.asarray(image), labels)
    assert image.getpalette() == (davis_palette().ravel().tolist() if mode == "P" else None)


@pytest.mark.parametrize("largest", [2, 254, 65535])
def test_a_label_image_is_the_picture_that_an_image_library_writes(largest: int) -> None:
    labels = np.random.default_rng(5).integers(0, largest, (241, 319), np.uint16, endpoint=True)
    written, buffer = Image.open(io.BytesIO(encode_label_image(labels))), io.BytesIO()
    image = Image.fromarray(labels.astype(np.uint8) if largest < 255 else labels)
    if largest < 255:
        image.putpalette(davis_palette().tobytes())
    image.save(buffer, format="PNG")
    expected = Image.open(buffer)
    assert (written.mode, written.info, written.getpalette()) == (
        expected.mode,
        expected.info,
        expected.getpalette(),
    )
    np.testing.assert_array_equal(np.asarray(written), np.asarray(expected))


# Record


def test_a_record_holds_a_mask_a_frame_under_the_name_of_the_input(tmp_path: Path) -> None:
    assert fill(tmp_path / "yard", 5).close(whole=True) == 5
    masks = sorted(path.name for path in (tmp_path / "yard/masks").iterdir())
    assert masks == [f"img{index:03d}.png" for index in range(5)]
    stored = np.asarray(Image.open(tmp_path / "yard/masks/img004.png"))
    np.testing.assert_array_equal(stored, segmentation(4).labels)


def test_the_tables_have_the_columns_and_types_of_the_contract_first(tmp_path: Path) -> None:
    fill(tmp_path / "yard", 2).close(whole=True)
    layers = pq.read_schema(next((tmp_path / "yard").glob("layers-*.parquet")))
    assert [(field.name, str(field.type)) for field in layers] == [
        ("stream", "string"),
        ("frame", "int64"),
        ("layer", "int32"),
        ("kind", "string"),
        ("x", "int32"),
        ("y", "int32"),
        ("w", "int32"),
        ("h", "int32"),
        ("area", "int64"),
        ("cx", "float"),
        ("cy", "float"),
        ("vx", "float"),
        ("vy", "float"),
        ("confidence", "float"),
        ("rle", "string"),
        ("state", "string"),
        ("score", "float"),
    ]
    frames = pq.read_schema(next((tmp_path / "yard").glob("frames-*.parquet")))
    assert [(field.name, str(field.type)) for field in frames][:8] == [
        ("stream", "string"),
        ("frame", "int64"),
        ("pts", "double"),
        ("status", "string"),
        ("layers", "int32"),
        ("latency_frames", "int32"),
        ("camera_dx", "float"),
        ("camera_dy", "float"),
    ]
    assert {"ms_track", "ms_cut"} < set(frames.names)
    assert {str(field.type) for field in frames if field.name.startswith("ms_")} == {"float"}


# pycocotools decodes through an __array__ method that NumPy 2 finds outdated.
@pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")
def test_the_rows_say_what_the_label_maps_hold(tmp_path: Path) -> None:
    count = GROUP_FRAMES + 3
    fill(tmp_path / "yard", count).close(whole=True)
    rows = ds.dataset(sorted((tmp_path / "yard").glob("layers-*.parquet"))).to_table().to_pylist()
    assert [row["frame"] for row in rows] == list(range(count))
    for row in rows:
        mask = segmentation(row["frame"]).labels == row["layer"]
        decoded = coco_mask.decode({"size": [HEIGHT, WIDTH], "counts": row["rle"]})
        np.testing.assert_array_equal(decoded.astype(bool), mask)
        ys, xs = np.nonzero(mask)
        assert (row["x"], row["y"], row["w"], row["h"]) == (xs.min(), ys.min(), 8, 10)
        assert (row["area"], row["cx"], row["cy"]) == (mask.sum(), xs.mean(), ys.mean())
    frames = ds.dataset(sorted((tmp_path / "yard").glob("frames-*.parquet"))).to_table().to_pylist()
    assert [(row["stream"], row["frame"], row["status"], row["layers"]) for row in frames] == [
        ("yard", index, "ok", 1) for index in range(count)
    ]
    assert frames[7]["pts"] == 0.7
    assert (frames[7]["height"], frames[7]["width"], frames[7]["ms_cut"]) == (HEIGHT, WIDTH, 3.0)


@given(
    labels=arrays(np.uint16, array_shapes(min_dims=2, max_dims=2, max_side=9), elements=st.integers(0, 2)),
    margin=st.integers(0, 2),
)
def test_a_run_length_code_is_that_of_pycocotools(labels: Array, margin: int) -> None:
    for layer in np.unique(labels).tolist():
        y, x = np.nonzero(labels == layer)
        left, top = max(x.min() - margin, 0), max(y.min() - margin, 0)
        right, bottom = min(x.max() + margin + 1, labels.shape[1]), min(y.max() + margin + 1, labels.shape[0])
        region = Region(int(left), int(top), int(right - left), int(bottom - top))
        expected = coco_mask.encode(np.asfortranarray(labels == layer, dtype=np.uint8))["counts"]
        assert run_length_code(labels, layer, region) == expected.decode("ascii")


def test_a_frame_without_label_map_is_a_row_without_results(tmp_path: Path) -> None:
    record = StreamRecord(tmp_path / "yard", "yard", EVERYTHING)
    record.write(segmentation(0), frame(0))
    record.gap(1, 0.1, "quarantined")
    record.write(segmentation(1), frame(2))
    assert record.close(whole=True) == 2
    rows = pq.read_table(next((tmp_path / "yard").glob("frames-*.parquet"))).to_pylist()
    assert [row["status"] for row in rows] == ["ok", "quarantined", "ok"]
    assert {key for key, value in rows[1].items() if value is not None} == {
        "stream",
        "frame",
        "pts",
        "status",
    }
    # The record counts frames of the source, the engine those it was given.
    layers = pq.read_table(next((tmp_path / "yard").glob("layers-*.parquet"))).to_pylist()
    assert [row["frame"] for row in layers] == [0, 2]


def test_a_stage_that_appears_late_is_counted_in_the_same_columns(tmp_path: Path) -> None:
    record = fill(tmp_path / "yard", GROUP_FRAMES, frozenset({"parquet"}))
    late = segmentation(GROUP_FRAMES)
    late = Segmentation(
        late.frame_index,
        late.labels,
        late.normaliser,
        late.fallback,
        (),
        (0.0, 0.0),
        0,
        {"track": 1.0, "merge": 4.0},
    )
    record.write(late, frame(GROUP_FRAMES))
    record.close(whole=True)
    first, _, last = (pq.read_table(path) for path in sorted((tmp_path / "yard").glob("frames-*.parquet")))
    assert first.schema.equals(last.schema)
    assert last["ms_other"].to_pylist() == [4.0]
    assert last["ms_cut"].to_pylist() == [None]


def test_nothing_counts_before_its_line_and_each_line_stands_for_files_that_are_there(tmp_path: Path) -> None:
    record = StreamRecord(tmp_path / "yard", "yard", EVERYTHING)
    for index in range(2 * GROUP_FRAMES + 5):
        committed = record.write(segmentation(index), frame(index))
        masks = list((tmp_path / "yard/masks").glob("img*.png"))
        due = (index + 1) // GROUP_FRAMES * GROUP_FRAMES or (index + 1) // FIRST_COMMIT * FIRST_COMMIT
        assert len(masks) == committed == min(due, FIRST_COMMIT if index + 1 < GROUP_FRAMES else due)
    assert record.close(whole=True) == 2 * GROUP_FRAMES + 5
    assert record.close(whole=True) == 2 * GROUP_FRAMES + 5
    assert commits(tmp_path / "yard") == [
        {"generation": 0, "first": 0, "last": FIRST_COMMIT - 1, "snapshot": None},
        {"generation": 0, "first": FIRST_COMMIT, "last": GROUP_FRAMES - 1, "snapshot": None},
        {"generation": 0, "first": GROUP_FRAMES, "last": 2 * GROUP_FRAMES - 1, "snapshot": None},
        {"generation": 0, "first": 2 * GROUP_FRAMES, "last": 2 * GROUP_FRAMES + 4, "snapshot": None},
    ]
    assert not list((tmp_path / "yard").rglob(".*.part"))


def test_files_are_synced_and_renamed_before_their_line_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    steps: list[str] = []
    replace, append = Path.replace, durable_files.append_line

    def sync_noted(path: Path) -> None:
        steps.append(f"sync {path.name}")

    def replace_noted(path: Path, to: Path) -> Path:
        steps.append(f"rename {to.name}")
        return replace(path, to)

    def append_noted(path: Path, line: str) -> None:
        steps.append("commit")
        append(path, line)

    monkeypatch.setattr(durable_files, "_sync", sync_noted)
    monkeypatch.setattr(Path, "replace", replace_noted)
    monkeypatch.setattr(commit_log, "append_line", append_noted)
    record = fill(tmp_path / "yard", 2, frozenset({"masks"}))
    steps.clear()
    record.close(whole=True)
    counts = ("counts.csv", "counts.parquet", "counts.json")
    assert steps[:15] == [
        f"sync {durable_files.temporary_path(Path('img000.png'))}",
        f"sync {durable_files.temporary_path(Path('img001.png'))}",
        *(f"sync {durable_files.temporary_path(Path(name))}" for name in counts),
        f"sync {durable_files.temporary_path(Path('.events'))}",
        "rename img000.png",
        "rename img001.png",
        *(f"rename {name}" for name in counts),
        "rename .events",
        "sync yard",
        "sync masks",
        "commit",
    ]


def test_only_what_was_asked_for_is_written(tmp_path: Path) -> None:
    fill(tmp_path / "a", 2, frozenset({"masks"})).close(whole=True)
    fill(tmp_path / "b", 2, frozenset({"parquet"})).close(whole=True)
    assert sorted(path.name for path in (tmp_path / "a").iterdir()) == [
        ".events",
        ".generation",
        ".lock",
        "commits.jsonl",
        "counts.csv",
        "counts.json",
        "counts.parquet",
        "events.jsonl",
        "masks",
    ]
    assert sorted(path.name for path in (tmp_path / "b").iterdir()) == [
        ".events",
        ".generation",
        ".lock",
        "commits.jsonl",
        "counts.csv",
        "counts.json",
        "counts.parquet",
        "events.jsonl",
        "frames-00000000.parquet",
        "layers-00000000.parquet",
        "objects.csv",
        "objects.json",
    ]


def test_two_records_of_the_same_frames_have_the_same_bytes(tmp_path: Path) -> None:
    fill(tmp_path / "a", 40, frozenset({"masks", "parquet"})).close(whole=True)
    fill(tmp_path / "b", 40, frozenset({"masks", "parquet"})).close(whole=True)
    names = sorted(path.relative_to(tmp_path / "a") for path in (tmp_path / "a").rglob("*") if path.is_file())
    assert len(names) == 40 + 3 * 2 + 2 + 2 + 3 + 3
    for name in names:
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes(), name


@pytest.mark.parametrize("save", ["masks", "parquet"])
def test_a_folder_that_goes_away_fails_the_record_with_a_sentence(tmp_path: Path, save: str) -> None:
    record = fill(tmp_path / "yard", 3, frozenset({save}))
    (tmp_path / "yard").rename(tmp_path / "elsewhere")
    with pytest.raises(SinkError, match="'yard' cannot be written"):
        record.close(whole=True)


# Overlay


def _decode(path: Path) -> list[Array]:
    with av.open(str(path)) as container:
        return [picture.to_ndarray(format="bgr24") for picture in container.decode(video=0)]


@pytest.mark.parametrize("shape", [(36, 50), (37, 51), (4, 3)])
def test_the_overlay_shows_each_frame_once_at_any_size(tmp_path: Path, shape: tuple[int, int]) -> None:
    overlay = OverlayVideo(tmp_path / "overlay.mp4")
    for index in range(6):
        overlay.add(
            LabelledPicture(
                np.full((*shape, 3), 40 * index, np.uint8), np.zeros(shape, np.uint16), index, index / 10
            )
        )
    assert not (tmp_path / "overlay.mp4").exists()
    overlay.close()
    overlay.close()
    pictures = _decode(tmp_path / "overlay.mp4")
    assert [round(float(picture[-1, -1].mean()) / 40) for picture in pictures] == list(range(6))
    assert pictures[0].shape[0] >= shape[0]
    assert pictures[0].shape[1] >= shape[1]


@pytest.mark.parametrize("rate", [20, 24, 25, 30, 60, Fraction(30_000, 1001), Fraction(24_000, 1001)])
def test_the_overlay_has_the_frame_rate_of_its_frames(tmp_path: Path, rate: int | Fraction) -> None:
    overlay = OverlayVideo(tmp_path / "overlay.mp4")
    for index in range(50):
        overlay.add(
            LabelledPicture(
                np.zeros((32, 32, 3), np.uint8), np.zeros((32, 32), np.uint16), index, index / float(rate)
            )
        )
    overlay.close()
    with av.open(str(tmp_path / "overlay.mp4")) as container:
        (video,) = container.streams
        assert video.duration is not None
        assert video.time_base is not None
        assert float(video.duration * video.time_base) == pytest.approx(50 / float(rate), abs=2e-5)
        assert container.streams.video[0].average_rate == pytest.approx(float(rate), rel=1e-5)


def test_at_a_variable_frame_rate_the_last_frame_is_shown_as_long_as_the_others_on_average(
    tmp_path: Path,
) -> None:
    overlay = OverlayVideo(tmp_path / "overlay.mp4")
    for index, pts in enumerate((0.0, 0.1, 0.2, 0.8)):
        overlay.add(
            LabelledPicture(np.zeros((32, 32, 3), np.uint8), np.zeros((32, 32), np.uint16), index, pts)
        )
    overlay.close()
    with av.open(str(tmp_path / "overlay.mp4")) as container:
        assert container.duration == pytest.approx((0.8 + 0.8 / 3) * av.time_base, abs=1000)


def test_times_that_go_backwards_or_stand_still_do_not_end_the_overlay(tmp_path: Path) -> None:
    overlay = OverlayVideo(tmp_path / "overlay.mp4")
    for index, pts in enumerate((0.0, 0.1, 0.1, 0.05, 3.0, 0.2)):
        overlay.add(
            LabelledPicture(np.zeros((32, 32, 3), np.uint8), np.zeros((32, 32), np.uint16), index, pts)
        )
    overlay.close()
    assert len(_decode(tmp_path / "overlay.mp4")) == 6


def test_pixels_that_are_not_square_are_shown_so_and_told(tmp_path: Path) -> None:
    record = StreamRecord(tmp_path / "yard", "yard", EVERYTHING)
    record.write(segmentation(0), replace(frame(0), pixel_aspect=64 / 45))
    record.close(whole=True)
    with av.open(str(tmp_path / "yard" / "overlay.mp4")) as container:
        assert container.streams.video[0].sample_aspect_ratio == Fraction(64, 45)
    (row,) = read_table(tmp_path / "yard", "frames").to_pylist()
    assert row["pixel_aspect"] == pytest.approx(64 / 45)


def test_frames_of_another_size_are_scaled_into_the_overlay(tmp_path: Path) -> None:
    overlay = OverlayVideo(tmp_path / "overlay.mp4")
    for index, shape in enumerate(((32, 48), (64, 96))):
        overlay.add(
            LabelledPicture(np.full((*shape, 3), 200, np.uint8), np.zeros(shape, np.uint16), index, index)
        )
    overlay.close()
    assert [picture.shape for picture in _decode(tmp_path / "overlay.mp4")] == [(32, 48, 3)] * 2


def test_an_overlay_that_cannot_be_written_leaves_the_record_whole_and_says_why(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*arguments: object, **options: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(av, "open", refuse)
    assert fill(tmp_path / "yard", 4).close(whole=True) == 4
    assert commits(tmp_path / "yard")[0]["last"] == 3
    assert not (tmp_path / "yard/overlay.mp4").exists()
    assert "No space left" in (tmp_path / "yard/overlay.error").read_text()
