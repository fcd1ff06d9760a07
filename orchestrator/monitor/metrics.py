"""Prometheus metrics of the streams, their counts and the targets of events, and the text of the page."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Generic, Literal, TypeVar

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


_Of = TypeVar("_Of")
_Value = TypeVar("_Value")


@dataclass(frozen=True, slots=True)
class Metric(Generic[_Of, _Value]):
    """A metric of every stream, with the label ``stream``, or of every target of events, with ``target``.

    Attributes
    ----------
    name : str
    kind : {"counter", "gauge"}
    meaning : str
        A sentence.
    value : callable
        Takes a stream's state, a target's backlog or a stream's counts. Of the first two it returns the
        value; of the last it yields the values of ``labels``, and a number.
    labels : tuple of str
        The others that it has.
    """

    name: str
    kind: Literal["counter", "gauge"]
    meaning: str
    value: Callable[[_Of], _Value]
    labels: tuple[str, ...] = ()


StreamMetric = Metric[StreamState, float]
TargetMetric = Metric[Backlog, float]
CountMetric = Metric[StreamCounts, Iterator[tuple[tuple[str, ...], int]]]

METRICS: tuple[StreamMetric, ...] = (
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


TARGET_METRICS: tuple[TargetMetric, ...] = (
    Metric("mlbs_events_waiting", "gauge", "Events that a target has not acknowledged.", lambda b: b.waiting),
    Metric(
        "mlbs_events_away_seconds",
        "gauge",
        "For how long a target has accepted nothing.",
        lambda b: b.away_seconds,
    ),
    Metric("mlbs_events_refused", "gauge", "Events that a target has refused.", lambda b: b.refused),
)

COUNT_METRICS: tuple[CountMetric, ...] = (
    Metric(
        "mlbs_zone_objects",
        "gauge",
        "Objects in a zone, as of the last commit.",
        lambda counts: (((zone,), number) for zone, number in counts.zones.items()),
        ("zone",),
    ),
    Metric(
        "mlbs_line_crossings_total",
        "counter",
        "Crossings of a line.",
        lambda counts: (
            ((line, direction), number)
            for line, directions in counts.crossings.items()
            for direction, number in directions.items()
        ),
        ("line", "direction"),
    ),
    Metric(
        "mlbs_events_total",
        "counter",
        "Events of the record.",
        lambda counts: (((kind,), number) for kind, number in counts.events.items()),
        ("kind",),
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

    def advance(self, counter: StreamMetric, state: StreamState) -> tuple[float | None, float]:
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
        lines: list[str] = []
        for one in METRICS:
            samples = [({"stream": state.name}, self._value(one, state)) for state in states]
            lines += _lines(one.name, one.kind, one.meaning, samples)
        now = [({"stream": state.name, "state": state.state}, 1) for state in states]
        lines += _lines(STATE, "gauge", STATE_MEANING, now)
        for gauge in TARGET_METRICS if backlogs else ():
            of_targets = [({"target": one.target}, float(gauge.value(one))) for one in backlogs]
            lines += _lines(gauge.name, gauge.kind, gauge.meaning, of_targets)
        for of_counts in COUNT_METRICS if counts else ():
            counted = [
                ({"stream": stream, **dict(zip(of_counts.labels, values, strict=True))}, number)
                for stream, all_of_it in (counts or {}).items()
                for values, number in of_counts.value(all_of_it)
            ]
            lines += _lines(of_counts.name, of_counts.kind, of_counts.meaning, counted)
        return "\n".join(lines) + "\n"

    def _value(self, one: StreamMetric, state: StreamState) -> float:
        if one.kind == "gauge":
            return float(one.value(state))
        with self._lock:
            return float(self._reached.advance(one, state)[1])


def _lines(
    name: str, kind: str, meaning: str, samples: Iterable[tuple[Mapping[str, str], float]]
) -> Iterator[str]:
    yield from (f"# HELP {name} {meaning}", f"# TYPE {name} {kind}")
    for labels, value in samples:
        words = ",".join(f'{label}="{_escaped(text)}"' for label, text in labels.items())
        yield f"{name}{{{words}}} {value!r}"


def _escaped(text: str) -> str:
    return text.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")
