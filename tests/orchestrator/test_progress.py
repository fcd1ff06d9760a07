"""What is shown while a run goes on."""

from __future__ import annotations

import io
import json
import sys
from dataclasses import replace
from datetime import datetime, timezone

import pytest
from rich.console import Console

from orchestrator.log import Log, LogFormat
from orchestrator.progress import JsonLines, LiveTable, PlainLines, progress_for
from orchestrator.run.stream_state import StreamState, after_start


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def log(form: LogFormat = "json") -> Log:
    return Log(form, "/out", lambda: datetime(2026, 1, 2, 3, 4, 5, 678901, timezone.utc))


def lines(output: io.StringIO) -> list[dict[str, object]]:
    return [json.loads(line) for line in output.getvalue().splitlines()]


def test_each_change_of_state_is_a_json_line_if_those_are_wanted_on_a_terminal_too() -> None:
    for output in (io.StringIO(), Terminal()):
        progress = progress_for(output, log())
        progress.update([StreamState("a"), StreamState("b")])
        progress.update([StreamState("a", "starting"), StreamState("b")])
        progress.update([StreamState("a", "failed", error="It is gone."), StreamState("b")])
        progress.close()
        assert [(line["stream"], line["state"], line["level"]) for line in lines(output)] == [
            ("a", "waiting", "info"),
            ("b", "waiting", "info"),
            ("a", "starting", "info"),
            ("a", "failed", "error"),
        ]
        assert lines(output)[-1]["error"] == "It is gone."


def test_a_json_line_says_when_of_which_run_and_stream_and_what_it_is_about() -> None:
    output = io.StringIO()
    progress = JsonLines(output, log(), lambda: 0.0)
    progress.update([StreamState("a", "reconnecting", read=7, error="It is off.")])
    head = {
        "time": "2026-01-02T03:04:05.678Z",
        "level": "warning",
        "run": "/out",
        "stream": "a",
        "event": "state",
    }
    assert list(lines(output)[0])[:5] == list(head)
    assert lines(output)[0].items() >= (head | {"state": "reconnecting", "read": 7}).items()
    assert lines(output)[0]["message"] == "a: reconnecting, 7 frames: It is off."


def test_a_running_stream_gets_a_json_line_every_five_seconds_if_it_moves() -> None:
    output, now = io.StringIO(), [0.0]
    progress = JsonLines(output, log(), lambda: now[0])
    for second in range(31):
        now[0] = float(second)
        progress.update([StreamState("a", "running", read=min(second, 20))])
    assert [line["read"] for line in lines(output)] == [0, 5, 10, 15, 20]
    assert [line["event"] for line in lines(output)] == ["state", *["progress"] * 4]


def test_away_from_a_terminal_a_change_is_a_line_to_read() -> None:
    output = io.StringIO()
    progress = progress_for(output, log("text"))
    running = StreamState("a", "running", read=48, length=120, layers=4, objects=3, frames_per_second=16.0)
    progress.update([StreamState("a")])
    progress.update([after_start(StreamState("a"))])
    progress.update([running])
    progress.update([replace(running, read=50)])  # nothing that one must know at once
    progress.update([replace(running, state="partial", read=60, quarantined=1, error="It is cut off.")])
    progress.close()
    assert output.getvalue().splitlines() == [
        "a: starting: waits for its processes and its first frames",
        "a: running, 48 of 120 frames, 16.0 frames/s, 3 objects, 0:00:04 left",
        "a: partial, 60 frames, 16.0 frames/s, 1 lost: It is cut off.",
    ]


def test_a_running_stream_gets_a_line_to_read_every_half_minute_and_so_do_several_together() -> None:
    output, now = io.StringIO(), [0.0]
    progress = PlainLines(output, log("text"), lambda: now[0])
    for second in range(61):
        now[0] = float(second)
        progress.update(
            [
                StreamState("a", "running", read=second, length=600),
                StreamState("b", "done", read=9, committed=9, length=9),
            ]
        )
    assert output.getvalue().splitlines() == [
        "a: running",
        "b: done, 9 frames",
        "a: running, 30 of 600 frames",
        "1 running, 1 done; 39 frames read, 9 committed, 0.0 frames/s, 0:09:50 left",
        "a: running, 60 of 600 frames",
        "1 running, 1 done; 69 frames read, 9 committed, 0.0 frames/s, 0:09:00 left",
    ]


def test_streams_that_wait_are_summed_up_at_once_for_a_new_reason_else_now_and_then() -> None:
    output, now = io.StringIO(), [0.0]
    progress = PlainLines(output, log("text"), lambda: now[0])
    for count, reason in ((3, "places"), (2, "places"), (2, "memory")):
        progress.update([StreamState(f"w{number}", waits_for=reason) for number in range(count)])
    now[0] = 40.0
    progress.update([StreamState("w", waits_for="memory")])
    assert output.getvalue().splitlines() == [
        "3 streams waiting for places",
        "2 streams waiting for memory",
        "1 stream waiting for memory",
    ]


def table(states: list[StreamState], height: int = 40, width: int = 110) -> str:
    console = Console(file=io.StringIO(), force_terminal=True, width=width, height=height, no_color=True)
    progress = LiveTable(console, lambda: 0.0, refresh=False)
    progress.update(states)
    progress.close()
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue()


def test_the_table_shows_frames_rate_objects_state_and_faults() -> None:
    shown = table(
        [
            StreamState(
                "yard", "running", read=120, committed=96, layers=9, objects=4, frames_per_second=17.25
            ),
            StreamState("[red]x", "failed", error="The file [b]is gone."),
        ]
    )
    for text in ("yard", "running", "120", "96", "17.2", " 4 ", "[red]x", "The file [b]is gone."):
        assert text in shown
    assert " 9 " not in shown  # a layer without a pixel is no object, nor is the background


def test_the_table_shows_how_much_is_left_where_that_is_known_and_what_a_start_waits_for() -> None:
    running = StreamState("yard", "running", read=120, frames_per_second=2.0, length=600)
    reason = "one of the 2 places, which are taken"
    waiting = [StreamState(f"w{number}", waits_for=reason) for number in range(3)]
    gate = after_start(StreamState("gate"))
    shown = table([running, gate, StreamState("cam", "running", read=9), *waiting])
    for text in ("120 of 600", "0:04:00", "gate: waits for its processes", f"3 streams waiting for {reason}"):
        assert text in shown
    assert "9 of" not in shown
    done = replace(running, state="done", read=590, frames_per_second=0.0)
    assert "of 600" not in table([done])  # the header was wrong, and the stream is whole


def test_the_table_says_which_streams_the_memory_is_too_small_for() -> None:
    assert "up to 5 layers at once had no process" in table(
        [StreamState("crowd", "running", without_process=5)]
    )


def test_on_a_narrow_terminal_a_note_is_still_a_sentence_and_what_is_shown_fits() -> None:
    states = [
        StreamState(f"w{number}", "running", read=1234, committed=1200, frames_per_second=17.25, length=12345)
        for number in range(9)
    ]
    states += [
        StreamState(f"b{number}", "failed", error=f"The file {number} is gone.") for number in range(9)
    ]
    shown = table([*states, StreamState("gate", "starting")], height=24, width=80)
    assert "b0: The file 0 is gone.\n" in shown.replace("\r", "").replace(" \n", "\n")
    last = shown[shown.rindex("stream") :].splitlines()[:-1]  # the last one gives the cursor back
    assert len(last) < 24
    assert "frames/s" in last[-1]
    assert "12345" in last[2]


def test_the_table_adds_up_what_all_streams_have_done() -> None:
    shown = table(
        [
            StreamState("a", "running", read=120, committed=96, frames_per_second=4.25),
            StreamState("b", "running", read=30, committed=8, frames_per_second=2.0),
            StreamState("c"),
        ]
    )
    assert "150 frames read, 104 committed, 6.2 frames/s" in shown


def test_the_table_shows_how_long_all_files_together_take_at_the_rate_of_the_last_half_minute() -> None:
    now = 0.0
    console = Console(file=io.StringIO(), force_terminal=True, width=110, height=40, no_color=True)
    progress = LiveTable(console, lambda: now, refresh=False)
    others = [
        StreamState("waits", length=1500),
        StreamState("ended", "done", read=70, length=70),
        StreamState("camera", "running", read=900),
    ]

    def shown(read: int, *more: StreamState) -> str:
        progress.update([StreamState("a", "running", read=read, length=2000), *others, *more])
        with console.capture() as captured:
            console.print(progress._live.get_renderable())
        return captured.get()

    assert " left" not in shown(1000).partition("frames read")[2]
    now = 10.0
    assert "frames/s, 0:04:00 left" in shown(1100)  # 900 + 1500 at 10 a second
    assert "frames/s, more than 0:04:00 left" in shown(1100, StreamState("unknown"))
    now = 50.0
    assert " left" not in shown(1100).partition("frames read")[2]  # nothing was read for long
    progress.close()


def test_a_table_of_more_streams_than_fit_shows_those_at_work_and_counts_the_others() -> None:
    states = [StreamState(f"w{number}") for number in range(200)]
    states[150] = StreamState("busy", "running", read=5)
    states[151] = StreamState("broken", "failed", error="It is gone.")
    shown = table(states, height=20)
    assert "busy" in shown
    assert "broken" in shown
    assert "1 running, 1 failed, 198 waiting" in shown
    assert "not shown" in shown


def test_streams_at_work_come_first_then_those_gone_wrong_waiting_and_done() -> None:
    order = ["d done", "w waiting", "f failed", "r running", "e waiting", "s stalled", "p partial", "x done"]
    states = [StreamState(*name.split()) for name in order]  # type: ignore[arg-type]
    shown = table(states).splitlines()
    names = [line.split()[0] for line in shown if any(f" {name.split()[0]} " in line for name in order)]
    assert names[-8:] == ["r", "s", "f", "p", "w", "e", "d", "x"]


@pytest.mark.parametrize("own", [Terminal(), io.StringIO()])
def test_what_is_said_meanwhile_goes_above_the_table_where_both_are_on_the_terminal(
    own: io.StringIO, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "stderr", own)
    console = Console(file=io.StringIO(), force_terminal=True, width=110, height=40, no_color=True)
    progress = LiveTable(console, lambda: 0.0, refresh=False)
    progress.update([StreamState("yard", "running")])
    print("Line 3 [cannot] be used.", file=sys.stderr)
    progress.close()
    assert isinstance(console.file, io.StringIO)
    told_above = "Line 3 [cannot] be used." in console.file.getvalue()
    assert told_above == isinstance(own, Terminal) == (own.getvalue() == "")
