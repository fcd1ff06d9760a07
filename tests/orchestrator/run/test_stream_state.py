"""The states of streams, and how they change."""

from __future__ import annotations

import signal
from dataclasses import replace

import pytest
from driver_fakes import progress

from mlbs_actors.actors.stream.protocol import StreamProgress
from mlbs_actors.source import SourceSilence
from orchestrator.run.stream_state import (
    StateName,
    StreamState,
    after_end,
    after_failure,
    after_interruption,
    after_progress,
    after_removal,
    exit_code,
    has_ended,
    stopped,
    with_record,
)


def test_counts_and_rate_follow_progress() -> None:
    state = after_progress(StreamState("a", "starting"), progress(8), 12.5)
    assert (state.state, state.read, state.committed, state.layers, state.frames_per_second) == (
        "running",
        8,
        8,
        2,
        12.5,
    )


def test_a_stream_is_starting_until_its_first_frame_is_read() -> None:
    assert after_progress(StreamState("a", "starting"), progress(0), 0.0).state == "starting"


def test_quarantined_frames_alone_make_a_stream_partial() -> None:
    end = StreamProgress(read=5, committed=4, quarantined=1, dropped=0, layers=1, done=True)
    state = after_end(StreamState("a", "running"), end)
    assert state.state == "partial"
    assert "1 frame could not be decoded" in (state.error or "")


def test_a_failed_stream_keeps_its_counts() -> None:
    running = after_progress(StreamState("a"), progress(8), 3.0)
    assert replace(after_failure(running, "x"), state="running", error=None, layers=2) == replace(
        running, frames_per_second=0.0
    )


def test_an_interrupted_stream_without_final_progress_keeps_its_counts() -> None:
    running = after_progress(StreamState("a"), progress(8), 3.0)
    assert after_interruption(running, None).committed == 8


def test_a_run_that_is_ended_at_once_leaves_nothing_at_work_and_what_has_ended_as_it_is() -> None:
    running = after_progress(StreamState("a"), progress(8), 3.0)
    done, waiting = StreamState("b", "done"), StreamState("c")
    left = stopped([running, done, waiting])
    assert left[1:] == (done, waiting)
    assert (left[0].state, left[0].interrupted, left[0].committed) == ("partial", True, 8)


@pytest.mark.parametrize(
    ("names", "signal_number", "status"),
    [
        (("done", "done"), None, 0),
        (("done", "partial"), None, 1),
        (("failed", "done"), None, 1),
        (("done", "done"), signal.SIGINT, 0),
        (("failed", "waiting"), signal.SIGTERM, 143),
    ],
)
def test_the_exit_status_follows_the_states_and_the_signal(
    names: tuple[StateName, ...], signal_number: int | None, status: int
) -> None:
    assert exit_code([StreamState("x", name) for name in names], signal_number) == status


def test_cameras_that_a_signal_stopped_in_order_are_complete_beside_files_that_are() -> None:
    running = StreamState("door", "running", read=20, committed=8, live=True)
    door = after_interruption(running, progress(20, done=True))
    assert (door.state, door.committed, door.error) == ("done", 20, None)
    assert not has_ended(door)  # it continues with --resume
    waiting, film = StreamState("gate", live=True), StreamState("film", "done")
    assert exit_code([door, waiting, film], signal.SIGTERM) == 0
    assert exit_code([door, StreamState("film")], signal.SIGTERM) == 143
    cut = after_interruption(StreamState("film", "running"), progress(8))
    assert exit_code([door, cut], signal.SIGINT) == 130
    assert exit_code([door, StreamState("bad", "failed")], signal.SIGTERM) == 1
    lost = after_interruption(running, None)
    assert (lost.state, exit_code([door, lost], signal.SIGTERM)) == ("partial", 1)


def test_a_stream_that_was_short_of_memory_says_so_to_its_end() -> None:
    short = after_progress(StreamState("a"), replace(progress(9), without_process=3), 1.0)
    later = after_progress(short, replace(progress(12), without_process=1), 1.0)
    ended = after_end(later, progress(20, done=True))
    assert "up to 3 layers" in (ended.memory_note or "")
    assert (ended.state, ended.error) == ("done", None)
    assert after_end(StreamState("b"), progress(20, done=True)).memory_note is None


def test_a_failed_stream_is_shown_with_what_its_record_holds() -> None:
    failed = StreamState("a", state="failed", read=3, committed=0, quarantined=1)
    assert (with_record(failed, 7).read, with_record(failed, 7).committed) == (7, 6)
    assert with_record(failed, 0) == failed
    done = StreamState("b", state="done", read=7, committed=7)
    assert with_record(done, 3) == done


def test_a_stream_that_leaves_with_nothing_to_keep_or_without_an_answer_is_partial() -> None:
    running = StreamState("a", "running", read=9, committed=5)
    finished = after_removal(running, progress(9, done=True))
    assert (finished.state, has_ended(finished)) == ("done", False)  # it may come back
    assert after_removal(running, progress(9, done=True, problem="Damaged.")).error == "Damaged."
    lost = after_removal(running, None)
    assert (lost.state, lost.committed) == ("partial", 5)
    assert "what was committed is kept" in (lost.error or "")
    assert after_removal(StreamState("a", "starting"), progress(0, done=True)).state == "partial"


def test_a_camera_that_is_silent_or_away_is_told_until_it_is_back() -> None:
    state = StreamState("a", "starting")
    away = replace(progress(0), silence=SourceSilence("reconnecting", "The camera rtsp://b:pw@c is away."))
    state = after_progress(state, away, 0.0)
    assert (state.state, state.error) == ("reconnecting", "The camera rtsp://***@c is away.")
    state = after_progress(state, replace(progress(0), silence=SourceSilence(None)), 0.0)
    assert (state.state, state.error) == ("starting", None)
    state = after_progress(state, replace(progress(8), dropped=2, gaps=1), 4.0)
    assert (state.state, state.error, state.dropped, state.gaps) == ("running", None, 2, 1)
