"""``events.jsonl`` as part of a record that is killed and opened again."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import pytest
from record_fakes import bare_snapshot, frame, segmentation

from orchestrator.events.rules import Rule
from orchestrator.events.zones import EventRules, Zone
from orchestrator.sinks.record import StreamRecord

ZONE = Zone(name="middle", polygon=((10, 0), (20, 0), (20, 36), (10, 36)))
RULES = EventRules((ZONE,), remembered=4)
SAVE = frozenset({"parquet"})
FRAMES = 100


def record(folder: Path, *, live: bool = False, rules: EventRules = RULES) -> StreamRecord:
    return StreamRecord(folder, "yard", SAVE, rules=rules, live=live)


def write(one: StreamRecord, begin: int, end: int) -> None:
    """Object 3 walks to the right, again and again; 5 is away every other eight frames."""
    for index in range(begin, end):
        if index == 50:
            one.gap(index, index / 10, "gap")
        else:
            one.write(segmentation(index, 3, *([5] if index // 8 % 2 else [])), frame(index))


def lines(folder: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (folder / "events.jsonl").read_text().splitlines()]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """The events without a kill."""
    folder = tmp_path_factory.mktemp("whole")
    one = record(folder)
    write(one, 0, FRAMES)
    one.close(whole=True)
    return (folder / "events.jsonl").read_bytes()


def test_a_line_holds_what_happened(whole: bytes) -> None:
    said = [json.loads(line) for line in whole.splitlines()]
    assert {one["kind"] for one in said} >= {"born", "entered", "left", "ended", "stream lost", "stream back"}
    entered = next(one for one in said if one["kind"] == "entered")
    assert entered == {
        "id": "yard/6/0.600/entered/3/middle",
        "stream": "yard",
        "kind": "entered",
        "frame": 6,
        "time": 0.6,
        "clock": None,
        "object": 3,
        "box": [6, 5, 8, 10],
        "zone": "middle",
        "direction": None,
        "dropped_share": None,
        "rule": None,
        "objects": None,
        "score": 0.5,
        "area": 80,
        "seconds": 0.6,
        "reason": None,
        "replaced_by": None,
        "was": None,
        "now": None,
        "picture": "events/00000008-3.jpg",
        "clip": None,
        "number": 3,
    }
    assert [one["number"] for one in said] == [*range(1, len(said) + 1)]
    with_picture = {one["kind"] for one in said if one["picture"] is not None}
    assert with_picture == {"born", "entered", "left"}
    assert len({one["id"] for one in said}) == len(said)
    assert {one["reason"] for one in said if one["kind"] == "ended"} == {
        "no longer found",
        "end of the stream",
    }


def test_a_line_names_a_picture_of_the_object_and_old_ones_are_deleted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("orchestrator.events.pictures._MOST_PICTURES", 5)
    one = record(tmp_path)
    for index in range(60):
        shown = frame(index)
        assert shown.image is not None
        picture = shown.image.copy()
        picture[segmentation(index).labels == 3] = (0, 0, 200)
        one.write(segmentation(index, 3), replace(shown, image=picture))
        if index == 8:
            cut_out = cv2.imread(str(tmp_path / "events/00000008-3.jpg"))
            assert cut_out is not None
            assert cut_out.shape == (480, 384, 3)  # twice the box, 24 times as large
            red = cut_out[..., 2].astype(int) - cut_out[..., 0] > 100
            assert red[140:340, 110:280].mean() > 0.8  # the zone is drawn over it
            assert not red[:90].any()
    there = sorted(path.name for path in (tmp_path / "events").iterdir())
    named = [event["picture"] for event in lines(tmp_path) if event["picture"] is not None]
    assert [f"events/{name}" for name in there] == list(dict.fromkeys(named))[-5:]


def test_without_zones_there_are_no_pictures(tmp_path: Path) -> None:
    one = StreamRecord(tmp_path, "yard", SAVE)
    write(one, 0, 9)
    assert {event["picture"] for event in lines(tmp_path)} == {None}
    assert not (tmp_path / "events").exists()


@pytest.mark.parametrize("killed_after", [1, 8, 9, 20, 31, 32, 33, 57, 99])
def test_a_killed_record_goes_on_with_the_same_lines(tmp_path: Path, whole: bytes, killed_after: int) -> None:
    write(record(tmp_path), 0, killed_after)
    again = record(tmp_path)
    write(again, 0, FRAMES)  # those that are committed are skipped
    again.close(whole=True)
    assert (tmp_path / "events.jsonl").read_bytes() == whole


def test_a_kill_between_the_events_and_their_commit_changes_nothing(tmp_path: Path, whole: bytes) -> None:
    one = record(tmp_path)
    write(one, 0, 64)
    log = tmp_path / "commits.jsonl"
    log.write_bytes(b"".join(log.read_bytes().splitlines(keepends=True)[:-1]))
    again = record(tmp_path)
    write(again, 0, FRAMES)
    again.close(whole=True)
    assert (tmp_path / "events.jsonl").read_bytes() == whole


def test_an_interrupted_record_replaces_what_was_provisional(tmp_path: Path, whole: bytes) -> None:
    one = record(tmp_path)
    write(one, 0, 40)
    one.provisional()
    write(one, 40, 44)
    one.close(whole=False)
    again = record(tmp_path)
    write(again, 0, FRAMES)
    again.close(whole=True)
    assert (tmp_path / "events.jsonl").read_bytes() == whole


def test_a_record_that_was_closed_as_whole_may_be_closed_again(tmp_path: Path, whole: bytes) -> None:
    for _ in range(2):
        one = record(tmp_path)
        write(one, 0, FRAMES)
        one.close(whole=True)
    assert (tmp_path / "events.jsonl").read_bytes() == whole


def test_events_of_a_camera_are_there_before_their_commit_and_go_without_it(tmp_path: Path) -> None:
    one = record(tmp_path, live=True)
    write(one, 0, 9)
    assert one.keep(bare_snapshot(one, 9))
    write(one, 9, 20)
    before = lines(tmp_path)
    assert {event["frame"] for event in before} >= {0, 6, 16}
    again = record(tmp_path, live=True)  # frames 9 to 19 are gone for ever
    # What was certain by frame 8: there object 5 is born, and object 3 has been in the zone for a moment.
    assert lines(tmp_path) == before[:4]
    assert [event["frame"] for event in before[:4]] == [0, 0, 6, 8]
    again.gap(9, 30.0, "gap")
    assert lines(tmp_path)[-1]["kind"] == "stream lost"


def in_zones(events: list[dict[str, Any]]) -> list[tuple[str, int, str, str | None]]:
    """What object 3 does in zones."""
    keys = ("kind", "frame", "zone", "reason")
    return [tuple(one[key] for key in keys) for one in events if one["object"] == 3 and one["zone"]]


RIGHT = ((24, 0), (34, 0), (34, 36), (24, 36))


@pytest.mark.parametrize("name", ["middle", "right"])
def test_a_record_that_is_opened_with_other_zones_follows_them_and_says_so(tmp_path: Path, name: str) -> None:
    one = record(tmp_path, live=True)
    write(one, 0, 14)  # object 3 has been in the zone since frame 6
    assert one.keep(bare_snapshot(one, 14))
    before = lines(tmp_path)
    other = replace(RULES, zones=(Zone(name=name, polygon=RIGHT),))
    again = record(tmp_path, live=True, rules=other)
    write(again, 14, 26)
    said = lines(tmp_path)[len(before) :]
    assert (said[0]["kind"], said[0]["frame"], said[0]["time"]) == ("configured", 13, 1.3)
    (was,), (now,) = said[0]["was"].items(), said[0]["now"].items()
    assert (was[0], now[0]) == ("zones.middle", f"zones.{name}")
    assert (was[1]["polygon"][0], now[1]["polygon"]) == ([10, 0], [list(point) for point in RIGHT])
    left = ("left", 13, "middle", "the zone is gone") if name == "right" else ("left", 14, "middle", None)
    assert in_zones(said) == [left, ("entered", 20, name, None)]
    # Killed before a commit, it says the same again; afterwards nothing more of it.
    ids = [event["id"] for event in lines(tmp_path)]
    again = record(tmp_path, live=True, rules=other)
    write(again, 14, 26)
    assert [event["id"] for event in lines(tmp_path)] == ids
    assert again.keep(bare_snapshot(again, 26))
    record(tmp_path, live=True, rules=other)
    assert [event["id"] for event in lines(tmp_path)] == ids


def test_a_record_follows_other_zones_in_the_middle_and_goes_on_by_them_after_a_kill(tmp_path: Path) -> None:
    one = record(tmp_path, live=True)
    write(one, 0, 14)
    one.configure(replace(RULES, zones=(Zone(name="right", polygon=RIGHT),)))
    write(one, 14, 26)
    said = lines(tmp_path)
    assert [event["kind"] for event in said].count("configured") == 1
    assert in_zones(said) == [
        ("entered", 6, "middle", None),
        ("left", 13, "middle", "the zone is gone"),
        ("entered", 20, "right", None),
    ]
    assert next(event for event in said if event["zone"] == "right")["picture"]
    assert one.keep(bare_snapshot(one, 20))
    record(tmp_path, live=True, rules=replace(RULES, zones=(Zone(name="right", polygon=RIGHT),)))
    kept = lines(tmp_path)
    assert kept == said[: len(kept)]
    assert "configured" in {event["kind"] for event in kept}


def test_a_reader_of_events_sees_which_settings_have_changed_and_what_they_were(tmp_path: Path) -> None:
    asked = [
        replace(RULES, settings=digest, told=told)
        for digest, told in (
            ("a", {"max_side": None, "save": ["masks"], "layers.lookahead": 3}),
            ("b", {"max_side": 960, "save": ["masks"]}),
            ("c", {"max_side": 960, "save": ["masks", "parquet"]}),
        )
    ]
    one = record(tmp_path, live=True, rules=asked[0])
    write(one, 0, 14)
    one.configure(asked[1])
    write(one, 14, 20)
    assert one.keep(bare_snapshot(one, 20))
    write(record(tmp_path, live=True, rules=asked[2]), 20, 30)
    first, second = [event for event in lines(tmp_path) if event["kind"] == "configured"]
    assert (first["was"], first["now"]) == ({"max_side": None, "layers.lookahead": 3}, {"max_side": 960})
    assert (second["was"], second["now"]) == ({"save": ["masks"]}, {"save": ["masks", "parquet"]})


@pytest.mark.parametrize("kept_before", [True, False])
def test_a_lost_camera_is_said_while_it_is_away_and_once(tmp_path: Path, kept_before: bool) -> None:
    one = record(tmp_path, live=True)
    write(one, 0, 9)
    if kept_before:
        assert one.keep(bare_snapshot(one, 9))
    one.silent()
    [lost] = [event for event in lines(tmp_path) if event["kind"] == "stream lost"]
    assert (lost["frame"], lost["time"]) == (9, 0.8)
    if not kept_before:
        assert one.keep(bare_snapshot(one, 9))
    one.gap(9, 0.8, "gap")
    one.write(segmentation(10, 3), frame(10))
    whole = lines(tmp_path)
    assert [event["kind"] for event in whole[-2:]] == ["stream lost", "stream back"]
    again = record(tmp_path, live=True)  # killed after it was back
    again.gap(9, 0.8, "gap")
    again.write(segmentation(10, 3), frame(10))
    assert [event["id"] for event in lines(tmp_path)] == [event["id"] for event in whole]


def test_events_of_a_camera_have_the_time_of_day_at_which_it_took_their_frames(tmp_path: Path) -> None:
    one = record(tmp_path, live=True)
    for index in range(9):
        taken = replace(frame(index), taken=1_000_000_000.0 + index / 10)
        one.write(segmentation(index, 3), taken)
    clocks = {event["kind"]: event["clock"] for event in lines(tmp_path)}
    assert clocks["born"] == "2001-09-09T01:46:40.000+00:00"
    assert clocks["entered"] == "2001-09-09T01:46:40.600+00:00"  # frame 6


STAYS = Rule.model_validate(
    {
        "name": "stays at noon",
        "dwell": {"zone": "middle", "seconds": 0.5},
        "cool_down": 5,
        "schedule": {"from": "12:00", "to": "13:00", "timezone": "UTC"},
    }
)

#: 2026-06-01, 12:00 UTC.
NOON = 1_780_315_200.0


def test_a_rule_has_a_line_of_its_own_with_a_picture(tmp_path: Path) -> None:
    one = record(tmp_path, live=True, rules=replace(RULES, rules=(STAYS,)))
    for index in range(FRAMES):
        one.write(segmentation(index, 3), replace(frame(index), taken=NOON + index / 10))
    first, second = (event for event in lines(tmp_path) if event["kind"] == "rule")
    assert first | {"number": 0} == {
        "id": "yard/11/1.100/rule/3/middle/stays at noon",
        "stream": "yard",
        "kind": "rule",
        "frame": 11,
        "time": 1.1,
        "clock": "2026-06-01T12:00:01.100+00:00",
        "object": 3,
        "box": [11, 5, 8, 10],
        "zone": "middle",
        "direction": None,
        "dropped_share": None,
        "rule": "stays at noon",
        "objects": [3],
        "score": 0.5,
        "area": 80,
        "seconds": 0.5,
        "reason": None,
        "replaced_by": None,
        "was": None,
        "now": None,
        "picture": "events/00000011-3.jpg",
        "clip": None,
        "number": 0,
    }
    assert second["frame"] == 71
    assert (tmp_path / first["picture"]).exists()


@pytest.mark.parametrize("killed_after", [9, 13, 60, 71, 73])
def test_the_cool_down_of_a_rule_outlives_a_kill(tmp_path: Path, killed_after: int) -> None:
    rules = replace(RULES, rules=(STAYS.model_copy(update={"schedule": None}),))
    said = []
    for name, kill in (("whole", 0), ("killed", killed_after)):
        write(record(tmp_path / name, rules=rules), 0, kill)
        one = record(tmp_path / name, rules=rules)
        write(one, 0, FRAMES)
        one.close(whole=True)
        said.append((tmp_path / name / "events.jsonl").read_bytes())
    assert said[0] == said[1]
    assert said[0].count(b'"kind": "rule"') == 2


def test_seconds_of_left_are_those_in_the_zone(whole: bytes) -> None:
    said = [json.loads(line) for line in whole.splitlines()]
    [entered, left, *_] = [one for one in said if one["object"] == 3 and one["zone"] is not None]
    assert (entered["kind"], left["kind"]) == ("entered", "left")
    assert left["seconds"] == pytest.approx(left["time"] - entered["time"])
    assert entered["seconds"] == entered["time"]  # born in the first frame


def test_marks_of_an_earlier_version_are_gone_on_from(tmp_path: Path, whole: bytes) -> None:
    write(record(tmp_path), 0, 40)
    marks = json.loads((tmp_path / ".events").read_bytes())
    for mark in marks:
        for key in ("rules", "faults"):
            del mark["state"][key]
        for one in mark["state"]["objects"].values():
            del one["score"], one["area"]
    (tmp_path / ".events").write_text(json.dumps(marks))
    again = record(tmp_path)
    write(again, 0, FRAMES)
    again.close(whole=True)
    masks = {"score": None, "area": None}  # of an object that is away, the newest mask is not known
    assert [one | masks for one in lines(tmp_path)] == [json.loads(one) | masks for one in whole.splitlines()]


def test_of_the_chosen_kinds_each_event_names_a_clip_of_its_own_and_always_the_same(tmp_path: Path) -> None:
    rules = replace(RULES, clips=frozenset({"entered", "left"}))
    for folder in (tmp_path / "once", tmp_path / "again"):
        one = record(folder, rules=rules)
        write(one, 0, 60)
        one.close(whole=True)
    said = lines(tmp_path / "once")
    clips = [event["clip"] for event in said if event["clip"] is not None]
    assert {event["kind"] for event in said if event["clip"] is not None} == {"entered", "left"}
    assert len(set(clips)) == len(clips) > 3
    assert [event["clip"] for event in lines(tmp_path / "again")] == [event["clip"] for event in said]


def test_whether_events_have_clips_makes_no_other_rules(tmp_path: Path) -> None:
    assert replace(RULES, clips=frozenset({"entered"})).digest == RULES.digest
