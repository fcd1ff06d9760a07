"""The driver of many streams, on fakes: admission, isolation, progress, interruption, exit status."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field, replace
from itertools import count

import pytest

from mlbs_actors.actors.stream.protocol import RunningStream, StreamProgress, StreamSpec
from mlbs_actors.config import Config
from mlbs_actors.errors import ActorLostError, NoPlaceError, SourceError
from mlbs_actors.source import FrameReader, SourceSilence
from orchestrator.interruption import Interruption, StopAtOnce
from orchestrator.run import driver as driver_module
from orchestrator.run.admission import by_count
from orchestrator.run.driver import Driver, SpecChange
from orchestrator.run.recovery import MOST_RETURNS, STALL_SECONDS
from orchestrator.run.stream_state import (
    ENDED,
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

BURST = 4


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(driver_module, "_WAKE_SECONDS", 0.01)


def unused() -> None:
    raise AssertionError("the driver must not open sources or sinks")


def spec(name: str, frames: int = 10) -> StreamSpec:
    return StreamSpec(name, Config(), unused, unused, max_frames=frames)  # type: ignore[arg-type]


def progress(read: int, *, done: bool = False, problem: str | None = None) -> StreamProgress:
    return StreamProgress(read, read, 0, 0, layers=2, done=done, problem=problem)


@dataclass
class FakeStream:
    """Reads ``frames`` frames in bursts; fails before frame ``fails_at``."""

    frames: int
    fails_at: int | None = None
    problem: str | None = None
    error: Exception = field(default_factory=lambda: SourceError("The source is gone."))
    read: int = 0
    stops: list[bool] = field(default_factory=list)
    returns: bool = False
    on_advance: Callable[[], None] = lambda: None
    node: str | None = None
    settings: list[object] = field(default_factory=list)
    readers: list[Callable[[], FrameReader]] = field(default_factory=list)

    def advance(self) -> Future[StreamProgress]:
        assert not self.stops, "advanced after its end"
        self.on_advance()
        future: Future[StreamProgress] = Future()
        self.read = min(self.read + BURST, self.frames)
        if self.fails_at is not None and self.read > self.fails_at:
            future.set_exception(self.error)
        else:
            future.set_result(progress(self.read, done=self.read == self.frames, problem=self.problem))
        return future

    def reopen(self, open_reader: Callable[[], FrameReader]) -> None:
        self.readers.append(open_reader)

    def configure(self, settings: object) -> None:
        self.settings.append(settings)

    def stop(self, *, drain: bool, returns: bool = False) -> StreamProgress | None:
        self.stops.append(drain)
        self.returns = returns
        return progress(self.read, done=True) if drain else None


class FakeHost:
    """Hands out prepared streams and counts those that run."""

    def __init__(self, streams: dict[str, FakeStream]) -> None:
        self.streams = streams
        self.started: list[str] = []
        self.most_at_once = 0
        self.repairs = 0

    def start(self, spec: StreamSpec, before: RunningStream | None = None) -> RunningStream:
        self.started.append(spec.name)
        running = sum(not self.streams[name].stops for name in self.started)
        self.most_at_once = max(self.most_at_once, running)
        return self.streams[spec.name]

    def repair(self) -> None:
        self.repairs += 1

    def close(self) -> None:
        raise AssertionError("the driver does not own the host")


class Recorder:
    """Keeps every state that each stream went through."""

    def __init__(self) -> None:
        self.history: dict[str, list[StateName]] = {}
        self.last: Sequence[StreamState] = ()

    def update(self, states: Sequence[StreamState]) -> None:
        self.last = states
        for state in states:
            past = self.history.setdefault(state.name, [])
            if not past or past[-1] != state.state:
                past.append(state.state)


class Turns:
    """Lets a stream that is slow to end wait until the driver has gone round its loop."""

    def __init__(self) -> None:
        self._shown = 0
        self._changed = threading.Condition()

    def update(self, states: Sequence[StreamState]) -> None:
        with self._changed:
            self._shown += 1
            self._changed.notify_all()

    def pass_by(self) -> None:
        """Return after the driver has shown the states three times: once or twice in each turn."""
        with self._changed:
            until = self._shown + 3
            self._changed.wait_for(lambda: self._shown >= until)


class NoticedInterruption(Interruption):
    """An interruption that tells when the driver has seen its signal."""

    def __init__(self) -> None:
        self._number: int | None = None
        self.noticed = threading.Event()
        super().__init__()

    @property
    def signal_number(self) -> int | None:
        if self._number is not None:
            self.noticed.set()
        return self._number

    @signal_number.setter
    def signal_number(self, number: int | None) -> None:
        self._number = number


def drive(
    streams: dict[str, FakeStream],
    limit: int = 10,
    interruption: Interruption | None = None,
    turns: Turns | None = None,
) -> tuple[int, dict[str, StreamState], Recorder, FakeHost]:
    host, recorder = FakeHost(streams), Recorder()
    driver = Driver(
        [spec(name) for name in streams],
        host,
        admission=by_count(limit),
        observers=[recorder, *([] if turns is None else [turns])],
        interruption=interruption or Interruption(),
    )
    status = driver.run()
    return status, {state.name: state for state in driver.states}, recorder, host


def test_all_streams_run_to_their_ends_and_give_their_processes_back() -> None:
    streams = {name: FakeStream(frames) for name, frames in (("a", 3), ("b", 17), ("c", 8))}
    streams["b"].node = "10.0.0.7 (1a2b3c4d)"
    status, states, recorder, _ = drive(streams)
    assert status == 0
    assert {name: (s.state, s.read, s.committed) for name, s in states.items()} == {
        "a": ("done", 3, 3),
        "b": ("done", 17, 17),
        "c": ("done", 8, 8),
    }
    assert [stream.stops for stream in streams.values()] == [[False]] * 3
    assert recorder.history["b"] == ["waiting", "starting", "running", "done"]
    assert list(recorder.last) == list(states.values())
    assert [state.node for state in states.values()] == [None, "10.0.0.7 (1a2b3c4d)", None]


@pytest.mark.parametrize("limit", [1, 2, 5])
def test_no_more_streams_run_than_there_are_places_and_the_rest_follow_in_order(limit: int) -> None:
    streams = {f"s{number}": FakeStream(6) for number in range(12)}
    status, _, _, host = drive(streams, limit)
    assert status == 0
    assert host.most_at_once == limit
    assert sorted(host.started) == sorted(streams)
    assert host.started[:limit] == list(streams)[:limit]


def test_a_place_is_free_only_when_the_stream_before_has_given_its_processes_back() -> None:
    gone, turns = threading.Event(), Turns()

    class Slow(FakeStream):
        def stop(self, *, drain: bool, returns: bool = False) -> StreamProgress | None:
            turns.pass_by()
            gone.set()
            return super().stop(drain=drain, returns=returns)

    def check() -> None:
        assert gone.is_set()

    status, states, _, _ = drive({"a": Slow(4), "b": FakeStream(4, on_advance=check)}, 1, turns=turns)
    assert status == 0, states


@pytest.mark.parametrize("fails_at", [0, 8])
@pytest.mark.parametrize("error", [SourceError("The disk is gone."), RuntimeError("a bug")])
def test_a_stream_that_fails_ends_alone(fails_at: int, error: Exception) -> None:
    streams = {"bad": FakeStream(20, fails_at=fails_at, error=error), "good": FakeStream(20)}
    status, states, _, _ = drive(streams)
    assert status == 1
    assert states["bad"].state == "failed"
    assert str(error).rstrip(".") in (states["bad"].error or "")
    assert states["bad"].committed == fails_at
    assert streams["bad"].stops == [False]
    assert (states["good"].state, states["good"].committed) == ("done", 20)


def test_a_stream_that_cannot_even_be_started_fails_alone() -> None:
    class Broken(FakeHost):
        def start(self, spec: StreamSpec, before: RunningStream | None = None) -> RunningStream:
            if spec.name == "bad":
                raise SourceError("No such thing.")
            return super().start(spec, before)

    host = Broken({"good": FakeStream(5)})
    driver = Driver(
        [spec("bad"), spec("good")], host, admission=by_count(1), observers=[], interruption=Interruption()
    )
    assert driver.run() == 1
    assert [state.state for state in driver.states] == ["failed", "done"]


def test_a_stream_whose_processes_cannot_be_ended_holds_up_nobody() -> None:
    class Stuck(FakeStream):
        def stop(self, *, drain: bool, returns: bool = False) -> StreamProgress | None:
            raise RuntimeError("lost")

    status, states, _, _ = drive({"a": Stuck(4), "b": FakeStream(4)}, 1)
    assert status == 0
    assert states["b"].state == "done"


def test_a_damaged_source_is_partial_and_one_without_a_frame_failed() -> None:
    streams = {"cut": FakeStream(6, problem="It is cut off."), "none": FakeStream(0)}
    status, states, _, _ = drive(streams)
    assert status == 1
    assert (states["cut"].state, states["cut"].committed, states["cut"].error) == (
        "partial",
        6,
        "It is cut off.",
    )
    assert states["none"].state == "failed"


def test_passwords_in_errors_never_reach_a_state() -> None:
    error = RuntimeError("cannot open rtsp://bob:hunter2@cam/door")
    streams = {
        "a": FakeStream(9, fails_at=0, error=error),
        "b": FakeStream(9, problem="rtsp://x:hunter2@y ended."),
    }
    _, states, _, _ = drive(streams)
    assert "hunter2" not in repr(states)
    assert "rtsp://***@cam/door" in repr(states)


def test_a_signal_drains_what_was_read_starts_nothing_more_and_gives_its_status() -> None:
    interruption = Interruption()

    def interrupt() -> None:
        interruption.signal_number = signal.SIGTERM

    streams = {
        "a": FakeStream(1000, on_advance=interrupt),
        "b": FakeStream(1000),
        "ended": FakeStream(2),
        "later": FakeStream(5),
    }
    status, states, _, host = drive(streams, 3, interruption=interruption)
    assert status == 143
    assert (states["a"].state, states["a"].read, states["a"].committed) == ("partial", BURST, BURST)
    assert "Interrupted after 4 frames" in (states["a"].error or "")
    assert states["ended"].state == "done"
    assert states["later"].state == "waiting"
    assert "later" not in host.started
    assert [streams[name].stops for name in ("a", "b", "ended")] == [[True], [True], [False]]


def test_a_stream_that_fails_while_it_is_drained_is_told_apart() -> None:
    interruption = Interruption()

    class Lost(FakeStream):
        def stop(self, *, drain: bool, returns: bool = False) -> StreamProgress | None:
            interruption.signal_number = signal.SIGINT
            self.stops.append(drain)
            return None

    def interrupt() -> None:
        interruption.signal_number = signal.SIGINT

    status, states, _, _ = drive({"a": Lost(1000, on_advance=interrupt)}, interruption=interruption)
    assert status == 130
    assert "what was committed is kept" in (states["a"].error or "")


# Going back


class Again(FakeHost):
    """Hands out one stream after the other under each name."""

    def __init__(self, attempts: dict[str, list[FakeStream]]) -> None:
        super().__init__({name: streams[0] for name, streams in attempts.items()})
        self.attempts = attempts
        self.before: list[RunningStream | None] = []
        self.last_tries: list[bool] = []

    def start(self, spec: StreamSpec, before: RunningStream | None = None) -> RunningStream:
        self.started.append(spec.name)
        self.before.append(before)
        self.last_tries.append(spec.last_try)
        return self.attempts[spec.name].pop(0)


def losing(fails_at: int) -> FakeStream:
    return FakeStream(20, fails_at=fails_at, error=ActorLostError("It lost its layer 3."))


def drive_again(
    host: Again,
    interruption: Interruption | None = None,
    clock: Callable[[], float] = time.monotonic,
) -> dict[str, StreamState]:
    driver = Driver(
        [spec(name) for name in host.attempts],
        host,
        admission=by_count(2),
        observers=[],
        interruption=interruption or Interruption(),
        clock=clock,
    )
    driver.run()
    return {state.name: state for state in driver.states}


def test_a_stream_that_lost_a_process_is_stopped_and_started_again() -> None:
    first, second = losing(8), FakeStream(20)
    host = Again({"bad": [first, second], "good": [FakeStream(20)]})
    states = drive_again(host)
    assert (states["bad"].state, states["bad"].committed, states["bad"].returns) == ("done", 20, 1)
    assert states["bad"].error is None
    assert (first.stops, second.stops, host.repairs) == ([False], [False], 1)
    assert (states["good"].state, states["good"].returns) == ("done", 0)


def test_a_stream_that_gets_no_further_fails_after_a_few_returns_and_knows_its_last_try() -> None:
    host = Again({"bad": [losing(8) for _ in range(9)]})
    states = drive_again(host)
    assert states["bad"].state == "failed"
    assert "layer 3" in (states["bad"].error or "")
    # The first loss came after label maps that no start before it had committed.
    assert host.last_tries == [False] * MOST_RETURNS + [True]
    assert states["bad"].returns == MOST_RETURNS


def test_a_stream_is_started_again_with_what_its_last_start_has_left() -> None:
    first, second = losing(8), losing(16)
    host = Again({"camera": [first, second, FakeStream(20)]})
    assert drive_again(host)["camera"].state == "done"
    assert host.before == [None, first, second]
    assert (first.returns, second.returns) == (True, True)


def test_a_stream_that_does_not_get_on_is_started_again() -> None:
    class Hanging(FakeStream):
        def advance(self) -> Future[StreamProgress]:
            return super().advance() if self.read < 8 else Future()

    host = Again({"slow": [Hanging(20), FakeStream(20)]})
    clock = count(step=STALL_SECONDS / 10)  # each look at it takes as long
    states = drive_again(host, clock=lambda: next(clock))
    assert (states["slow"].state, states["slow"].returns) == ("done", 1)


def test_a_stream_that_leaves_the_list_while_it_goes_back_is_not_started_again() -> None:
    interruption = Interruption()
    asked: list[StreamState] = []
    has_left = threading.Event()

    class Slow(FakeStream):
        def stop(self, *, drain: bool, returns: bool = False) -> StreamProgress | None:
            has_left.wait()
            return super().stop(drain=drain, returns=returns)

    host = Again({"bad": [Slow(20, fails_at=8, error=ActorLostError("It lost its layer 3."))]})

    def changes() -> SpecChange | None:
        state = driver.states[0]
        if state.state in ENDED:
            interruption.signal_number = signal.SIGTERM
        if state.returns == 0 or asked:
            return None
        asked.append(state)
        has_left.set()
        return SpecChange((), ("bad",))

    driver = Driver(
        [spec("bad")], host, admission=by_count(1), observers=[], interruption=interruption, changes=changes
    )
    driver.run()
    assert host.started == ["bad"]
    assert (driver.states[0].state, driver.states[0].committed) == ("partial", 8)


def test_a_signal_while_a_stream_goes_back_leaves_it_to_be_resumed() -> None:
    interruption = NoticedInterruption()

    class Stopping(FakeStream):
        def stop(self, *, drain: bool, returns: bool = False) -> StreamProgress | None:
            interruption.signal_number = signal.SIGTERM
            interruption.noticed.wait()
            return super().stop(drain=drain, returns=returns)

    first = Stopping(20, fails_at=8, error=ActorLostError("It lost its layer 3."))
    host = Again({"bad": [first, FakeStream(20)]})
    states = drive_again(host, interruption)
    assert host.started == ["bad"]
    assert (states["bad"].state, states["bad"].interrupted) == ("partial", True)


def test_a_waiting_stream_is_shown_with_what_it_will_read_of_its_length() -> None:
    specs = [spec("a", 5), spec("b", 50), spec("c")]
    driver = Driver(
        specs,
        FakeHost({}),
        admission=by_count(1),
        observers=[],
        interruption=Interruption(),
        lengths={"a": 20, "b": 20},
    )
    assert [state.length for state in driver.states] == [5, 20, None]


def test_streams_that_ended_in_an_earlier_run_are_left_alone() -> None:
    host = FakeHost({"new": FakeStream(4)})
    ended = {"old": StreamState("old", "done", read=9, committed=9)}
    driver = Driver(
        [spec("old"), spec("new")],
        host,
        admission=by_count(2),
        observers=[],
        interruption=Interruption(),
        ended=ended,
    )
    assert driver.run() == 0
    assert host.started == ["new"]
    assert driver.states[0] == ended["old"]


# Signals


def test_the_first_signal_is_noted_the_second_ends_at_once_and_the_handlers_are_given_back(
    capsys: pytest.CaptureFixture[str],
) -> None:
    before = signal.getsignal(signal.SIGTERM)
    with Interruption() as interruption:
        os.kill(os.getpid(), signal.SIGTERM)
        assert interruption.signal_number == signal.SIGTERM
        with pytest.raises(StopAtOnce) as stop:
            os.kill(os.getpid(), signal.SIGINT)
        assert stop.value.signal_number == signal.SIGTERM
    assert signal.getsignal(signal.SIGTERM) is before
    assert capsys.readouterr().err.count("a second signal ends the run at once") == 1
    with Interruption():
        pass
    assert capsys.readouterr().err == ""


# Rules


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


def test_what_a_camera_took_when_it_was_stopped_is_known_when_it_is_resumed() -> None:
    running = replace(StreamState("door", "running", read=20, live=True), cores=0.3)
    stopped_door = after_interruption(running, progress(20, done=True))
    assert stopped_door.cores == 0
    loads = {"door": stopped_door.earlier_cores}
    door = Driver(
        [spec("door"), spec("new")],
        FakeHost({}),
        admission=by_count(1),
        observers=[],
        interruption=Interruption(),
        loads=loads,
    )
    assert [state.earlier_cores for state in door.states] == [0.3, 0.0]


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


def test_streams_that_come_are_run_and_those_that_leave_are_finished_until_a_signal() -> None:
    streams = {"endless": FakeStream(10**9), "waits": FakeStream(4), "new": FakeStream(8)}
    host, recorder, interruption = FakeHost(streams), Recorder(), Interruption()
    left = [SpecChange((), ("waits",)), SpecChange((spec("new"),), ("endless",)), SpecChange((), ("new",))]

    def changes() -> SpecChange | None:
        """The first two while the endless one runs, the third when all is over, then a signal."""
        is_over = all(state.state in ENDED for state in recorder.last)
        if is_over and not left:
            interruption.signal_number = signal.SIGTERM
        due = streams["endless"].read >= 20 if len(left) > 1 else is_over
        return left.pop(0) if left and due else None

    driver = Driver(
        [spec("endless"), spec("waits")],
        host,
        admission=by_count(1),
        observers=[recorder],
        interruption=interruption,
        changes=changes,
    )
    assert driver.run() == 0
    states = {state.name: state for state in driver.states}
    assert list(states) == ["endless", "new"]
    assert (states["endless"].state, states["endless"].committed) == ("done", streams["endless"].read)
    assert streams["endless"].stops == [True]
    assert host.started == ["endless", "new"]
    assert (states["new"].state, states["new"].committed) == ("done", 8)


def test_a_stream_that_comes_back_is_started_again_once_it_is_gone_and_one_at_its_end_is_not() -> None:
    interruption, recorder, is_back = Interruption(), Recorder(), threading.Event()

    class Slow(FakeStream):
        def stop(self, *, drain: bool, returns: bool = False) -> StreamProgress | None:
            is_back.wait()
            return super().stop(drain=drain, returns=returns)

    first, second = Slow(10**9), FakeStream(10**9)
    host = Again({"camera": [first, second], "film": [FakeStream(4)]})
    left = [SpecChange((), ("film", "camera")), SpecChange((spec("camera"), spec("film")), ())]

    def changes() -> SpecChange | None:
        if second.read >= 20:
            interruption.signal_number = signal.SIGTERM
        if not left:  # the driver has dealt with the last change
            is_back.set()
        return left.pop(0) if left and first.read >= 20 else None

    specs = [spec("camera"), spec("film")]
    driver = Driver(
        specs, host, admission=by_count(2), observers=[recorder], interruption=interruption, changes=changes
    )
    driver.run()
    assert host.started == ["camera", "film", "camera"]
    assert first.stops == second.stops == [True]
    assert recorder.history["film"][-1] == "done"


def test_a_stream_follows_other_settings_at_once_or_when_it_starts() -> None:
    running, waiting, interruption = FakeStream(10**9), FakeStream(8), Interruption()
    started: dict[str, StreamSpec] = {}

    class Host(FakeHost):
        def start(self, spec: StreamSpec, before: RunningStream | None = None) -> RunningStream:
            started[spec.name] = spec
            return super().start(spec, before)

    other = [(replace(spec(name), source="other"), f"zones of {name}") for name in ("a", "b")]
    left = [SpecChange(configured=tuple(other)), SpecChange(removed=("a",))]

    def changes() -> SpecChange | None:
        if not left and waiting.stops:
            interruption.signal_number = signal.SIGTERM
        return left.pop(0) if left and running.read >= 8 else None

    driver = Driver(
        [spec("a"), spec("b")],
        Host({"a": running, "b": waiting}),
        admission=by_count(1),
        observers=[],
        interruption=interruption,
        changes=changes,
    )
    driver.run()
    assert running.settings == ["zones of a"]
    assert (started["b"].source, waiting.settings) == ("other", [])


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


def test_a_waiting_stream_says_what_for_and_a_running_one_no_more() -> None:
    said: list[tuple[str | None, ...]] = []

    class Watch(Recorder):
        def update(self, states: Sequence[StreamState]) -> None:
            super().update(states)
            said.append(tuple(state.waits_for for state in states))

    driver = Driver(
        [spec("a"), spec("b")],
        FakeHost({"a": FakeStream(8), "b": FakeStream(8)}),
        admission=by_count(1),
        observers=[Watch()],
        interruption=Interruption(),
    )
    driver.run()
    assert ("its processes and its first frames", None) in said
    assert (None, "one of the 1 places, which are taken") in said
    assert said[-1] == (None, None)


def test_the_limit_can_grow_while_streams_run() -> None:
    limits = iter([1] * 3)
    host = FakeHost({name: FakeStream(8) for name in "abc"})
    driver = Driver(
        [spec(name) for name in "abc"],
        host,
        admission=by_count(lambda _: next(limits, 3)),
        observers=[],
        interruption=Interruption(),
    )
    assert driver.run() == 0
    assert [state.state for state in driver.states] == ["done"] * 3


def test_streams_wait_while_there_is_no_place_for_any() -> None:
    limits, asked = iter([0] * 3), []

    def limit(waiting: int) -> int:
        asked.append(waiting)
        return next(limits, 2)

    host = FakeHost({name: FakeStream(8) for name in "abc"})
    driver = Driver(
        [spec(name) for name in "abc"],
        host,
        admission=by_count(limit),
        observers=[],
        interruption=Interruption(),
    )
    assert driver.run() == 0
    assert asked[:4] == [3, 3, 3, 3]
    assert host.most_at_once == 2


def test_a_stream_that_goes_back_when_no_node_is_left_waits_and_goes_on_from_its_last_start() -> None:
    class Lost(Again):
        def start(self, spec: StreamSpec, before: RunningStream | None = None) -> RunningStream:
            if before is not None and not refused:
                refused.append(before)
                raise NoPlaceError("No node takes streams.")
            return super().start(spec, before)

    refused: list[RunningStream] = []
    first = losing(8)
    host, recorder = Lost({"only": [first, FakeStream(20)]}), Recorder()
    driver = Driver(
        [spec("only")],
        host,
        admission=by_count(1),
        observers=[recorder],
        interruption=Interruption(),
    )
    assert driver.run() == 0
    assert host.before == [None, first]
    assert recorder.history["only"][-4:] == ["waiting", "starting", "running", "done"]


@pytest.mark.parametrize("same_source", [True, False])
def test_a_stream_goes_on_with_other_processes_when_its_settings_ask_for_them(same_source: bool) -> None:
    first, second, interruption, recorder = FakeStream(10**9), FakeStream(10**9), Interruption(), Recorder()
    started: list[tuple[StreamSpec, RunningStream | None]] = []
    kept: list[bool] = []

    class Host(Again):
        def start(self, spec: StreamSpec, before: RunningStream | None = None) -> RunningStream:
            started.append((spec, before))
            return super().start(spec, before)

    class First(FakeStream):
        def stop(self, *, drain: bool, returns: bool = False) -> StreamProgress | None:
            kept.append(returns)
            return super().stop(drain=drain, returns=returns)

    first = First(10**9)
    other = replace(spec("camera"), source="other", live=True)
    left = [SpecChange(restarted=((other, same_source),))]

    def changes() -> SpecChange | None:
        if second.read >= 20:
            interruption.signal_number = signal.SIGTERM
        return left.pop(0) if left and first.read >= 20 else None

    driver = Driver(
        [replace(spec("camera"), live=True)],
        Host({"camera": [first, second]}),
        admission=by_count(1),
        observers=[recorder],
        interruption=interruption,
        changes=changes,
    )
    driver.run()
    assert first.stops == second.stops == [True]  # what was read is labelled and kept
    assert kept == [same_source]
    assert [one.source for one, _ in started] == ["the source", "other"]
    assert started[1][1] is (first if same_source else None)
    assert "failed" not in recorder.history["camera"]


def test_a_camera_that_was_given_up_is_tried_again_where_it_is_now() -> None:
    gone, there, interruption = FakeStream(0), FakeStream(10**9), Interruption()
    left = [SpecChange(restarted=((replace(spec("camera"), source="other", live=True), False),))]

    def changes() -> SpecChange | None:
        if there.read >= 20:
            interruption.signal_number = signal.SIGTERM
        return left.pop(0) if left and gone.stops else None

    host = Again({"camera": [gone, there]})
    driver = Driver(
        [replace(spec("camera"), live=True)],
        host,
        admission=by_count(1),
        observers=[],
        interruption=interruption,
        changes=changes,
    )
    driver.run()
    assert host.started == ["camera", "camera"]


def test_a_renamed_stream_begins_once_the_one_before_has_ended() -> None:
    first, second, interruption = FakeStream(10**9), FakeStream(10**9), Interruption()
    told: list[list[bool]] = []
    renamed = {"road": ("lane", lambda: told.append(list(first.stops)))}
    left = [SpecChange(added=(spec("road"),), removed=("lane",), renamed=renamed)]

    def changes() -> SpecChange | None:
        if second.read >= 20:
            interruption.signal_number = signal.SIGTERM
        return left.pop(0) if left and first.read >= 20 else None

    driver = Driver(
        [spec("lane")],
        FakeHost({"lane": first, "road": second}),
        admission=by_count(2),
        observers=[],
        interruption=interruption,
        changes=changes,
    )
    driver.run()
    assert told == [[True]]
    assert [state.name for state in driver.states] == ["road"]


def test_a_camera_that_is_elsewhere_now_is_read_there_by_the_processes_that_it_has() -> None:
    camera, interruption = FakeStream(10**9), Interruption()

    def elsewhere() -> FrameReader:
        raise AssertionError("the driver must not open sources")

    left = [SpecChange(reopened=(replace(spec("camera"), open_reader=elsewhere, live=True),))]

    def changes() -> SpecChange | None:
        if camera.readers and camera.read >= 40:
            interruption.signal_number = signal.SIGTERM
        return left.pop(0) if left and camera.read >= 20 else None

    host = FakeHost({"camera": camera})
    driver = Driver(
        [replace(spec("camera"), live=True)],
        host,
        admission=by_count(1),
        observers=[],
        interruption=interruption,
        changes=changes,
    )
    driver.run()
    assert camera.readers == [elsewhere]
    assert host.started == ["camera"]
