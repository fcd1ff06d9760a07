"""Streams that read nothing, and their host, for the tests of the driver."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field
from typing import Any

from mlbs_actors.actors.stream.protocol import RunningStream, StreamHost, StreamProgress, StreamSpec
from mlbs_actors.config import Config
from mlbs_actors.errors import SourceError
from mlbs_actors.source import FrameReader
from orchestrator.interruption import Interruption
from orchestrator.run.admission import by_count
from orchestrator.run.driver import Driver, Observer
from orchestrator.run.stream_state import StateName, StreamState

BURST = 4


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


def driver_of(
    streams: Iterable[StreamSpec | str],
    host: StreamHost,
    *observers: Observer,
    at_once: int | Callable[[int], int] = 1,
    interruption: Interruption | None = None,
    **others: Any,
) -> Driver:
    """Return the driver of streams, which are given or named; of all else it has what is ``others``."""
    return Driver(
        [spec(one) if isinstance(one, str) else one for one in streams],
        host,
        admission=by_count(at_once),
        observers=observers,
        interruption=interruption or Interruption(),
        **others,
    )
