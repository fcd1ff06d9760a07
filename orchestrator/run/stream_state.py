"""The states of a run's streams, and the pure rules by which they change."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

from mlbs_actors.actors.stream.protocol import StreamProgress
from mlbs_actors.source import SourceSilence
from mlbs_actors.wording import count_of
from orchestrator.credentials import mask

__all__ = [
    "ENDED",
    "StateName",
    "StreamState",
    "after_change",
    "after_end",
    "after_failure",
    "after_interruption",
    "after_loss",
    "after_progress",
    "after_refusal",
    "after_removal",
    "after_start",
    "exit_code",
    "frames_left",
    "has_ended",
    "stopped",
    "with_record",
]

StateName = Literal["waiting", "starting", "running", "stalled", "reconnecting", "done", "partial", "failed"]

#: Final states.
ENDED: frozenset[StateName] = frozenset({"done", "partial", "failed"})


@dataclass(frozen=True, slots=True)
class StreamState:
    """One stream as the user sees it.

    Attributes
    ----------
    name : str
    state : StateName
    read, committed, dropped, quarantined, gaps : int
        See :class:`mlbs_actors.actors.stream.protocol.StreamProgress`.
    layers : int
        Live layers, the background included.
    objects : int
        Objects in the newest label map: layers that own a pixel of it.
    frames_per_second : float
        Recent rate at which frames were read; 0 when not running, and while a camera sends nothing.
    latency_ms : float
        Recent processing time of a frame, the sum of its stages, ms; 0 while it is unknown.
    error : str, optional
        A sentence, without credentials.
    line : int, optional
        Line number in the list, from 1.
    returns : int
        How often it lost a process, or hung, and went back to its last snapshot.
    interrupted : bool
        It was stopped before its end, by a signal or because it left the list, and can continue.
    length : int, optional
        Final number of frames read, according to its source.
    without_process : int
        Most layers at once without a process of their own because memory was too short.
    live : bool
        Whether it is a camera's.
    cores : float
        Cores that its processes keep busy if no frame is dropped; 0 while it is unknown.
    earlier_cores : float
        The same of a camera in the run that this one resumes, or before a signal stopped it.
    memory : int
        Their unique memory, bytes.
    waits_for : str, optional
        What a waiting or starting stream waits for.
    node : str, optional
        Of a cluster, where its processes are or were last.
    """

    name: str
    state: StateName = "waiting"
    read: int = 0
    committed: int = 0
    dropped: int = 0
    quarantined: int = 0
    gaps: int = 0
    layers: int = 0
    frames_per_second: float = 0.0
    latency_ms: float = 0.0
    error: str | None = None
    line: int | None = None
    returns: int = 0
    interrupted: bool = False
    length: int | None = None
    without_process: int = 0
    objects: int = 0
    live: bool = False
    cores: float = 0.0
    earlier_cores: float = 0.0
    memory: int = 0
    waits_for: str | None = None
    node: str | None = None

    @property
    def endless(self) -> bool:
        """Whether it is a camera's without ``--max-frames``, which only a signal or the list ends."""
        return self.live and self.length is None

    @property
    def queued(self) -> int:
        """Frames that were read but are neither committed nor lost."""
        return max(self.read - self.committed - self.dropped - self.quarantined, 0)

    @property
    def rank(self) -> int:
        """Display order: 0 running, 1 failed or partial, 2 waiting, 3 done."""
        if self.state not in ENDED and self.state != "waiting":
            return 0
        return {"failed": 1, "partial": 1, "waiting": 2}.get(self.state, 3)

    @property
    def seconds_left(self) -> float | None:
        """Time until all is read at the recent rate, s; None if unknown."""
        if self.length is None or not self.frames_per_second:
            return None
        return max(self.length - self.read, 0) / self.frames_per_second

    @property
    def memory_note(self) -> str | None:
        """State that memory was too short for its objects' processes, or None."""
        if not self.without_process:
            return None
        return (
            f"Memory was too short: up to {count_of(self.without_process, 'layer')} at once had no process "
            "of their own. Labels are the same, frames take longer."
        )

    def figures(self) -> dict[str, Any]:
        """All displayed values, by name."""
        derived = {"queued": self.queued, "seconds_left": self.seconds_left}
        return {
            key: round(value, 2) if isinstance(value, float) else value
            for key, value in (asdict(self) | derived).items()
        }


def after_start(state: StreamState) -> StreamState:
    """Return the state of a stream whose processes are starting."""
    return replace(state, state="starting", waits_for="its processes and its first frames")


def after_progress(
    state: StreamState, progress: StreamProgress, frames_per_second: float, cores: float | None = None
) -> StreamState:
    """Return the state after a burst of frames of a stream that continues; ``cores`` is None if unknown."""
    silence = progress.silence or SourceSilence(None)
    error = silence.reason or progress.problem
    name: StateName = silence.state or ("running" if progress.read else "starting")
    return replace(
        state,
        state=name,
        read=progress.read,
        committed=progress.committed,
        dropped=progress.dropped,
        quarantined=progress.quarantined,
        gaps=progress.gaps,
        layers=progress.layers,
        objects=progress.objects,
        frames_per_second=0.0 if silence.state else frames_per_second,
        latency_ms=sum(progress.stage_ms.values()) or state.latency_ms,
        error=None if error is None else mask(error),
        length=progress.length,
        without_process=max(state.without_process, progress.without_process),
        cores=state.cores if cores is None else cores,
        memory=progress.memory,
        waits_for=state.waits_for if name == "starting" else None,
    )


def after_end(state: StreamState, progress: StreamProgress) -> StreamState:
    """Return the state after the source's end: done, partial if damaged, failed without a label map."""
    counted = _ended(after_progress(state, progress, 0.0))
    if counted.committed == 0:
        return after_failure(counted, counted.error or "The source holds no frame that could be decoded.")
    if counted.error is not None:
        return replace(counted, state="partial")
    if counted.quarantined:
        lost = count_of(counted.quarantined, "frame")
        return replace(counted, state="partial", error=f"{lost} could not be decoded.")
    return replace(counted, state="done")


def after_failure(state: StreamState, error: str) -> StreamState:
    """Return the state after an error that ended the stream; its counts stay."""
    return replace(_ended(state), state="failed", error=mask(error))


def after_loss(state: StreamState, error: str) -> StreamState:
    """Return the state of a stream that lost a process and will continue from its last snapshot."""
    return replace(
        after_failure(state, error),
        state="starting",
        returns=state.returns + 1,
        cores=state.cores,
        waits_for="new processes and its last snapshot",
    )


def after_refusal(state: StreamState, error: str) -> StreamState:
    """Return the state of a camera's stream that will continue when its disk can be written to again."""
    failed = after_failure(state, error)
    return replace(failed, state="starting", cores=state.cores, waits_for="a disk that can be written to")


def after_change(state: StreamState) -> StreamState:
    """Return the state of a stream that goes on with other processes, as its settings have changed."""
    return replace(
        _ended(state), state="starting", cores=state.cores, waits_for="new processes, for its other settings"
    )


def with_record(state: StreamState, recorded: int) -> StreamState:
    """Return the state of a failed stream with the counts of its record: its last burst has not reported.

    Parameters
    ----------
    state : StreamState
    recorded : int
        Rows in the stream's commit log, those without a label map included.
    """
    if state.state != "failed":
        return state
    frames = recorded - state.gaps
    committed = max(state.committed, frames - state.quarantined - state.dropped)
    return replace(state, committed=committed, read=max(state.read, frames))


def after_interruption(state: StreamState, progress: StreamProgress | None) -> StreamState:
    """Return the state of a running stream that was stopped by a signal and drained to ``progress``."""
    counted = state if progress is None else after_progress(state, progress, 0.0)
    interrupted = replace(_ended(counted), interrupted=True)
    if state.live:
        interrupted = replace(interrupted, earlier_cores=counted.cores or counted.earlier_cores)
    if state.endless and progress is not None:
        return replace(interrupted, state="done", error=None)
    kept = "what was read is kept" if progress is not None else "what was committed is kept"
    sentence = f"Interrupted after {count_of(counted.read, 'frame')}; {kept}."
    return replace(interrupted, state="partial", error=sentence)


def stopped(states: Iterable[StreamState]) -> tuple[StreamState, ...]:
    """Return the states of a run that is ended at once, without waiting for its streams."""
    return tuple(
        state if state.state in ENDED or state.state == "waiting" else after_interruption(state, None)
        for state in states
    )


def after_removal(state: StreamState, progress: StreamProgress | None) -> StreamState:
    """Return the state of a stream that was removed from the list and drained to ``progress``."""
    if progress is not None and progress.committed:
        return replace(after_end(state, progress), interrupted=True, line=None)
    sentence = "Removed from the list before it had a result."
    if state.committed:
        sentence = "Removed from the list; what was committed is kept."
    return replace(_ended(state), state="partial", error=sentence, interrupted=True, line=None)


def _ended(state: StreamState) -> StreamState:
    """Return a state without what only a stream with processes has."""
    return replace(state, layers=0, objects=0, frames_per_second=0.0, cores=0.0, memory=0, waits_for=None)


def has_ended(state: StreamState) -> bool:
    """Whether a stream is at its end, so that resuming the run leaves it alone."""
    return state.state in ("done", "partial") and not state.interrupted


def frames_left(states: Iterable[StreamState]) -> tuple[int, bool]:
    """Count the frames of all files that are still to be read.

    Returns
    -------
    int
    bool
        Whether there are more, because not all files that wait have a known length.
    """
    going_on = [state for state in states if state.state not in ENDED]
    frames = sum(max(state.length - state.read, 0) for state in going_on if state.length is not None)
    return frames, any(state.length is None and state.state in ("waiting", "starting") for state in going_on)


def exit_code(states: Iterable[StreamState], signal_number: int | None) -> int:
    """Return the exit status of a run: 0, 1, or 128 + the number of the signal that interrupted it.

    Endless streams are at their end when a signal comes, if they could be stopped in order.
    """
    states = tuple(states)
    if signal_number is not None and any(_is_unfinished(state) for state in states):
        return 128 + signal_number
    stopped_in_order = (state.state == "done" or state.state not in ENDED for state in states)
    return 0 if all(stopped_in_order) else 1


def _is_unfinished(state: StreamState) -> bool:
    """Whether a stream with an end has not come to it."""
    return not state.endless and (state.state not in ENDED or (state.interrupted and state.state != "done"))
