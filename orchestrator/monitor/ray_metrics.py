"""The figures of the streams told to Ray's own metrics, which its exporter gives to a Prometheus."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from ray.util.metrics import Counter, Gauge

from orchestrator.monitor.metrics import METRICS, STATE, STATE_MEANING, Reached
from orchestrator.run.stream_state import StreamState

__all__ = ["RayMetrics"]

#: Ray takes no 0, but a counter must be there before it counts, or nobody sees it begin. A sum loses this.
_NOTHING = sys.float_info.min


class RayMetrics:
    """An observer of the driver; Ray writes ``ray_`` before the names and adds labels of its own."""

    def __init__(self) -> None:
        self._counters = {
            one: Counter(one.name, one.meaning, ("stream",)) for one in METRICS if one.kind == "counter"
        }
        self._gauges = {
            one: Gauge(one.name, one.meaning, ("stream",)) for one in METRICS if one.kind == "gauge"
        }
        self._state = Gauge(STATE, STATE_MEANING, ("stream", "state"))
        self._reached = Reached()
        self._told: dict[str, StreamState] = {}

    def update(self, states: Sequence[StreamState]) -> None:
        """Tell what has changed."""
        for state in states:
            if self._told.get(state.name) != state:
                self._tell(state)
        for name in self._told.keys() - {state.name for state in states}:
            # Ray goes on exporting whatever it was told of a stream that is no more.
            self._tell(StreamState(name))
            self._state.set(0, {"stream": name, "state": self._told.pop(name).state})

    def _tell(self, state: StreamState) -> None:
        stream = {"stream": state.name}
        for one, counter in self._counters.items():
            reached, now = self._reached.advance(one, state)
            if reached is None:
                counter.inc(_NOTHING, stream)
            if now > (reached or 0):
                counter.inc(now - (reached or 0), stream)
        for one, gauge in self._gauges.items():
            gauge.set(one.value(state), stream)
        before = self._told.get(state.name)
        if before is not None and before.state != state.state:
            self._state.set(0, stream | {"state": before.state})
        self._state.set(1, stream | {"state": state.state})
        self._told[state.name] = state
