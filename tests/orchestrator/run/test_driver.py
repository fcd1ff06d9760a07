"""The driver of many streams, on fakes: admission, isolation, progress, interruption, exit status."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import replace
from itertools import count

import pytest
from driver_fakes import BURST, Again, FakeHost, FakeStream, Recorder, driver_of, progress, spec

from mlbs_actors.actors.stream.protocol import RunningStream, StreamProgress, StreamSpec
from mlbs_actors.errors import ActorLostError, NoPlaceError, SourceError
from orchestrator.interruption import Interruption, StopAtOnce
from orchestrator.run import driver as driver_module
from orchestrator.run.driver import KnownStreams
from orchestrator.run.recovery import MOST_RETURNS, STALL_SECONDS
from orchestrator.run.spec_change import SpecChange
from orchestrator.run.stream_state import (
    ENDED,
    StreamState,
    after_interruption,
)


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(driver_module, "_WAKE_SECONDS", 0.01)


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
    driver = driver_of(
        streams, host, recorder, *([] if turns is None else [turns]), at_once=limit, interruption=interruption
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
    driver = driver_of(["bad", "good"], host)
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


def losing(fails_at: int) -> FakeStream:
    return FakeStream(20, fails_at=fails_at, error=ActorLostError("It lost its layer 3."))


def drive_again(
    host: Again,
    interruption: Interruption | None = None,
    clock: Callable[[], float] = time.monotonic,
) -> dict[str, StreamState]:
    driver = driver_of(host.attempts, host, at_once=2, interruption=interruption, clock=clock)
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

    driver = driver_of(["bad"], host, interruption=interruption, changes=changes)
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
    driver = driver_of(specs, FakeHost({}), known=KnownStreams(lengths={"a": 20, "b": 20}))
    assert [state.length for state in driver.states] == [5, 20, None]


def test_streams_that_ended_in_an_earlier_run_are_left_alone() -> None:
    host = FakeHost({"new": FakeStream(4)})
    ended = {"old": StreamState("old", "done", read=9, committed=9)}
    driver = driver_of(["old", "new"], host, at_once=2, known=KnownStreams(ended=ended))
    assert driver.run() == 0
    assert host.started == ["new"]
    assert driver.states[0] == ended["old"]


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


def test_what_a_camera_took_when_it_was_stopped_is_known_when_it_is_resumed() -> None:
    running = replace(StreamState("door", "running", read=20, live=True), cores=0.3)
    stopped_door = after_interruption(running, progress(20, done=True))
    assert stopped_door.cores == 0
    loads = {"door": stopped_door.earlier_cores}
    door = driver_of(["door", "new"], FakeHost({}), known=KnownStreams(loads=loads))
    assert [state.earlier_cores for state in door.states] == [0.3, 0.0]


def test_a_waiting_stream_says_what_for_and_a_running_one_no_more() -> None:
    said: list[tuple[str | None, ...]] = []

    class Watch(Recorder):
        def update(self, states: Sequence[StreamState]) -> None:
            super().update(states)
            said.append(tuple(state.waits_for for state in states))

    driver = driver_of(["a", "b"], FakeHost({"a": FakeStream(8), "b": FakeStream(8)}), Watch())
    driver.run()
    assert ("its processes and its first frames", None) in said
    assert (None, "one of the 1 places, which are taken") in said
    assert said[-1] == (None, None)


def test_the_limit_can_grow_while_streams_run() -> None:
    limits = iter([1] * 3)
    host = FakeHost({name: FakeStream(8) for name in "abc"})
    driver = driver_of("abc", host, at_once=lambda _: next(limits, 3))
    assert driver.run() == 0
    assert [state.state for state in driver.states] == ["done"] * 3


def test_streams_wait_while_there_is_no_place_for_any() -> None:
    limits, asked = iter([0] * 3), []

    def limit(waiting: int) -> int:
        asked.append(waiting)
        return next(limits, 2)

    host = FakeHost({name: FakeStream(8) for name in "abc"})
    driver = driver_of("abc", host, at_once=limit)
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
    driver = driver_of(["only"], host, recorder)
    assert driver.run() == 0
    assert host.before == [None, first]
    assert recorder.history["only"][-4:] == ["waiting", "starting", "running", "done"]


def test_a_stream_that_is_ahead_of_whoever_takes_its_label_maps_waits_and_goes_on_afterwards() -> None:
    asked: list[int] = []
    taken = 0

    def is_behind(name: str, committed: int) -> bool:
        nonlocal taken
        asked.append(stream.read)
        if asked.count(8) == 3:
            taken = 8
        return committed - taken >= 8

    stream = FakeStream(16)
    driver = driver_of(["a"], FakeHost({"a": stream}), is_behind=is_behind)
    assert driver.run() == 0
    assert driver.states[0].committed == 16
    assert asked == [4, 8, 8, 8, 12]  # not before its first burst


def test_a_stream_that_has_ended_has_processes_until_they_are_given_back() -> None:
    seen: list[bool] = []

    class Slow(FakeStream):
        def stop(self, *, drain: bool, returns: bool = False) -> StreamProgress | None:
            assert driver.states[0].state == "done"
            seen.append(driver.has_processes)
            return super().stop(drain=drain, returns=returns)

    driver = driver_of(["a"], FakeHost({"a": Slow(4)}))
    assert not driver.has_processes
    driver.run()
    assert seen == [True]
    assert not driver.has_processes
