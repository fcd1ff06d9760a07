"""The driver of streams that come, go, and become others while the run is at work."""

from __future__ import annotations

import signal
import threading
from dataclasses import replace

import pytest
from driver_fakes import Again, FakeHost, FakeStream, Recorder, driver_of, spec

from mlbs_actors.actors.stream.protocol import RunningStream, StreamProgress, StreamSpec
from mlbs_actors.source import FrameReader
from orchestrator.interruption import Interruption
from orchestrator.run import driver as driver_module
from orchestrator.run.driver import KnownStreams
from orchestrator.run.spec_change import SpecChange
from orchestrator.run.stream_state import ENDED, StreamState
from orchestrator.storage.durable_files import UnwritableError


def elsewhere() -> FrameReader:
    raise AssertionError("the driver must not open sources")


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(driver_module, "_WAKE_SECONDS", 0.01)


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

    driver = driver_of(["endless", "waits"], host, recorder, interruption=interruption, changes=changes)
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

    driver = driver_of(
        ["camera", "film"], host, recorder, at_once=2, interruption=interruption, changes=changes
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

    driver = driver_of(
        ["a", "b"], Host({"a": running, "b": waiting}), interruption=interruption, changes=changes
    )
    driver.run()
    assert running.settings == ["zones of a"]
    assert (started["b"].source, waiting.settings) == ("other", [])


@pytest.mark.parametrize("same_reader", [True, False])
def test_a_stream_goes_on_with_other_processes_when_its_settings_ask_for_them(same_reader: bool) -> None:
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
    camera = replace(spec("camera"), live=True)
    other = replace(camera, source="other")
    if not same_reader:
        other = replace(other, open_reader=elsewhere)
    left = [SpecChange(restarted=(other,))]

    def changes() -> SpecChange | None:
        if second.read >= 20:
            interruption.signal_number = signal.SIGTERM
        return left.pop(0) if left and first.read >= 20 else None

    driver = driver_of(
        [camera], Host({"camera": [first, second]}), recorder, interruption=interruption, changes=changes
    )
    driver.run()
    assert first.stops == second.stops == [True]  # what was read is labelled and kept
    assert kept == [same_reader]
    assert [one.source for one, _ in started] == ["the source", "other"]
    assert started[1][1] is (first if same_reader else None)
    assert "failed" not in recorder.history["camera"]


def test_a_camera_that_was_given_up_is_tried_again_where_it_is_now() -> None:
    gone, there, interruption = FakeStream(0), FakeStream(10**9), Interruption()
    left = [SpecChange(restarted=(replace(spec("camera"), source="other", live=True),))]

    def changes() -> SpecChange | None:
        if there.read >= 20:
            interruption.signal_number = signal.SIGTERM
        return left.pop(0) if left and gone.stops else None

    host = Again({"camera": [gone, there]})
    driver = driver_of([replace(spec("camera"), live=True)], host, interruption=interruption, changes=changes)
    driver.run()
    assert host.started == ["camera", "camera"]


@pytest.mark.parametrize("same_reader", [True, False])
def test_a_renamed_stream_begins_once_the_one_before_has_ended(same_reader: bool) -> None:
    first, second, interruption = FakeStream(10**9), FakeStream(10**9), Interruption()
    befores: dict[str, RunningStream | None] = {}

    class Host(FakeHost):
        def start(self, spec: StreamSpec, before: RunningStream | None = None) -> RunningStream:
            befores[spec.name] = before
            return super().start(spec, before)

    told: list[list[bool]] = []
    renamed = {"road": ("lane", lambda: told.append(list(first.stops)))}
    road = spec("road") if same_reader else replace(spec("road"), open_reader=elsewhere)
    left = [SpecChange(added=(road,), removed=("lane",), renamed=renamed)]

    def changes() -> SpecChange | None:
        if second.read >= 20:
            interruption.signal_number = signal.SIGTERM
        return left.pop(0) if left and first.read >= 20 else None

    driver = driver_of(
        ["lane"], Host({"lane": first, "road": second}), at_once=2, interruption=interruption, changes=changes
    )
    driver.run()
    assert told == [[True]]
    assert [state.name for state in driver.states] == ["road"]
    assert first.returns == same_reader
    assert befores == {"lane": None, "road": first if same_reader else None}


def test_a_new_name_that_is_taken_back_before_it_is_used_leaves_nothing() -> None:
    first, interruption, is_told = FakeStream(10**9), Interruption(), threading.Event()

    class Slow(FakeStream):
        def stop(self, *, drain: bool, returns: bool = False) -> StreamProgress | None:
            is_told.wait()
            return super().stop(drain=drain, returns=returns)

    first = Slow(10**9)
    renamed = {"road": ("lane", lambda: None)}
    left = [
        SpecChange(added=(spec("road"),), removed=("lane",), renamed=renamed),
        SpecChange(removed=("road",)),
    ]

    def changes() -> SpecChange | None:
        if not left:
            is_told.set()
            if first.stops:
                interruption.signal_number = signal.SIGTERM
        return left.pop(0) if left and first.read >= 20 else None

    host = FakeHost({"lane": first})
    driver = driver_of(["lane"], host, at_once=2, interruption=interruption, changes=changes)
    driver.run()
    assert host.started == ["lane"]
    assert [(state.name, state.state) for state in driver.states] == [("lane", "done")]


def test_a_camera_that_is_elsewhere_now_is_read_there_by_the_processes_that_it_has() -> None:
    camera, interruption = FakeStream(10**9), Interruption()
    left = [SpecChange(reopened=(replace(spec("camera"), open_reader=elsewhere, live=True),))]

    def changes() -> SpecChange | None:
        if camera.readers and camera.read >= 40:
            interruption.signal_number = signal.SIGTERM
        return left.pop(0) if left and camera.read >= 20 else None

    host = FakeHost({"camera": camera})
    driver = driver_of([replace(spec("camera"), live=True)], host, interruption=interruption, changes=changes)
    driver.run()
    assert camera.readers == [elsewhere]
    assert host.started == ["camera"]


@pytest.mark.parametrize("live", [True, False])
def test_a_camera_whose_disk_is_full_goes_on_when_there_is_room_but_a_file_fails(
    live: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    full = UnwritableError("No space left on device.")
    refused = [FakeStream(10**9, fails_at=at, error=full) for at in (8, 0, 0)]
    last, interruption, recorder = FakeStream(10**9), Interruption(), Recorder()
    pauses: list[int] = []

    def no_pause(failures: int) -> float:
        pauses.append(failures)
        return 0.0

    monkeypatch.setattr(driver_module, "retry_seconds", no_pause)

    def changes() -> SpecChange | None:
        if last.read >= 20 or "failed" in recorder.history["camera"]:
            interruption.signal_number = signal.SIGTERM
        return None

    driver = driver_of(
        [replace(spec("camera"), live=live)],
        Again({"camera": [*refused, last]}),
        recorder,
        interruption=interruption,
        changes=changes,
    )
    driver.run()
    assert ("failed" in recorder.history["camera"]) == (not live)
    assert pauses == ([1, 2, 3] if live else [])
    assert (last.read >= 20) == live


def test_a_run_ends_at_once_though_a_camera_waits_for_its_disk(monkeypatch: pytest.MonkeyPatch) -> None:
    interruption, recorder = Interruption(), Recorder()
    full = FakeStream(10**9, fails_at=8, error=UnwritableError("No space left on device."))
    monkeypatch.setattr(driver_module, "retry_seconds", lambda failures: 3600.0)

    def changes() -> SpecChange | None:
        if full.stops:
            interruption.signal_number = signal.SIGTERM
        return None

    driver = driver_of(
        [replace(spec("camera"), live=True)],
        FakeHost({"camera": full}),
        recorder,
        interruption=interruption,
        changes=changes,
    )
    driver.run()
    assert recorder.last[0].interrupted


@pytest.mark.parametrize("interrupted", [True, False])
def test_a_stream_of_an_earlier_run_that_the_list_names_again_goes_on_unless_it_had_ended(
    interrupted: bool,
) -> None:
    again, interruption = FakeStream(8), Interruption()
    earlier = StreamState("camera", "done", read=40, committed=40, live=True, interrupted=interrupted)
    left = [SpecChange(added=(spec("camera"),)), None, None]

    def changes() -> SpecChange | None:
        if not left and (again.stops or not interrupted):
            interruption.signal_number = signal.SIGTERM
        return left.pop(0) if left else None

    host = FakeHost({"camera": again})
    driver = driver_of(
        [], host, interruption=interruption, changes=changes, known=KnownStreams(ended={"camera": earlier})
    )
    assert driver.states == (earlier,)
    driver.run()
    assert host.started == (["camera"] if interrupted else [])
    assert [state.name for state in driver.states] == ["camera"]


def test_a_stream_removed_twice_and_settings_of_one_that_ended_earlier_change_nothing() -> None:
    interruption = Interruption()
    ended = StreamState("film", "done", read=4, committed=4)
    left = [
        SpecChange(removed=("waits",)),
        SpecChange(removed=("waits",)),
        SpecChange(added=(spec("film"),)),
        SpecChange(reopened=(spec("film"),), restarted=(spec("film"),), configured=((spec("film"), {}),)),
    ]

    def changes() -> SpecChange | None:
        if not left:
            interruption.signal_number = signal.SIGTERM
        return left.pop(0) if left else None

    host = FakeHost({"waits": FakeStream(8), "film": FakeStream(4)})
    driver = driver_of(
        ["waits"],
        host,
        at_once=0,
        interruption=interruption,
        changes=changes,
        known=KnownStreams(ended={"film": ended}),
    )
    driver.run()
    assert driver.states == (ended,)
    assert host.started == []
