"""Simulate a node with many streams from the measured cost of one stream.

Each actor of a stream does one frame at a time, on whichever core is free first; a sink serves several
streams. A frame waits as in a run (:mod:`mlbs_actors.actors.stream.coordinator_actor`): it is tracked once
the label map of two frames before is there, the layers wait for that of the frame before, at most eight rows
are on their way to the sink. A file is read two frames ahead; a camera's two newest pictures wait, older ones
are dropped.
"""

from __future__ import annotations

import heapq
import math
from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np

from mlbs_actors.actors.pipeline import sinks_of
from mlbs_actors.messages import Array

__all__ = ["NodeRun", "StageCosts", "most_cameras", "simulate"]

#: As in the actors: pictures that a reader keeps ahead, and rows on their way to the sink.
_PICTURES, _ROWS = 2, 14

#: Largest share of its pictures that a camera that counts as served may lose.
MOST_DROPPED = 0.01


@dataclass(frozen=True, slots=True)
class StageCosts:
    """CPU time of one frame of one stream, ms.

    Attributes
    ----------
    reader, coordinator, segmenter, sink : float
    layers : tuple of float
        Of each layer's process.
    other : float
        Of what serves the calls, outside the path of the frame.
    """

    reader: float
    coordinator: float
    layers: tuple[float, ...]
    segmenter: float
    sink: float
    other: float

    @staticmethod
    def of(cpu_ms: Mapping[str, float], objects: int) -> StageCosts:
        """Derive the costs of a stream with this many objects from measured times by kind of process."""
        each = cpu_ms["object layer"] / objects
        known = {kind: cpu_ms[kind] for kind in ("reader", "coordinator", "segmenter", "sink")}
        layers = (cpu_ms["background layer"], *[each] * objects)
        return StageCosts(
            **known, layers=layers, other=sum(cpu_ms.values()) - sum(known.values()) - sum(layers)
        )

    @property
    def together(self) -> float:
        """Return the CPU time of all, ms."""
        return self.reader + self.coordinator + sum(self.layers) + self.segmenter + self.sink + self.other


@dataclass(frozen=True, slots=True)
class NodeRun:
    """Throughput of a simulated node in steady state.

    Attributes
    ----------
    frames_a_second : float
        Label maps of all streams together.
    dropped : float
        Share of the cameras' pictures that were dropped.
    sink_busy : float
        Share of the time in which the sinks work.
    """

    frames_a_second: float
    dropped: float
    sink_busy: float


@dataclass(slots=True, eq=False)
class _Stream:
    """How many frames each actor has done, and which actors are busy."""

    layers: list[int]
    sink: int
    pictures: int = 0
    read: int = 0
    tracked: int = 0
    segmented: int = 0
    written: int = 0
    dropped: int = 0
    to_decode: int = 0  # of a camera
    busy: set[str | int] = field(default_factory=set)


def simulate(
    costs: StageCosts, streams: int, cores: int, camera_rate: float | None = None, seconds: float = 20.0
) -> NodeRun:
    """Run streams that begin at once on a node; the first fifth of the time does not count.

    Parameters
    ----------
    costs : StageCosts
    streams, cores : int
    camera_rate : float, optional
        Pictures that each stream's camera sends a second; None for files.
    seconds : float
        Simulated time, s.

    Returns
    -------
    NodeRun
    """
    node = _Node(costs, streams, cores, camera_rate is None)
    if camera_rate is not None:
        starts = np.random.default_rng(0).uniform(0.0, 1.0 / camera_rate, streams)
        for stream, start in zip(node.streams, starts.tolist(), strict=True):
            for arrival in np.arange(start, seconds, 1.0 / camera_rate).tolist():
                node.at(1e3 * arrival, stream, "arrival")
    for stream in node.streams:
        node.start_ready(stream)
    node.run_until(200.0 * seconds)
    before, sink_before = node.totals(), node.sink_ms
    node.run_until(1e3 * seconds)
    written, dropped, read = node.totals() - before
    window = 0.8 * seconds
    sink_share = (node.sink_ms - sink_before) / (1e3 * window * sinks_of(cores))
    return NodeRun(float(written / window), float(dropped / max(read, 1)), sink_share)


def most_cameras(costs: StageCosts, cores: int, camera_rate: float) -> int:
    """Return how many cameras a run serves on a node without dropping more than one picture in a hundred."""

    def serves(cameras: int) -> bool:
        return simulate(costs, cameras, cores, camera_rate).dropped <= MOST_DROPPED

    too_slow = math.ceil(1e3 * cores / (camera_rate * costs.together)) + 2  # more than there is time for
    low, high = 0, too_slow
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if serves(middle) else (low, middle)
    return low


class _Node:
    def __init__(self, costs: StageCosts, streams: int, cores: int, files: bool) -> None:
        sinks = sinks_of(cores)
        self.streams = [_Stream([0] * len(costs.layers), number % sinks) for number in range(streams)]
        self.sink_ms = 0.0
        self._costs, self._files, self._free = costs, files, cores
        self._now = 0.0
        self._events: list[tuple[float, int, _Stream, str | int]] = []
        self._number = 0  # keeps events of one time in order
        self._ready: deque[tuple[_Stream, str | int]] = deque()
        self._sink_queues: list[deque[_Stream]] = [deque() for _ in range(sinks)]
        self._sinks_at_work: set[int] = set()

    def at(self, time: float, stream: _Stream, what: str | int) -> None:
        """Schedule an event, at a time in ms."""
        heapq.heappush(self._events, (time, self._number, stream, what))
        self._number += 1

    def totals(self) -> Array:
        """Count the frames that all streams have written, dropped and read, (3,) int64."""
        counts: Array = np.array([(one.written, one.dropped, one.read) for one in self.streams])
        return np.asarray(counts.sum(axis=0))

    def run_until(self, end: float) -> None:
        """Advance to a time, ms."""
        while self._events and self._events[0][0] <= end:
            self._now, _, stream, what = heapq.heappop(self._events)
            if what == "arrival":
                stream.to_decode += 1
            else:
                self._free += 1
                stream.busy.discard(what)
                self._done(stream, what)
            self.start_ready(stream)
        self._now = end

    def start_ready(self, stream: _Stream) -> None:
        """Queue what a stream's actors can do now, and assign queued work to free cores."""
        for what in self._possible(stream):
            if what not in stream.busy:
                stream.busy.add(what)
                if what == "sink":
                    self._sink_queues[stream.sink].append(stream)
                else:
                    self._ready.append((stream, what))
        if self._sink_queues[stream.sink] and stream.sink not in self._sinks_at_work:
            self._sinks_at_work.add(stream.sink)
            self._ready.append((self._sink_queues[stream.sink].popleft(), "sink"))
        while self._free and self._ready:
            following, what = self._ready.popleft()
            self._free -= 1
            self.at(self._now + self._duration(what), following, what)

    def _possible(self, stream: _Stream) -> Iterator[str | int]:
        if stream.to_decode if not self._files else stream.pictures < _PICTURES:
            yield "read"
        in_flight = stream.tracked - stream.written
        if stream.pictures and stream.segmented >= stream.tracked - 1 and in_flight <= _ROWS:
            yield "track"
        for layer, frame in enumerate(stream.layers):
            if stream.tracked > frame and stream.segmented >= frame:
                yield layer
        if min(stream.layers) > stream.segmented:
            yield "segment"
        if stream.segmented > stream.written:
            yield "sink"

    def _duration(self, what: str | int) -> float:
        if isinstance(what, int):
            return self._costs.layers[what]
        return {
            "read": self._costs.reader,
            "track": self._costs.coordinator,
            "segment": self._costs.segmenter,
            "sink": self._costs.sink,
            "other": self._costs.other,
        }[what]

    def _done(self, stream: _Stream, what: str | int) -> None:
        if isinstance(what, int):
            stream.layers[what] += 1
        elif what == "read":
            stream.read += 1
            stream.pictures += 1
            if not self._files:
                stream.to_decode -= 1
                if stream.pictures > _PICTURES:
                    stream.pictures -= 1
                    stream.dropped += 1
        elif what == "track":
            stream.tracked += 1
            stream.pictures -= 1
        elif what == "segment":
            stream.segmented += 1
        elif what == "sink":
            stream.written += 1
            self.sink_ms += self._costs.sink
            self._sinks_at_work.discard(stream.sink)
            self._ready.append((stream, "other"))  # it takes its time, but nobody waits for it
