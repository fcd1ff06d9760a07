"""The counts of a stream's record, which is killed and opened again."""

from __future__ import annotations

import contextlib
import csv
import json
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from record_fakes import HEIGHT, WIDTH, bare_snapshot, frame, segmentation

from mlbs_actors.record.frame_row import FrameRow
from mlbs_actors.record.scene_place import Point
from mlbs_actors.source import SourceFrame
from orchestrator.counts.tally import HEAT_COLUMNS, PICTURE, CountState, Situation, Tally, heat_cell
from orchestrator.events.zones import EventRules, Zone
from orchestrator.sinks.record import StreamRecord
from orchestrator.storage.commit_log import forget_segment
from orchestrator.storage.segments import segment_folders

MIDDLE = Zone(name="middle", polygon=((10, 0), (20, 0), (20, 40), (10, 40)))
FENCE = Zone(name="fence", kind="line", polygon=((15, 0), (15, 40)))
RULES = EventRules((MIDDLE, FENCE), remembered=4)
SAVE = frozenset({"parquet"})
FRAMES, STEP_SECONDS = 200, 40.0  # two hours and some minutes
DROPPED = frozenset({60, 61, 62, 63, 130})
AWAY, AWAY_STEPS = 100, 20
BEGAN = 1_700_000_000.0


def seconds(index: int) -> float:
    return STEP_SECONDS * (index + AWAY_STEPS * (index > AWAY))


def taken(index: int, *, live: bool) -> SourceFrame:
    shown = frame(index)
    return replace(shown, pts=seconds(index), taken=BEGAN + seconds(index) if live else None)


def record(folder: Path, *, live: bool = False, rules: EventRules = RULES) -> StreamRecord:
    return StreamRecord(folder, "yard", SAVE, rules=rules, live=live)


def write(one: StreamRecord, begin: int, end: int, *, live: bool = False) -> None:
    """Object 3 walks to the right, again and again; 5 is away every other eight frames."""
    for index in range(begin, end):
        if index == AWAY:
            one.gap(index, seconds(index), "gap")
        elif index in DROPPED:
            one.gap(index, seconds(index), "dropped")
        else:
            one.write(segmentation(index, 3, *([5] if index // 8 % 2 else [])), taken(index, live=live))


def rows_of(folder: Path) -> list[dict[str, str]]:
    with (folder / "counts.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def summary(folder: Path) -> dict[str, Any]:
    content: dict[str, Any] = json.loads((folder / "counts.json").read_text())
    return content


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A file's record without a kill."""
    folder = tmp_path_factory.mktemp("whole")
    one = record(folder)
    write(one, 0, FRAMES)
    one.close(whole=True)
    return folder


def test_the_hours_together_have_every_event_of_the_file_once(whole: Path) -> None:
    said = [json.loads(line) for line in (whole / "events.jsonl").read_text().splitlines()]
    rows = rows_of(whole)
    assert sorted({int(row["hour"]) for row in rows}) == [0, 1, 2]
    assert {row["begins"] + row["local"] for row in rows} == {""}
    total: Counter[str] = Counter()
    for row in rows:
        for column in ("born", "entered", "left", "crossed_left", "crossed_right"):
            total[column] += int(row[column] or 0)
    kinds = Counter(one["kind"] + (f"_{one['direction']}" if one["direction"] else "") for one in said)
    assert total["entered"] > 5
    assert total["crossed_right"] > 5
    for column, number in total.items():
        assert number == kinds[column], column
    assert summary(whole)["events"] == Counter(one["kind"] for one in said)
    assert summary(whole)["crossings"]["fence"]["right"] == kinds["crossed_right"]
    assert summary(whole)["zones"] == {"middle": 0}


def test_who_was_in_a_zone_for_how_long_follows_from_the_events(whole: Path) -> None:
    """An obvious count of the same: row by row from the lines of the file."""
    said = [json.loads(line) for line in (whole / "events.jsonl").read_text().splitlines()]
    ends = {(one["frame"], one["object"]): one["reason"] for one in said if one["kind"] == "ended"}
    certain: dict[int, list[tuple[str, int]]] = {}
    for one in said:
        end = ends.get((one["frame"], one["object"]))
        if (one["zone"] == "middle" or one["kind"] == "hidden") and end != "end of the stream":
            # The first of three label maps that agree is named; of an end, the first of five without it.
            steps = [index for index in range(one["frame"], FRAMES) if index not in DROPPED and index != AWAY]
            step = steps[2 if end is None or one["kind"] == "hidden" else 4]
            certain.setdefault(step, []).append((one["kind"], one["object"]))
    inside: set[int] = set()
    occupied, integral = 0.0, 0.0
    for index in range(1, FRAMES):
        if index != AWAY + 1:  # the camera was away
            occupied += bool(inside) * STEP_SECONDS
            integral += len(inside) * STEP_SECONDS
        for kind, number in certain.get(index, ()):
            if kind == "entered":
                inside.add(number)
            else:
                inside.discard(number)
    rows = [row for row in rows_of(whole) if row["place"] == "middle"]
    assert sum(float(row["occupied_s"]) for row in rows) == pytest.approx(occupied, abs=0.01)
    means = sum(float(row["mean_objects"]) * float(row["seconds"]) for row in rows)
    assert means == pytest.approx(integral, rel=1e-3)
    assert max(int(row["most_objects"]) for row in rows) == 2


def test_an_hour_says_what_was_dropped_and_what_was_not_observed(whole: Path) -> None:
    picture = [row for row in rows_of(whole) if row["place"] == PICTURE]
    assert [int(row["frames"]) - int(row["label_maps"]) for row in picture] == [4, 1, 0]
    assert float(picture[0]["dropped_share"]) == pytest.approx(4 / int(picture[0]["frames"]), abs=1e-4)
    assert sum(float(row["seconds"]) for row in picture) == pytest.approx((FRAMES - 2) * STEP_SECONDS)
    fence = [row for row in rows_of(whole) if row["place"] == "fence"]
    said = [json.loads(line) for line in (whole / "events.jsonl").read_text().splitlines()]
    crossed = [one["dropped_share"] for one in said if one["kind"] == "crossed"]
    around = [float(row["dropped_share_around"] or 0) for row in fence]
    crossings = [int(row["crossed_left"]) + int(row["crossed_right"]) for row in fence]
    assert sum(np.multiply(around, crossings)) == pytest.approx(sum(crossed), abs=0.02)
    assert 0 < around[0] < 0.15


def test_the_parquet_file_has_the_same_rows(whole: Path) -> None:
    table = pq.ParquetFile(whole / "counts.parquet").read().to_pylist()
    rows = rows_of(whole)
    assert [row["place"] for row in table] == [row["place"] for row in rows]
    assert [row["crossed_right"] for row in table] == [
        int(row["crossed_right"]) if row["crossed_right"] else None for row in rows
    ]


@pytest.mark.parametrize("killed_after", [1, 8, 33, 64, 91, 92, 96, 101, 160, 199])
def test_a_record_that_was_killed_counts_nothing_twice_and_loses_nothing(
    tmp_path: Path, whole: Path, killed_after: int
) -> None:
    one = record(tmp_path)
    write(one, 0, killed_after)
    again = record(tmp_path)
    write(again, 0, FRAMES)
    again.close(whole=True)
    for name in ("counts.csv", "counts.json"):
        assert (tmp_path / name).read_bytes() == (whole / name).read_bytes()


@pytest.mark.parametrize("step", range(12))
def test_a_kill_between_any_two_steps_of_a_commit_changes_no_count(
    tmp_path: Path, whole: Path, monkeypatch: pytest.MonkeyPatch, step: int
) -> None:
    """An hour ends at row 90, and so within the commit up to row 96."""
    one = record(tmp_path)
    write(one, 0, 95)
    done = iter(range(step))
    replace_by = Path.replace

    class Killed(BaseException):
        pass

    def replaced(path: Path, target: Path) -> Path:
        if next(done, None) is None:
            raise Killed
        return replace_by(path, target)

    with monkeypatch.context() as patched:
        patched.setattr(Path, "replace", replaced)
        with contextlib.suppress(Killed):
            write(one, 95, 96)
    again = record(tmp_path)
    write(again, 0, FRAMES)
    again.close(whole=True)
    assert (tmp_path / "counts.csv").read_bytes() == (whole / "counts.csv").read_bytes()


def test_a_camera_counts_by_the_hours_of_the_clock_and_only_what_is_committed(tmp_path: Path) -> None:
    one = record(tmp_path, live=True)
    write(one, 0, 120, live=True)
    assert one.keep(bare_snapshot(one, 90))
    again = record(tmp_path, live=True)  # killed: rows 90 to 119 are gone
    write(again, 90, 95, live=True)
    assert again.keep(bare_snapshot(again, 95))
    again.close(whole=False)
    rows = [row for row in rows_of(tmp_path) if row["place"] == PICTURE]
    assert [row["begins"] for row in rows] == ["2023-11-14T22:00:00Z", "2023-11-14T23:00:00Z"]
    assert {row["hour"] for row in rows} == {""}
    assert all(row["local"] for row in rows)
    assert sum(int(row["frames"]) for row in rows) == 95


def test_deleting_what_is_old_leaves_the_counts(tmp_path: Path) -> None:
    tables = []
    for folder in (tmp_path / "all", tmp_path / "newest"):
        one = StreamRecord(folder, "yard", SAVE, rules=RULES, live=True, segment_seconds=3600)
        begin = 0
        for end in (32, 64, 96, 128, 160, FRAMES):
            write(one, begin, end, live=True)
            assert one.keep(bare_snapshot(one, end))
            begin = end
            if folder.name == "newest" and end == 160:
                assert forget_segment(folder, segment_folders(folder)[0].name)
        one.close(whole=True)
        tables.append((folder / "counts.csv").read_bytes())
    said = (tmp_path / "newest/events.jsonl").read_bytes()
    assert len(said) < (tmp_path / "all/events.jsonl").stat().st_size
    assert tables[0] == tables[1]


def row(index: int, status: str = "ok", pts: float | None = None) -> FrameRow:
    return FrameRow(index, float(index) if pts is None else pts, status)  # type: ignore[arg-type]


def situation(*feet: Point) -> Situation:
    return Situation({}, len(feet), {}, feet, (HEIGHT, WIDTH))


def test_a_clock_that_jitters_begins_no_hour_and_one_that_is_set_begins_another() -> None:
    tally = Tally(CountState())
    for index, clock in enumerate((7199.0, 7200.1, 7199.9, 7200.2, 36_000.0, 7300.0)):
        tally.add(row(index), clock, situation())
    assert tally.state.hour is not None
    hours = [*tally.take_closed(), tally.state.hour]
    assert [(one.hour, one.frames) for one in hours] == [(1, 1), (2, 3), (10, 1), (2, 1)]


def test_the_heat_map_has_the_feet_of_every_label_map() -> None:
    tally = Tally(CountState())
    for index in range(3):
        tally.add(row(index), None, situation((0.0, 0.0), (WIDTH - 0.1, HEIGHT - 0.1)))
    assert tally.state.heat == {0: 3, heat_cell((WIDTH - 0.1, HEIGHT - 0.1), (HEIGHT, WIDTH)): 3}
    assert heat_cell((WIDTH + 5.0, 0.0), (HEIGHT, WIDTH)) == HEAT_COLUMNS - 1
