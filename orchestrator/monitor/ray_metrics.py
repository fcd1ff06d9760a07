"""The metrics of the streams reported through Ray, whose exporter serves them to Prometheus."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence

from ray.util.metrics import Counter, Gauge

from orchestrator.counts.stream_counts import StreamCounts
from orchestrator.events.delivery import Backlog
from orchestrator.monitor.metrics import (
    COUNT_METRICS,
    METRICS,
    STATE,
    STATE_MEANING,
    TARGET_METRICS,
    CountMetric,
    Reached,
)
from orchestrator.run.stream_state import StreamState

__all__ = ["RayMetrics"]

#: Least time between two looks at what is counted, and at what waits for the targets of events, s.
_LOOK_SECONDS = 1.0

#: Replaces 0, which Ray drops: a counter must exist before it counts. It does not affect sums.
_NOTHING = sys.float_info.min


class RayMetrics:
    """An observer of the driver; Ray writes ``ray_`` before the names and adds labels of its own.

    Parameters
    ----------
    backlogs : callable
        Returns what the targets of events have not acknowledged.
    clock : callable
        Monotonic time, s.
    counts : callable, optional
        Takes the name of a stream; returns what was counted in it.
    """

    def __init__(
        self,
        backlogs: Callable[[], Sequence[Backlog]] = list,
        clock: Callable[[], float] = time.monotonic,
        counts: Callable[[str], StreamCounts] | None = None,
    ) -> None:
        self._backlogs = backlogs
        self._counts = counts
        self._of_counts: dict[CountMetric, Counter | Gauge] = {
            one: (Counter if one.kind == "counter" else Gauge)(one.name, one.meaning, ("stream", *one.labels))
            for one in COUNT_METRICS
        }
        self._counted: dict[CountMetric, dict[tuple[str, ...], int]] = {one: {} for one in COUNT_METRICS}
        self._clock = clock
        self._looked = float("-inf")
        self._of_targets = {one: Gauge(one.name, one.meaning, ("target",)) for one in TARGET_METRICS}
        self._counters = {
            one: Counter(one.name, one.meaning, ("stream",)) for one in METRICS if one.kind == "counter"
        }
        self._gauges = {
            one: Gauge(one.name, one.meaning, ("stream",)) for one in METRICS if one.kind == "gauge"
        }
        self._state = Gauge(STATE, STATE_MEANING, ("stream", "state"))
        self._reached = Reached()
        self._reported: dict[str, StreamState] = {}

    def update(self, states: Sequence[StreamState]) -> None:
        """Report changes."""
        for state in states:
            if self._reported.get(state.name) != state:
                self._report(state)
        for name in self._reported.keys() - {state.name for state in states}:
            # Ray would keep exporting the last values of a stream that no longer exists.
            self._report(StreamState(name))
            self._state.set(0, {"stream": name, "state": self._reported.pop(name).state})
        if (now := self._clock()) - self._looked >= _LOOK_SECONDS:
            self._looked = now
            self._report_backlogs()
            self._report_counts([state.name for state in states])

    def _report_counts(self, streams: Sequence[str]) -> None:
        if self._counts is None:
            return
        counts = {name: self._counts(name) for name in streams}
        for one, metric in self._of_counts.items():
            now = {
                (stream, *values): number
                for stream, counted in counts.items()
                for values, number in one.value(counted)
            }
            before, self._counted[one] = self._counted[one], now
            names = ("stream", *one.labels)
            for place, number in now.items():
                labels = dict(zip(names, place, strict=True))
                if isinstance(metric, Gauge):
                    metric.set(number, labels)
                elif place not in before:
                    metric.inc(number or _NOTHING, labels)
                elif number > before[place]:
                    metric.inc(number - before[place], labels)
            if isinstance(metric, Gauge):
                for place in before.keys() - now.keys():  # Ray would keep exporting the last value
                    metric.set(0, dict(zip(names, place, strict=True)))

    def _report_backlogs(self) -> None:
        for backlog in self._backlogs():
            for one, gauge in self._of_targets.items():
                gauge.set(one.value(backlog), {"target": backlog.target})

    def _report(self, state: StreamState) -> None:
        stream = {"stream": state.name}
        for one, counter in self._counters.items():
            reached, now = self._reached.advance(one, state)
            if reached is None:
                counter.inc(_NOTHING, stream)
            if now > (reached or 0):
                counter.inc(now - (reached or 0), stream)
        for one, gauge in self._gauges.items():
            gauge.set(one.value(state), stream)
        before = self._reported.get(state.name)
        if before is not None and before.state != state.state:
            self._state.set(0, stream | {"state": before.state})
        self._state.set(1, stream | {"state": state.state})
        self._reported[state.name] = state
