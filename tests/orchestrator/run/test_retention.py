"""``--keep``: what is deleted of cameras' segments, what never is, and what everybody reads afterwards."""

from __future__ import annotations

import json
import resource
import shutil
import time
from dataclasses import replace
from pathlib import Path
from typing import get_args

import pytest
from record_fakes import write_run
from segment_fakes import BEGAN, Camera

from mlbs_actors.errors import ConfigError
from mlbs_actors.record.commits import oldest_frame, read_commits
from mlbs_actors.record.recorded_stream import recorded_stream
from orchestrator.command import run_command
from orchestrator.command_line import command_again, parse
from orchestrator.disk_use.__main__ import main as disk_use
from orchestrator.disk_use.measured import bytes_by_kind, stream_use
from orchestrator.events import carrier as carrier_module
from orchestrator.events import delivery as delivery_module
from orchestrator.events.delivery import Deliveries
from orchestrator.events.event import EventKind
from orchestrator.events.event_filter import EventFilter
from orchestrator.events.senders import DeliveryError, Webhook
from orchestrator.events.targets import EventTarget, parse_target
from orchestrator.events.zones import EventRules, Zone
from orchestrator.report.page import render_report
from orchestrator.run.retention import Retention
from orchestrator.run.retention_limits import Keep, parse_keep, parse_segment
from orchestrator.run.stream_state import StreamState
from orchestrator.sinks.overlay import overlays
from orchestrator.sinks.record import has_snapshot, recorded_frames
from orchestrator.storage import commit_log
from orchestrator.storage.segments import segment_folders

TABLES = frozenset({"masks", "parquet"})
LISTS = ("commits.jsonl", "events.jsonl", "objects.csv", "objects.json", ".objects")


def bytes_in(folder: Path) -> int:
    return sum(bytes_by_kind(folder).values())


def keeping(folder: Path, *limits: str, now: float = 0.0) -> list[str]:
    """Apply limits to a run's folder at a time after the cameras' first frame; return what was said."""
    said: list[str] = []
    Retention(folder, lambda: {None: parse_keep(limits)}, said.append, clock=lambda: BEGAN + now).apply()
    return said


def test_limits_are_an_age_and_a_size() -> None:
    assert parse_keep(["7d"]) == Keep(seconds=7 * 86_400, words=("7d",))
    assert parse_keep(["1.5GB", "36h"]) == Keep(129_600, 1_500_000_000, ("1.5GB", "36h"))
    assert [parse_segment(text) for text in ("hour", "day", "90")] == [3600, 86_400, 90]
    for wrong in (["7"], ["7d", "8d"], ["many"], ["0d"], ["-1GB"]):
        with pytest.raises(ConfigError, match="an age in m, h, d, w, such as 7d, or a size"):
            parse_keep(wrong)
    with pytest.raises(ConfigError, match="hour, day or a whole number of seconds"):
        parse_segment("week")
    arguments = parse(["rtsp://host/x", "--keep", "7d", "--keep", "50GB"])
    assert arguments.segment == 3600
    again = parse(command_again(arguments, "again")[3:])
    assert (again.keep, again.segment) == (arguments.keep, 3600)
    assert parse(["rtsp://host/x"]).segment is None


def test_a_run_without_a_camera_refuses_limits(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command(["demo", "--keep", "7d", "--output", str(tmp_path / "out")]) == 2
    assert capsys.readouterr().err.startswith("--segment and --keep are for cameras, of which")
    assert not (tmp_path / "out").exists()


def test_the_oldest_segments_of_all_cameras_go_until_the_rest_is_small_enough(tmp_path: Path) -> None:
    for name, began in (("gate", BEGAN), ("yard", BEGAN + 25)):
        camera = Camera(tmp_path / name, began=began)
        camera.send(450)
        camera.record.close(whole=False)
    before = bytes_in(tmp_path)
    assert keeping(tmp_path, f"{before / 1e6 * 0.75}MB") == []
    left = {name: [path.name[9:15] for path in segment_folders(tmp_path / name)] for name in ("gate", "yard")}
    assert bytes_in(tmp_path) < 0.75 * before
    assert left["gate"][0] == left["yard"][0] or left["yard"][0] == "140020"  # it has none from before
    assert left["gate"] == [f"1400{seconds}" for seconds in range(int(left["gate"][0][4:]), 50, 10)]
    # The segments that are open, and what a stream goes on from, stay in any case; that is said once.
    said: list[str] = []
    retention = Retention(tmp_path, lambda: {None: Keep(size=1)}, said.append)
    for _ in range(3):
        retention.apply()
    assert [len(segment_folders(tmp_path / name)) for name in ("gate", "yard")] == [1, 1]
    assert len(said) == 1
    assert "there is no closed segment to delete" in said[0]
    again = Camera(tmp_path / "gate")
    assert again.rows == 440
    assert has_snapshot(tmp_path / "gate")


def test_after_a_deletion_a_stream_goes_on_and_everything_reads_what_is_left(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    camera = Camera(tmp_path / "gate")
    camera.send(250)
    keeping(tmp_path, "1m", now=75)  # what ended before second 15
    assert oldest_frame(tmp_path / "gate") == 100
    camera.send(290)
    again = Camera(tmp_path / "gate")
    assert again.rows == 280
    again.send(450)
    again.record.close(whole=False)
    assert recorded_frames(tmp_path / "gate") == 440
    frames = [*recorded_stream(tmp_path / "gate")]
    assert [one.index for one in frames] == [*range(100, 440)]
    objects = json.loads((tmp_path / "gate/objects.json").read_text())["objects"]
    assert [one["path"][0][0] >= 100 for one in objects] == [True] * len(objects)
    assert objects[0]["first"]["frame"] == 0  # it is still there
    write_run(tmp_path, [StreamState("gate", "done", read=440, committed=440)])
    page = render_report(tmp_path)
    assert "Frames before 100, of the time before 2026-11-27 14:00:10 UTC, were deleted." in page
    assert '/20261127T140010Z/overlay-00000120.mp4"' in page
    assert disk_use([str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    assert "50×36    10.0" in printed
    assert "masks 1," in printed


def test_the_overlay_that_a_kill_has_lost_counts_for_no_frames(tmp_path: Path) -> None:
    camera = Camera(tmp_path / "gate")
    camera.send(440)
    camera.record.close(whole=False)
    before = stream_use(tmp_path / "gate")
    for _, lost in overlays(tmp_path / "gate")[:-2]:
        lost.unlink()
    after = stream_use(tmp_path / "gate")
    assert before is not None
    assert after is not None
    assert after.per_frame["overlay"] == pytest.approx(before.per_frame["overlay"], rel=0.3)


def test_a_deletion_that_is_killed_is_finished_by_the_next_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    camera = Camera(tmp_path / "gate", TABLES)
    camera.send(450)

    class Killed(BaseException):
        pass

    def dies(path: Path) -> None:
        (path / "masks.tar").unlink()
        raise Killed

    with monkeypatch.context() as patch:
        patch.setattr(shutil, "rmtree", dies)
        with pytest.raises(Killed):
            keeping(tmp_path, "1m", now=75)
    assert len([*recorded_stream(tmp_path / "gate")]) == 340  # nothing half known
    again = Camera(tmp_path / "gate", TABLES)
    again.send(460)
    keeping(tmp_path, "1m", now=75)
    assert segment_folders(tmp_path / "gate")[0].name == "20261127T140010Z"


def test_a_segment_is_not_deleted_while_a_commit_is_going_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(commit_log, "_BRIEF_SECONDS", 0.05)
    camera = Camera(tmp_path / "gate", TABLES)
    camera.send(250)
    with camera.record._log.exclusive():
        keeping(tmp_path, "1m", now=75)
        assert len(segment_folders(tmp_path / "gate")) == 3
    keeping(tmp_path, "1m", now=75)
    assert len(segment_folders(tmp_path / "gate")) == 2


def test_events_of_what_is_deleted_go_and_the_others_are_delivered(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(delivery_module, "_LOOK_SECONDS", 0.01)
    monkeypatch.setattr(delivery_module, "_GRACE_SECONDS", 200.0)  # until all is delivered
    monkeypatch.setattr(carrier_module, "retry_seconds", lambda failures: 0.01)
    sent: dict[str, list[int]] = {"here": [], "away": []}
    is_back = False

    class Target(Webhook):
        def __init__(self, target: EventTarget) -> None:
            self.name = target.url.rpartition("/")[2]

        def send(self, event: bytes) -> None:
            if self.name == "away" and not is_back:
                raise DeliveryError("it is away")
            sent[self.name].append(json.loads(event)["number"])

    monkeypatch.setattr(carrier_module, "Webhook", Target)
    here = Zone(name="here", polygon=((0, 0), (1, 0), (1, 1), (0, 1)), fixed_to="scene")
    camera = Camera(tmp_path / "gate", TABLES, rules=EventRules((here,)))
    wanted = EventFilter(kinds=get_args(EventKind))
    targets = [replace(parse_target(f"http://host/{name}"), wanted=wanted) for name in sent]
    with Deliveries(targets, tmp_path, lambda text: None) as deliveries:
        camera.send(250)
        keeping(tmp_path, "1m", now=75)
        camera.send(470)
        lines = [json.loads(line) for line in (tmp_path / "gate/events.jsonl").read_text().splitlines()]
        while [backlog.waiting for backlog in deliveries.backlogs()] != [0, len(lines)]:
            time.sleep(0.01)
        is_back = True
    assert lines[0]["frame"] >= 100
    assert [one["number"] for one in lines] == [*range(lines[0]["number"], lines[-1]["number"] + 1)]
    assert sent["here"] == sorted(set(sent["here"]))
    assert sent["here"][-1] == lines[-1]["number"]
    assert sent["away"] == [one["number"] for one in lines]
    pictures = {f"events/{path.name}" for path in (tmp_path / "gate/events").iterdir()}
    assert pictures == {one["picture"] for one in lines} - {None}
    assert (tmp_path / "gate/.views/00000000.npz").exists()  # the scene is still found by it
    again = Camera(tmp_path / "gate", TABLES, rules=EventRules((here,)))  # goes back to row 460
    again.send(600)
    after = [json.loads(line)["number"] for line in (tmp_path / "gate/events.jsonl").read_text().splitlines()]
    assert after == [*range(lines[0]["number"], after[-1] + 1)]


def simulate(folder: Path, hours: int, rate: float, keep: str, look: int) -> dict[str, list[float]]:
    """Replay some hours of a camera, and apply a limit after every ``look`` frames; return what it took."""
    said: list[str] = []
    found: dict[str, list[float]] = {"disk": [], "memory": [], "lists": []}
    camera = Camera(folder / "gate", frozenset({"masks", "parquet", "overlay"}), rate=rate, seconds=3600)
    retention = Retention(folder, lambda: {None: parse_keep([keep])}, said.append, clock=lambda: camera.now)
    for end in range(look, round(hours * 3600 * rate) + 1, look):
        camera.send(end)
        retention.apply()
        found["disk"].append(bytes_in(folder))
        found["memory"].append(_resident_bytes())
        found["lists"].append(sum((folder / "gate" / name).stat().st_size for name in LISTS))
    camera.record.close(whole=False)
    assert said == []
    return found


def _resident_bytes() -> int:
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * resource.getpagesize()


@pytest.mark.long
def test_the_disk_that_half_a_day_takes_is_bounded(tmp_path: Path) -> None:
    found = simulate(tmp_path, hours=12, rate=0.05, keep="1MB", look=60)
    assert max(found["disk"]) < 1e6
    assert oldest_frame(tmp_path / "gate") > 1000
    assert max(found["lists"][-10:]) < 1.3 * max(found["lists"][10:20])


@pytest.mark.long
@pytest.mark.timeout(1800)
def test_a_week_takes_bounded_disk_and_memory_and_its_page_is_quick(tmp_path: Path) -> None:
    found = simulate(tmp_path, hours=7 * 24, rate=0.1, keep="8MB", look=90)
    quarter = len(found["disk"]) // 4
    write_run(tmp_path, [StreamState("gate", "running", read=60_480, committed=60_480)])
    began = time.monotonic()
    page = render_report(tmp_path)
    seconds = time.monotonic() - began
    for name, values in found.items():
        print(f"{name}: {values[quarter]:,.0f} after a quarter, {values[-1]:,.0f} at the end", end="; ")
    left, commits = len(segment_folders(tmp_path / "gate")), len(read_commits(tmp_path / "gate"))
    print(f"page: {len(page):,} bytes in {seconds:.1f} s; {left} segments and {commits} commits are left")
    assert max(found["disk"]) < 8e6
    assert max(found["lists"][quarter:]) < 1.5 * max(found["lists"][:quarter])
    assert found["memory"][-1] - found["memory"][quarter] < 20e6
