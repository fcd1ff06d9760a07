"""The list of objects of a stream: when and where each was seen, and how it ended."""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.csv
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import TypeAdapter
from record_fakes import HEIGHT, WIDTH, frame, segmentation, write_stream

from mlbs_actors.messages import FrameStatus, LayerSummary, Region, Segmentation
from mlbs_actors.record.frame_row import FrameRow, ResultRow
from mlbs_actors.record.record_tables import read_rows
from orchestrator.sinks.object_files import OBJECTS_CSV, OBJECTS_JSON, ObjectFiles
from orchestrator.sinks.object_list import ListState, ObjectList
from orchestrator.sinks.record import FIRST_COMMIT, GROUP_FRAMES, StreamRecord

TABLES = frozenset({"parquet"})


def rows_of(folder: Path) -> list[dict[str, str]]:
    with (folder / OBJECTS_CSV).open(newline="") as file:
        return list(csv.DictReader(file))


def described(folder: Path) -> dict[str, Any]:
    content: dict[str, Any] = json.loads((folder / OBJECTS_JSON).read_text())
    return content


def squares(
    index: int, boxes: dict[int, tuple[float, int, int]], status: FrameStatus = "ok", scale: int = 1
) -> Segmentation:
    """A label map with these squares (x, y, side), whose centroids may lie between pixels."""
    labels = np.zeros((HEIGHT * scale, WIDTH * scale), np.uint16)
    summaries = []
    for layer, (x, y, side) in boxes.items():
        left = int(x)
        labels[y : y + side, left : left + side] = layer
        region, centre = Region(left, y, side, side), (x + side / 2, y + side / 2)
        summaries.append(LayerSummary(layer, "object", region, side * side, centre, (0.0, 0.0), 0.5))
    return replace(segmentation(index), labels=labels, layers=tuple(summaries), status=status)


def rows_with(maps: Sequence[Segmentation]) -> list[FrameRow]:
    """The rows of these label maps, ten a second."""
    return [
        FrameRow(index, index / 10, one.status, ResultRow.of(one, 1.0), str(index))
        for index, one in enumerate(maps)
    ]


def listed(*maps: Segmentation) -> ObjectList:
    """A list of these label maps."""
    return ObjectList().add(rows_with(maps))


def test_a_row_says_when_and_where_an_object_was_seen(tmp_path: Path) -> None:
    write_stream(tmp_path / "yard")
    first, second = rows_of(tmp_path / "yard")
    assert (first["id"], second["id"]) == ("3", "5")
    assert {key: second[key] for key in ("first_frame", "last_frame", "frames", "times_hidden")} == {
        "first_frame": "0",
        "last_frame": "39",
        "frames": "34",
        "times_hidden": "1",
    }
    # Seen from 0 s to 1.9 s and from 2.5 s to 3.9 s: the frame that could not be decoded hides nothing.
    assert (second["first_s"], second["last_s"], second["seconds"]) == ("0.0", "3.9", "3.3")
    assert [second[f"first_{side}"] for side in "xywh"] == ["0", "17", "8", "10"]
    assert [second[f"last_{side}"] for side in "xywh"] == ["9", "17", "8", "10"]
    assert (second["area_px"], second["start_cx"], second["end_cx"]) == ("80", "3.5", "12.5")
    assert second["score"] == "0.5"
    # It goes a pixel a frame and at frame 30, where it begins anew, 29 back.
    assert float(first["path_px"]) == 29 + 29 + 9


def test_a_spreadsheet_reads_numbers_as_numbers(tmp_path: Path) -> None:
    write_stream(tmp_path / "yard")
    table = pyarrow.csv.read_csv(tmp_path / "yard" / OBJECTS_CSV)
    assert table.num_rows == 2
    types = {field.name: str(field.type) for field in table.schema}
    assert {types[name] for name in ("id", "first_frame", "frames", "area_px", "last_w")} == {"int64"}
    assert {types[name] for name in ("first_s", "seconds", "path_px", "end_cy")} == {"double"}
    assert table["end"].to_pylist() == ["end of the stream"] * 2


def test_the_json_file_says_what_the_csv_file_says_and_has_the_path(tmp_path: Path) -> None:
    write_stream(tmp_path / "yard")
    content = described(tmp_path / "yard")
    assert (content["stream"], content["complete"]) == ("yard", True)
    assert (content["label_maps"], content["last_frame"], content["last_s"]) == (39, 39, 3.9)
    for row, one in zip(rows_of(tmp_path / "yard"), content["objects"], strict=True):
        for key in ("id", "frames", "seconds", "times_hidden", "area_px", "path_px", "score", "state", "end"):
            assert str(one[key]) == row[key]
        for end in ("first", "last"):
            assert (str(one[end]["frame"]), str(one[end]["s"])) == (row[f"{end}_frame"], row[f"{end}_s"])
            assert [str(side) for side in one[end]["box"]] == [row[f"{end}_{side}"] for side in "xywh"]
    three, five = (one["path"] for one in content["objects"])
    # One a second, and the last. Frame 10 was not decoded; 5 is hidden in 20 to 24.
    assert [place[0] for place in three] == [0, 11, 21, 31, 39]
    assert [place[0] for place in five] == [0, 11, 25, 35, 39]
    assert three[1] == [11, 1.1, 14.5, 9.5]


def test_endings_are_told_as_the_label_maps_show_them() -> None:
    objects = listed(
        squares(0, {1: (0, 20, 8), 2: (20, 5, 10), 4: (30, 20, 8), 6: (40, 2, 5)}),
        squares(1, {5: (21, 5, 10), 6: (40, 2, 5), 7: (10, 20, 8)}),
        squares(2, {6: (40, 2, 5), 8: (10, 20, 8)}, status="cut"),
        squares(3, {9: (40, 2, 5)}, scale=2),
    )
    assert {one.layer: (one.ending.kind, one.ending.by) for one in objects.objects} == {
        1: ("left", None),
        2: ("replaced", 5),
        4: ("lost", None),
        5: ("cut", None),
        7: ("cut", None),  # though 8 is in its place
        6: ("resized", None),
        8: ("resized", None),
        9: ("seen", None),
    }


def test_an_object_that_comes_back_is_present_again_with_one_row() -> None:
    objects = listed(*(squares(index, {} if index == 1 else {3: (5, 5, 8)}) for index in range(3)))
    (row,) = list(csv.DictReader(objects.csv(complete=False).splitlines()))
    assert (row["state"], row["end"], row["frames"], row["times_hidden"]) == ("moving", "", "2", "1")
    assert objects.objects[0].spans == [(0, 0), (2, 2)]


def test_an_object_that_is_shown_moves_or_rests() -> None:
    first = squares(0, {3: (5, 5, 8)})
    at_rest = squares(1, {3: (5, 5, 8)})
    at_rest = replace(at_rest, layers=tuple(replace(one, state="resting") for one in at_rest.layers))
    moving, resting = (
        next(csv.DictReader(listed(*maps).csv(complete=False).splitlines()))["state"]
        for maps in ((first,), (first, at_rest))
    )
    assert (moving, resting) == ("moving", "resting")


def test_only_a_stream_that_is_over_ends_what_is_in_its_last_frame() -> None:
    objects = listed(squares(0, {3: (5, 5, 8), 4: (20, 5, 8)}), squares(1, {3: (5, 5, 8)}))
    for complete, end in ((False, ""), (True, "end of the stream")):
        seen, gone = csv.DictReader(objects.csv(complete=complete).splitlines())
        assert (seen["state"], seen["end"]) == ("moving", end)
        assert (gone["state"], gone["end"]) == ("gone", "no longer found")


def test_the_files_hold_what_is_committed_while_the_stream_goes_on(tmp_path: Path) -> None:
    record = StreamRecord(tmp_path / "yard", "yard", TABLES)
    for index in range(FIRST_COMMIT + 3):
        assert (tmp_path / "yard" / OBJECTS_CSV).exists() == (index >= FIRST_COMMIT)
        record.write(segmentation(index), frame(index))
    (row,) = rows_of(tmp_path / "yard")
    assert (row["last_frame"], row["state"], row["end"]) == (str(FIRST_COMMIT - 1), "moving", "")
    assert described(tmp_path / "yard")["complete"] is False


def test_without_tables_there_is_no_list(tmp_path: Path) -> None:
    write_stream(tmp_path / "yard", frozenset({"masks"}))
    assert not list((tmp_path / "yard").glob("objects.*"))


def test_a_stream_without_objects_has_an_empty_list(tmp_path: Path) -> None:
    record = StreamRecord(tmp_path / "yard", "yard", TABLES)
    record.write(squares(0, {}), frame(0))
    record.close(whole=True)
    assert rows_of(tmp_path / "yard") == described(tmp_path / "yard")["objects"] == []


LONG = 2 * GROUP_FRAMES + 5


def wandering(index: int) -> Segmentation:
    """Objects that come, hide and go, at places that no float32 is exactly."""
    boxes = {3: (index % 30 + 0.1, 5, 8), 5: (10 + index / 7, 17, 7)}
    if 20 <= index < 40:
        del boxes[5]
    if index > 50:
        del boxes[3]
    return squares(index, boxes)


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("undisturbed") / "yard"
    record = StreamRecord(folder, "yard", TABLES)
    for index in range(LONG):
        record.write(wandering(index), frame(index))
    record.close(whole=True)
    return folder


@pytest.mark.parametrize("interrupted", [False, True])
@pytest.mark.parametrize("at", [3, FIRST_COMMIT, 30, GROUP_FRAMES, 45, LONG - 1])
def test_a_resumed_stream_has_the_list_of_an_undisturbed_one(
    tmp_path: Path, undisturbed: Path, at: int, interrupted: bool
) -> None:
    record = StreamRecord(tmp_path / "yard", "yard", TABLES)
    for index in range(at):
        if interrupted and index == at - 2:
            record.provisional()
        record.write(wandering(index), frame(index))
    if interrupted:
        record.close(whole=False)
        assert described(tmp_path / "yard")["label_maps"] == at
    record = StreamRecord(tmp_path / "yard", "yard", TABLES)
    for index in range(LONG):
        record.write(wandering(index), frame(index))
    record.close(whole=True)
    for name in (OBJECTS_CSV, OBJECTS_JSON):
        assert (tmp_path / "yard" / name).read_bytes() == (undisturbed / name).read_bytes()


def test_a_list_that_is_continued_after_any_row_is_the_same() -> None:
    rows, states = rows_with([wandering(index) for index in range(LONG)]), TypeAdapter(ListState)
    whole = ObjectList().add(rows).json("yard", complete=True)
    for index in range(1, LONG):
        before = ObjectList().add(rows[:index])
        read = ObjectList(states.validate_json(states.dump_json(before.state)), rows[index - 1].result)
        assert read.json("yard", complete=False) == before.json("yard", complete=False)
        assert read.add(rows[index:]).json("yard", complete=True) == whole


def begun(folder: Path) -> None:
    """A record of a stream that lost a process after frame 38, in which an object is hidden."""
    record = StreamRecord(folder, "yard", TABLES)
    for index in range(39):
        record.write(wandering(index), frame(index))
    record.close(whole=False)


def finished(folder: Path) -> None:
    record = StreamRecord(folder, "yard", TABLES)
    for index in range(LONG):
        record.write(wandering(index), frame(index))
    record.close(whole=True)


def test_a_long_record_is_not_read_again_from_its_start(tmp_path: Path, undisturbed: Path) -> None:
    begun(tmp_path / "yard")
    for first in (0, FIRST_COMMIT):
        for path in (tmp_path / "yard").glob(f"*-{first:08d}.parquet"):
            path.unlink()
    finished(tmp_path / "yard")
    assert (tmp_path / "yard" / OBJECTS_JSON).read_bytes() == (undisturbed / OBJECTS_JSON).read_bytes()


@pytest.mark.parametrize("state", [None, b"", b'{"rows": 32}', b'{"rows": 1000, "objects": {}}'])
def test_without_a_usable_state_the_list_is_made_from_the_tables(
    tmp_path: Path, undisturbed: Path, state: bytes | None
) -> None:
    begun(tmp_path / "yard")
    (kept,) = (path for path in (tmp_path / "yard").iterdir() if path.name == ".objects")
    if state is None:
        kept.unlink()
    else:
        kept.write_bytes(state)
    finished(tmp_path / "yard")
    assert (tmp_path / "yard" / OBJECTS_JSON).read_bytes() == (undisturbed / OBJECTS_JSON).read_bytes()


@given(st.lists(st.dictionaries(st.integers(1, 4), st.floats(0, 40), max_size=4), max_size=8))
def test_every_object_of_the_label_maps_is_listed_and_no_other(lefts: list[dict[int, float]]) -> None:
    maps = [
        squares(index, {layer: (x, 8 * layer - 8, 8) for layer, x in there.items()})
        for index, there in enumerate(lefts)
    ]
    objects = listed(*maps).objects
    assert [one.layer for one in objects] == sorted(set().union(*lefts))
    for one in objects:
        frames = [index for index, there in enumerate(lefts) if one.layer in there]
        assert (one.first.frame, one.last.frame, one.frames) == (frames[0], frames[-1], len(frames))
        assert sum(last + 1 - first for first, last in one.spans) == len(frames)
        assert (one.ending.kind == "seen") == (frames[-1] == len(lefts) - 1)
        assert one.seconds == pytest.approx(sum(last - first for first, last in one.spans) / 10)


def test_files_that_take_long_to_write_are_written_rarely(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, undisturbed: Path
) -> None:
    now = [0.0]
    files = ObjectFiles(tmp_path, "yard", lambda: now[0])
    made = ObjectList.csv

    def slow(self: ObjectList, *, complete: bool) -> str:
        now[0] += 0.5
        return made(self, complete=complete)

    monkeypatch.setattr(ObjectList, "csv", slow)
    written = []
    for row in read_rows(undisturbed):
        now[0] += 1.0
        before = now[0]
        files.add([row], provisional=False)
        written += [row.frame] * (now[0] > before)
    assert written == [0, 25, 50]
    files.write(complete=True)
    assert (tmp_path / OBJECTS_JSON).read_bytes() == (undisturbed / OBJECTS_JSON).read_bytes()
