"""Prometheus metrics of the streams, their counts and the targets of events, and the text of the page."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from orchestrator.counts.stream_counts import StreamCounts
from orchestrator.events.delivery import Backlog
from orchestrator.run.stream_state import StreamState

__all__ = [
    "CONTENT_TYPE",
    "COUNT_METRICS",
    "METRICS",
    "STATE",
    "STATE_MEANING",
    "TARGET_METRICS",
    "CountMetric",
    "Metric",
    "MetricsText",
    "Reached",
    "TargetMetric",
]

CONTENT_TYPE = "text/plain; version=0.0.4; charset=utf-8"


@dataclass(frozen=True, slots=True)
class Metric:
    """A metric of every stream, with the label ``stream``.

    Attributes
    ----------
    name : str
    kind : {"counter", "gauge"}
    meaning : str
        A sentence.
    value : callable
        Takes a stream's state.
    """

    name: str
    kind: Literal["counter", "gauge"]
    meaning: str
    value: Callable[[StreamState], float]


METRICS = (
    Metric("mlbs_stream_read_frames_total", "counter", "Frames taken from the source.", lambda s: s.read),
    Metric(
        "mlbs_stream_committed_frames_total",
        "counter",
        "Label maps safely on the disk.",
        lambda s: s.committed,
    ),
    Metric("mlbs_stream_dropped_frames_total", "counter", "Frames that were dropped.", lambda s: s.dropped),
    Metric(
        "mlbs_stream_undecodable_frames_total",
        "counter",
        "Frames that could not be decoded.",
        lambda s: s.quarantined,
    ),
    Metric(
        "mlbs_stream_gaps_total",
        "counter",
        "Times in which a camera sent nothing, was away, or was not read.",
        lambda s: s.gaps,
    ),
    Metric(
        "mlbs_stream_returns_total",
        "counter",
        "Times it lost a process, or hung, and went back to its last snapshot.",
        lambda s: s.returns,
    ),
    Metric(
        "mlbs_stream_queued_frames",
        "gauge",
        "Frames read that are neither committed nor lost.",
        lambda s: s.queued,
    ),
    Metric("mlbs_stream_layers", "gauge", "Live layers, the background included.", lambda s: s.layers),
    Metric(
        "mlbs_stream_frames_per_second",
        "gauge",
        "Frames read a second lately.",
        lambda s: s.frames_per_second,
    ),
    Metric(
        "mlbs_stream_latency_seconds",
        "gauge",
        "For how long a frame was worked on lately.",
        lambda s: s.latency_ms / 1000,
    ),
    Metric(
        "mlbs_stream_cores",
        "gauge",
        "Cores that its processes keep busy if no frame is dropped.",
        lambda s: s.cores,
    ),
    Metric("mlbs_stream_memory_bytes", "gauge", "Unique memory of its processes.", lambda s: s.memory),
)


@dataclass(frozen=True, slots=True)
class TargetMetric:
    """A gauge of every target of events, with the label ``target``; as :class:`Metric`."""

    name: str
    meaning: str
    value: Callable[[Backlog], float]


TARGET_METRICS = (
    TargetMetric("mlbs_events_waiting", "Events that a target has not acknowledged.", lambda b: b.waiting),
    TargetMetric(
        "mlbs_events_away_seconds", "For how long a target has accepted nothing.", lambda b: b.away_seconds
    ),
    TargetMetric("mlbs_events_refused", "Events that a target has refused.", lambda b: b.refused),
)


@dataclass(frozen=True, slots=True)
class CountMetric:
    """A metric of what is counted in every stream, as :class:`Metric`.

    Attributes
    ----------
    name : str
    kind : {"counter", "gauge"}
    meaning : str
        A sentence.
    labels : tuple of str
        Besides ``stream``.
    values : callable
        Takes a stream's counts; yields the values of those labels, and a number.
    """

    name: str
    kind: Literal["counter", "gauge"]
    meaning: str
    labels: tuple[str, ...]
    values: Callable[[StreamCounts], Iterator[tuple[tuple[str, ...], int]]]


COUNT_METRICS = (
    CountMetric(
        "mlbs_zone_objects",
        "gauge",
        "Objects in a zone, as of the last commit.",
        ("zone",),
        lambda counts: (((zone,), number) for zone, number in counts.zones.items()),
    ),
    CountMetric(
        "mlbs_line_crossings_total",
        "counter",
        "Crossings of a line.",
        ("line", "direction"),
        lambda counts: (
            ((line, direction), number)
            for line, directions in counts.crossings.items()
            for direction, number in directions.items()
        ),
    ),
    CountMetric(
        "mlbs_events_total",
        "counter",
        "Events of the record.",
        ("kind",),
        lambda counts: (((kind,), number) for kind, number in counts.events.items()),
    ),
)

#: Gauge that is 1 for a stream's current state, which is in its label ``state``.
STATE = "mlbs_stream_state"
STATE_MEANING = "1 for the state of the stream."


class Reached:
    """Progress of the streams' counters.

    A stream that goes back to a snapshot reads frames again. They are counted once: Prometheus takes a
    decreasing counter for a restarted program, and would count all its frames again.
    """

    def __init__(self) -> None:
        self._values: dict[tuple[str, str], float] = {}

    def advance(self, counter: Metric, state: StreamState) -> tuple[float | None, float]:
        """Return the value before, None the first time, and now."""
        place = counter.name, state.name
        before = self._values.get(place)
        self._values[place] = now = max(before or 0.0, counter.value(state))
        return before, now


class MetricsText:
    """Formats the metrics of the streams and of the targets of events, for any thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._reached = Reached()

    def __call__(
        self,
        states: Sequence[StreamState],
        backlogs: Sequence[Backlog] = (),
        counts: Mapping[str, StreamCounts] | None = None,
    ) -> str:
        """Return the text of these states, backlogs, and counts by stream."""
        lines = []
        for one in METRICS:
            lines += [f"# HELP {one.name} {one.meaning}", f"# TYPE {one.name} {one.kind}"]
            lines += [
                f'{one.name}{{stream="{_escaped(state.name)}"}} {self._value(one, state)!r}'
                for state in states
            ]
        lines += [f"# HELP {STATE} {STATE_MEANING}", f"# TYPE {STATE} gauge"]
        lines += [f'{STATE}{{stream="{_escaped(state.name)}",state="{state.state}"}} 1' for state in states]
        for gauge in TARGET_METRICS if backlogs else ():
            lines += [f"# HELP {gauge.name} {gauge.meaning}", f"# TYPE {gauge.name} gauge"]
            lines += [
                f'{gauge.name}{{target="{_escaped(one.target)}"}} {float(gauge.value(one))!r}'
                for one in backlogs
            ]
        for of_counts in COUNT_METRICS if counts else ():
            lines += [
                f"# HELP {of_counts.name} {of_counts.meaning}",
                f"# TYPE {of_counts.name} {of_counts.kind}",
                *_samples(of_counts, counts or {}),
            ]
        return "\n".join(lines) + "\n"

    def _value(self, one: Metric, state: StreamState) -> float:
        if one.kind == "gauge":
            return float(one.value(state))
        with self._lock:
            return float(self._reached.advance(one, state)[1])


def _samples(one: CountMetric, counts: Mapping[str, StreamCounts]) -> Iterator[str]:
    for stream, counted in counts.items():
        for values, number in one.values(counted):
            pairs = zip(("stream", *one.labels), (stream, *values), strict=True)
            labels = ",".join(f'{name}="{_escaped(value)}"' for name, value in pairs)
            yield f"{one.name}{{{labels}}} {number}"


def _escaped(text: str) -> str:
    return text.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")
