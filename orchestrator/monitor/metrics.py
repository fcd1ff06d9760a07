"""The monitor's figures as Prometheus reads them, in its text format."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from orchestrator.stream_state import StreamState

__all__ = ["CONTENT_TYPE", "metrics_text"]

CONTENT_TYPE = "text/plain; version=0.0.4; charset=utf-8"

_PREFIX = "mlbs_stream_"
_METRICS: tuple[tuple[str, str, str, Callable[[StreamState], float]], ...] = (
    ("read_frames_total", "counter", "Frames taken from the source.", lambda state: state.read),
    ("committed_frames_total", "counter", "Label maps safely on the disk.", lambda state: state.committed),
    ("dropped_frames_total", "counter", "Frames that were dropped.", lambda state: state.dropped),
    ("undecodable_frames_total", "counter", "Frames that could not be decoded.", lambda s: s.quarantined),
    ("queued_frames", "gauge", "Frames read that are neither committed nor lost.", lambda s: s.queued),
    ("layers", "gauge", "Live layers, the background included.", lambda state: state.layers),
    ("frames_per_second", "gauge", "Frames read a second lately.", lambda state: state.frames_per_second),
    ("latency_seconds", "gauge", "For how long a frame was worked on lately.", lambda s: s.latency_ms / 1000),
)


def metrics_text(states: Sequence[StreamState]) -> str:
    """Write the states of the streams; every metric has the label ``stream``.

    ``mlbs_stream_state`` is 1 for the state that a stream is in, which its label ``state`` tells.
    """
    lines = []
    for name, kind, meaning, value in _METRICS:
        lines += [f"# HELP {_PREFIX}{name} {meaning}", f"# TYPE {_PREFIX}{name} {kind}"]
        lines += [
            f'{_PREFIX}{name}{{stream="{_escaped(state.name)}"}} {float(value(state))!r}' for state in states
        ]
    lines += [f"# HELP {_PREFIX}state 1 for the state of the stream.", f"# TYPE {_PREFIX}state gauge"]
    lines += [
        f'{_PREFIX}state{{stream="{_escaped(state.name)}",state="{state.state}"}} 1' for state in states
    ]
    return "\n".join(lines) + "\n"


def _escaped(text: str) -> str:
    return text.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")
