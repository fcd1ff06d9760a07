"""Streams that wait for a slow program."""

from __future__ import annotations

from concurrent.futures import Future
from typing import cast

from mlbs_actors.actors.stream.protocol import RunningStream, StreamHost, StreamProgress, StreamSpec
from mlbs_actors.config import Config
from orchestrator.library.pacing import PacedHost


class CountingStream:
    """A stream of which each burst commits eight label maps."""

    def __init__(self) -> None:
        self.bursts = 0

    def advance(self) -> Future[StreamProgress]:
        self.bursts += 1
        answer: Future[StreamProgress] = Future()
        answer.set_result(StreamProgress(8 * self.bursts, 8 * self.bursts, 0, 0, 1, False))
        return answer

    def stop(self, *, drain: bool, returns: bool = False) -> StreamProgress | None:
        return None


class CountingHost:
    def __init__(self) -> None:
        self.streams: list[CountingStream] = []
        self.before: list[object] = []

    def start(self, spec: StreamSpec, before: object = None) -> CountingStream:
        self.streams.append(CountingStream())
        self.before.append(before)
        return self.streams[-1]


def _spec() -> StreamSpec:
    return StreamSpec("a", Config(), lambda: cast("object", None), lambda: cast("object", None))  # type: ignore[arg-type, return-value]


def test_a_stream_that_is_ahead_is_not_asked_for_more_and_goes_on_afterwards() -> None:
    host, taken = CountingHost(), 0
    stream = PacedHost(cast(StreamHost, host), lambda name, committed: committed - taken >= 16).start(_spec())
    seen = [stream.advance().result(timeout=60).committed for _ in range(4)]
    assert seen == [8, 16, 16, 16]
    assert host.streams[0].bursts == 2
    taken = 8
    assert stream.advance().result(timeout=60).committed == 24


def test_a_host_gets_its_own_stream_back_when_it_starts_again_and_knows_which_have_processes() -> None:
    host = CountingHost()
    paced = PacedHost(cast(StreamHost, host), lambda name, committed: False)
    first: RunningStream = paced.start(_spec())
    assert paced.running == {"a"}
    first.stop(drain=False, returns=True)
    assert paced.running == set()
    paced.start(_spec(), first)
    assert host.before == [None, host.streams[0]]
