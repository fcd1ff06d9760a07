"""Every event that names a clip gets it, whatever is killed."""

from __future__ import annotations

import json
import os
import signal
import time
from collections.abc import Callable
from datetime import datetime, timezone
from pathlib import Path

import av
import pytest
from coded_video import record, write_video

from orchestrator.clips import cutter as cutter_module
from orchestrator.clips.clips import Clips
from orchestrator.clips.cutter import Cutter, CutterLostError
from orchestrator.clips.packet_ring import PACKETS, PacketRing
from orchestrator.clips.settings import ClipSettings
from orchestrator.events.file_names import clip_name, forget_clips_before

BEGAN = 1_700_000_000.0
SETTINGS = ClipSettings(before=3, after=3)


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """The folder of a run whose camera ``gate`` has sent 30 seconds."""
    video = write_video(tmp_path / "video.mp4", 30)
    record(video, PacketRing(tmp_path / "out/gate" / PACKETS, 1e10), BEGAN)
    return tmp_path / "out"


def event(frame: int, seconds: float, *, live: bool = True, clip: bool = True) -> tuple[str, str | None]:
    """An event's line, and the clip that it names."""
    clock = datetime.fromtimestamp(BEGAN + seconds, timezone.utc).isoformat(timespec="milliseconds")
    name = clip_name(frame, f"gate/{frame}") if clip else None
    line = {"id": f"gate/{frame}", "frame": frame, "time": seconds, "clock": clock if live else None}
    return json.dumps(line | {"clip": name}) + "\n", name


def say_nothing(sentence: str) -> None:
    raise AssertionError(sentence)


def clips(
    run: Path,
    *,
    now: Callable[[], float] = lambda: BEGAN + 1e6,
    video: Path | None = None,
    say: Callable[[str], None] = say_nothing,
    settings: ClipSettings = SETTINGS,
) -> Clips:
    return Clips(settings, run, lambda name: video, say, now)


def wait_for(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 60
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def names(run: Path) -> set[str]:
    return {f"clips/{path.name}" for path in (run / "gate/clips").glob("*")}


def length(path: Path) -> float:
    with av.open(str(path)) as container:
        return float((container.duration or 0) / av.time_base)


def test_an_event_gets_its_clip_once_what_follows_has_been_taken(run: Path) -> None:
    line, name = event(50, 10)
    other, _ = event(51, 10.2, clip=False)
    (run / "gate/events.jsonl").write_text(line + other)
    now = [BEGAN + 12.0]
    with clips(run, now=lambda: now[0]):
        time.sleep(0.1)
        assert not names(run)
        now[0] = BEGAN + 20
        wait_for(lambda: names(run) == {name})
    assert length(run / "gate" / str(name)) == pytest.approx(7, abs=1.1)  # from the key frame before


def test_the_end_of_a_run_makes_what_is_owed_with_what_there_is(run: Path) -> None:
    line, name = event(140, 28)
    (run / "gate/events.jsonl").write_text(line)
    with clips(run, now=lambda: BEGAN):
        pass
    assert names(run) == {name}


def test_a_run_that_goes_on_makes_what_a_killed_one_has_left(run: Path) -> None:
    lines = [event(10 * seconds, seconds) for seconds in (5, 15, 25)]
    (run / "gate/events.jsonl").write_text("".join(line for line, _ in lines))
    done = run / "gate" / str(lines[0][1])
    done.parent.mkdir()
    done.write_bytes(b"made before")
    (done.parent / ".x.mp4.abc.part").write_bytes(b"never finished")
    with clips(run):
        pass
    assert names(run) == {name for _, name in lines}
    assert done.read_bytes() == b"made before"


def test_lines_that_are_appended_or_replaced_are_found(run: Path) -> None:
    path = run / "gate/events.jsonl"
    (first, a), (second, b), (third, c) = (event(10 * seconds, seconds) for seconds in (3, 13, 23))
    path.write_text(first)
    with clips(run):
        wait_for(lambda: names(run) == {a})
        with path.open("a") as file:
            file.write(second[:20])
            file.flush()
            file.write(second[20:])
        wait_for(lambda: names(run) == {a, b})
        path.write_text(first + third)  # a stream that goes back replaces what was not committed
        wait_for(lambda: names(run) == {a, b, c})


def test_a_cutter_that_is_killed_is_started_again(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = Cutter._started
    lost: list[int] = []

    def started(cutter: Cutter) -> object:
        process = whole(cutter)
        if not lost:
            os.kill(process.pid, signal.SIGKILL)
            lost.append(process.wait())
        return process

    monkeypatch.setattr(Cutter, "_started", started)
    line, name = event(50, 10)
    (run / "gate/events.jsonl").write_text(line)
    with clips(run):
        pass
    assert lost == [-signal.SIGKILL]
    assert names(run) == {name}


def test_a_clip_at_which_the_cutter_is_lost_each_time_is_given_up_and_the_next_one_made(
    run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (bad, _), (good, name) = event(50, 5), event(100, 20)
    (run / "gate/events.jsonl").write_text(bad + good)
    whole = Cutter.cut
    said: list[str] = []

    def cut(cutter: Cutter, request: object) -> str | None:
        if request.begin < BEGAN + 10:  # type: ignore[attr-defined]
            raise CutterLostError(was_late=False)
        return whole(cutter, request)  # type: ignore[arg-type]

    monkeypatch.setattr(Cutter, "cut", cut)
    with clips(run, say=said.append):
        pass
    assert names(run) == {name}
    assert said == ["A clip of gate cannot be made: the process that cuts it was lost."]


def test_a_fault_is_said_once_and_names_what_it_is(run: Path) -> None:
    lines = [event(10 * seconds, seconds)[0] for seconds in (3, 13, 23)]
    (run / "gate/events.jsonl").write_text("".join(lines))
    (run / "gate/clips").write_bytes(b"in the way")
    said: list[str] = []
    with clips(run, say=said.append):
        pass
    assert said == ["A clip of gate cannot be made: File exists."]


def test_without_packets_nothing_is_said(run: Path) -> None:
    (run / "gate/events.jsonl").write_text(event(50, 1000)[0])
    with clips(run):
        pass
    assert not names(run)


def test_clips_of_a_video_come_from_the_video(run: Path, tmp_path: Path) -> None:
    line, name = event(50, 10, live=False)
    (run / "gate/events.jsonl").write_text(line)
    with clips(run, video=tmp_path / "video.mp4", now=lambda: 0.0):
        wait_for(lambda: names(run) == {name})


def test_clips_of_events_that_are_deleted_go_with_them(run: Path) -> None:
    lines = [event(10 * seconds, seconds) for seconds in (3, 13, 23)]
    (run / "gate/events.jsonl").write_text("".join(line for line, _ in lines))
    with clips(run):
        pass
    forget_clips_before(run / "gate", 130)
    assert names(run) == {name for _, name in lines[1:]}


def test_only_the_newest_clips_are_made_and_kept(run: Path) -> None:
    lines = [event(10 * seconds, seconds) for seconds in (3, 13, 23)]
    (run / "gate/events.jsonl").write_text("".join(line for line, _ in lines))
    settings = ClipSettings(before=3, after=3, most=2)
    for _ in range(2):
        with clips(run, settings=settings):
            pass
        assert names(run) == {name for _, name in lines[1:]}


def test_a_clip_that_takes_too_long_is_given_up_and_the_next_one_made(
    run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (bad, _), (good, name) = event(50, 5), event(100, 20)
    (run / "gate/events.jsonl").write_text(bad + good)
    whole = Cutter._started
    hung: list[int] = []
    said: list[str] = []

    def started(cutter: Cutter) -> object:
        process = whole(cutter)
        monkeypatch.setattr(cutter_module, "_LONGEST_SECONDS", 200.0 if hung else 0.1)
        if not hung:
            os.kill(process.pid, signal.SIGSTOP)
            hung.append(process.pid)
        return process

    monkeypatch.setattr(Cutter, "_started", started)
    with clips(run, say=said.append):
        wait_for(lambda: names(run) == {name})
    assert said == ["A clip of gate cannot be made: the process that cuts it took more than 0.1 s."]
    with pytest.raises(ProcessLookupError):
        os.kill(hung[0], 0)


def test_a_folder_that_cannot_be_read_holds_no_other_stream_up(run: Path) -> None:
    (run / "a/events.jsonl").mkdir(parents=True)
    line, name = event(50, 10)
    (run / "gate/events.jsonl").write_text(line)
    with clips(run):
        pass
    assert names(run) == {name}


def test_clips_of_long_runs_go_in_the_order_of_their_frames(tmp_path: Path) -> None:
    folder = tmp_path / "gate"
    (folder / "clips").mkdir(parents=True)
    for frame in (99_990_000, 100_000_010, 100_000_020):
        (folder / clip_name(frame, "x")).write_bytes(b"")
    (folder / "clips/by hand.mp4").write_bytes(b"")
    forget_clips_before(folder, 99_999_999)
    assert names(tmp_path) == {clip_name(100_000_010, "x"), clip_name(100_000_020, "x"), "clips/by hand.mp4"}
    forget_clips_before(folder, 100_000_020)
    assert names(tmp_path) == {clip_name(100_000_020, "x"), "clips/by hand.mp4"}
