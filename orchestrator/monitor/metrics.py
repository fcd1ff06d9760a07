"""The figures of the streams as Prometheus knows them, and its text format for the monitor's own page."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

from orchestrator.stream_state import StreamState

__all__ = ["CONTENT_TYPE", "METRICS", "STATE", "STATE_MEANING", "Metric", "metrics_text"]

CONTENT_TYPE = "text/plain; version=0.0.4; charset=utf-8"


@dataclass(frozen=True, slots=True)
class Metric:
    """A figure of every stream, with the label ``stream``.

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
)

#: Gauge that is 1 for the state that a stream is in, which its label ``state`` tells.
STATE = "mlbs_stream_state"
STATE_MEANING = "1 for the state of the stream."


def metrics_text(states: Sequence[StreamState]) -> str:
    """Write :data:`METRICS` and :data:`STATE` of the streams."""
    lines = []
    for one in METRICS:
        lines += [f"# HELP {one.name} {one.meaning}", f"# TYPE {one.name} {one.kind}"]
        lines += [
            f'{one.name}{{stream="{_escaped(state.name)}"}} {float(one.value(state))!r}' for state in states
        ]
    lines += [f"# HELP {STATE} {STATE_MEANING}", f"# TYPE {STATE} gauge"]
    lines += [f'{STATE}{{stream="{_escaped(state.name)}",state="{state.state}"}} 1' for state in states]
    return "\n".join(lines) + "\n"


def _escaped(text: str) -> str:
    return text.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")
