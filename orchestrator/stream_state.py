"""How each stream of a run stands: the states, and the pure rules by which they change."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Literal

from mlbs_actors.actors.stream_protocol import StreamProgress
from orchestrator.credentials import mask

__all__ = [
    "ENDED",
    "StateName",
    "StreamState",
    "after_end",
    "after_failure",
    "after_interruption",
    "after_loss",
    "after_progress",
    "exit_code",
    "with_record",
]

StateName = Literal["waiting", "starting", "running", "stalled", "reconnecting", "done", "partial", "failed"]

#: States that a stream does not leave.
ENDED: frozenset[StateName] = frozenset({"done", "partial", "failed"})


@dataclass(frozen=True, slots=True)
class StreamState:
    """One stream as the user sees it.

    Attributes
    ----------
    name : str
    state : StateName
    read, committed, dropped, quarantined : int
        Frames; see :class:`mlbs_actors.actors.stream_protocol.StreamProgress`.
    layers : int
        Live layers, the background included.
    frames_per_second : float
        Recent rate at which frames were read; 0 when not running.
    error : str, optional
        A sentence, without credentials.
    returns : int
        How often it lost a process, or hung, and went back to its last snapshot.
    interrupted : bool
        A signal ended it before its end.
    """

    name: str
    state: StateName = "waiting"
    read: int = 0
    committed: int = 0
    dropped: int = 0
    quarantined: int = 0
    layers: int = 0
    frames_per_second: float = 0.0
    error: str | None = None
    returns: int = 0
    interrupted: bool = False


def after_progress(state: StreamState, progress: StreamProgress, frames_per_second: float) -> StreamState:
    """State after a burst of frames, the stream going on."""
    return replace(
        state,
        state="running" if progress.read else "starting",
        read=progress.read,
        committed=progress.committed,
        dropped=progress.dropped,
        quarantined=progress.quarantined,
        layers=progress.layers,
        frames_per_second=frames_per_second,
        error=None if progress.problem is None else mask(progress.problem),
    )


def after_end(state: StreamState, progress: StreamProgress) -> StreamState:
    """State after the source's end: done if whole, partial if damaged, failed if it gave no label map."""
    counted = replace(after_progress(state, progress, 0.0), layers=0)
    if counted.committed == 0:
        return after_failure(counted, counted.error or "The source holds no frame that could be decoded.")
    if counted.error is not None:
        return replace(counted, state="partial")
    if counted.quarantined:
        return replace(counted, state="partial", error=f"{counted.quarantined} frames could not be decoded.")
    return replace(counted, state="done")


def after_failure(state: StreamState, error: str) -> StreamState:
    """State after an error that ended the stream; its counts stay."""
    return replace(state, state="failed", layers=0, frames_per_second=0.0, error=mask(error))


def after_loss(state: StreamState, error: str) -> StreamState:
    """State of a stream that lost a process and will go on from its last snapshot."""
    lost = after_failure(state, error)
    return replace(lost, state="starting", returns=state.returns + 1)


def with_record(state: StreamState, recorded: int) -> StreamState:
    """State of a failed stream with what its record holds: its last burst ended without telling.

    Parameters
    ----------
    state : StreamState
    recorded : int
        Frames in the stream's commit log, those without a label map included.
    """
    if state.state != "failed":
        return state
    committed = max(state.committed, recorded - state.quarantined - state.dropped)
    return replace(state, committed=committed, read=max(state.read, recorded))


def after_interruption(state: StreamState, progress: StreamProgress | None) -> StreamState:
    """State of a running stream that was stopped by a signal, after it was drained to ``progress``."""
    counted = state if progress is None else after_progress(state, progress, 0.0)
    kept = "what was read is kept" if progress is not None else "what was committed is kept"
    sentence = f"Interrupted after {counted.read} frames; {kept}."
    return replace(
        counted, state="partial", layers=0, frames_per_second=0.0, error=sentence, interrupted=True
    )


def exit_code(states: Iterable[StreamState], signal_number: int | None) -> int:
    """Exit status of the run: 0, 1, or 128 + the number of the signal that interrupted it."""
    if signal_number is not None:
        return 128 + signal_number
    return 0 if all(state.state == "done" for state in states) else 1
