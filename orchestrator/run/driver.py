"""Drives all streams of a run: admits them, requests bursts of frames from each, ends them.

The rules are pure functions (:mod:`orchestrator.run.stream_state`, :mod:`orchestrator.run.admission`); here
is the loop that waits for the next event. Frames do not pass through it. One stream's failure ends that
stream alone. A stream that lost a process, or hangs, is stopped and started again; it finds its last snapshot
by itself. So is that of a camera whose disk is full, again and again, until there is room.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

from mlbs_actors.actors.stream.protocol import RunningStream, StreamHost, StreamProgress, StreamSpec
from mlbs_actors.errors import ActorLostError, MlbsError, NoPlaceError
from orchestrator.interruption import Interruption
from orchestrator.retries import retry_seconds
from orchestrator.run.admission import Admission
from orchestrator.run.load import LoadMeter
from orchestrator.run.recovery import STALL_SECONDS, START_SECONDS, Returns
from orchestrator.run.stream_state import (
    ENDED,
    StreamState,
    after_change,
    after_end,
    after_failure,
    after_interruption,
    after_loss,
    after_progress,
    after_refusal,
    after_removal,
    after_start,
    exit_code,
    has_ended,
)
from orchestrator.storage.durable_files import UnwritableError

__all__ = ["Driver", "Observer", "SpecChange"]

#: Longest time until a signal is noticed, s.
_WAKE_SECONDS = 0.2


class Observer(Protocol):
    """Displays or stores the states of the streams."""

    def update(self, states: Sequence[StreamState]) -> None:
        """Receive the states of all streams, in the order of the list; called after every change."""


@dataclass(frozen=True, slots=True)
class SpecChange:
    """What is to become of a run's streams.

    Attributes
    ----------
    added : tuple of StreamSpec
        New ones.
    removed : tuple of str
        Names of those to end.
    renamed : mapping of str to (str, callable)
        New ones that may be added only when another one has ended, which is told by the call.
    reopened : tuple of StreamSpec
        Cameras that are read from another place.
    restarted : tuple of StreamSpec
        Those to go on with other processes, as they are now.
    configured : tuple of (StreamSpec, object)
        How others are to start from now on, and what their records are to follow at once.
    """

    added: tuple[StreamSpec, ...] = ()
    removed: tuple[str, ...] = ()
    renamed: Mapping[str, tuple[str, Callable[[], None]]] = field(default_factory=dict)
    reopened: tuple[StreamSpec, ...] = ()
    restarted: tuple[StreamSpec, ...] = ()
    configured: tuple[tuple[StreamSpec, object], ...] = ()


class Driver:
    """One run over a list of streams.

    Parameters
    ----------
    specs : sequence of StreamSpec
        In the order in which they start; names are unique.
    host : StreamHost
        Starts streams; is not closed here.
    admission : Admission
        Decides which streams may run.
    observers : sequence of Observer
    interruption : Interruption
        Checked between events.
    lengths : mapping of str to int, optional
        Frames that waiting streams will read, as far as known; for display only.
    loads : mapping of str to float, optional
        Cores that cameras kept busy in the run that this one resumes.
    ended : mapping of str to StreamState, optional
        Streams that have no source, or ended in an earlier run; they are not started.
    changes : callable, optional
        Called repeatedly for streams to add and names to end; with it the run continues until a signal.
    clock : callable
        Monotonic time, s.
    """

    def __init__(
        self,
        specs: Sequence[StreamSpec],
        host: StreamHost,
        *,
        admission: Admission,
        observers: Sequence[Observer],
        interruption: Interruption,
        lengths: Mapping[str, int] | None = None,
        loads: Mapping[str, float] | None = None,
        ended: Mapping[str, StreamState] | None = None,
        changes: Callable[[], SpecChange | None] | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._specs = {spec.name: spec for spec in specs}
        lengths, loads = lengths or {}, loads or {}
        self._states = {
            spec.name: _new_state(spec, lengths.get(spec.name), loads.get(spec.name, 0.0)) for spec in specs
        } | dict(ended or {})
        self._host = host
        self._admission = admission
        self._observers = observers
        self._interruption = interruption
        self._changes = changes
        self._clock = clock
        self._loads: dict[str, LoadMeter] = {}
        self._removed: set[str] = set()  # taken from the list, and not ended yet
        self._coming: dict[str, StreamSpec] = {}  # new in the list, and not added yet
        self._renamed: dict[str, tuple[str, Callable[[], None]]] = {}
        self._restarting: dict[str, bool] = {}  # with other settings; whether by the same reader
        self._streams: dict[str, RunningStream] = {}
        self._bursts: dict[Future[StreamProgress], str] = {}
        self._asked: dict[str, float] = {}
        self._returns = {spec.name: Returns() for spec in specs}
        # Streams to be restarted.
        self._returning: dict[str, RunningStream] = {}
        self._refusals: dict[str, int] = {}  # successive ones of a disk
        self._is_ending = threading.Event()
        # A stream that ended keeps its place until its processes are gone.
        self._endings: dict[Future[StreamProgress | None], str] = {}

    @property
    def states(self) -> tuple[StreamState, ...]:
        """The current states, in the order of the list."""
        return tuple(self._states.values())

    def run(self) -> int:
        """Run all streams to their ends, or until a signal; return the run's exit status."""
        self._show()
        while self._interruption.signal_number is None:
            self._follow_list()
            self._add_coming()
            self._admit()
            if self._changes is None and not (self._bursts or self._endings or self._waiting()):
                break
            self._await_next()
        else:
            self._drain()
        return exit_code(self.states, self._interruption.signal_number)

    def _follow_list(self) -> None:
        change = None if self._changes is None else self._changes()
        if change is None:
            return
        for name in change.removed:
            if self._coming.pop(name, None) is not None:
                for known in (self._renamed, self._returning, self._restarting):
                    known.pop(name, None)
                continue
            if self._states[name].state != "waiting":
                if name in self._streams or name in self._returning:
                    self._removed.add(name)  # it is ended after its burst
            elif self._returning.pop(name, None) is None:
                del self._states[name]
            else:
                self._states[name] = after_removal(self._states[name], None)
        self._coming |= {spec.name: spec for spec in change.added}
        self._renamed |= change.renamed
        for spec in change.reopened:
            if spec.name in self._streams and spec.name not in self._restarting:
                self._specs[spec.name] = spec
                self._streams[spec.name].reopen(spec.open_reader)
            else:
                self._restart(spec)
        for spec in change.restarted:
            self._restart(spec)
        for spec, settings in change.configured:
            held = self._coming if spec.name in self._coming else self._specs
            held[spec.name] = spec
            if spec.name in self._streams:
                self._streams[spec.name].configure(settings)
        self._show()

    def _restart(self, spec: StreamSpec) -> None:
        """Have a stream go on as it is to be now: after its burst, or when it starts."""
        name = spec.name
        known = self._coming if name in self._coming else self._specs
        same_reader = name in known and spec.open_reader == known[name].open_reader
        known[name] = spec
        if known is self._specs and (state := self._states[name]).state in ENDED:
            self._coming[name] = spec
            if state.live:  # which was given up
                self._states[name] = replace(state, interrupted=True)
        elif any(name in streams for streams in (self._streams, self._returning, self._renamed)):
            self._restarting[name] = same_reader and self._restarting.get(name, True)

    def _add_coming(self) -> None:
        """Add the streams of new lines; one that comes back, once its processes are gone."""
        ending = {*self._removed, *self._endings.values()}
        working = {*ending, *self._streams, *self._returning}
        for name in list(self._coming):
            if name in ending or (name in self._renamed and self._renamed[name][0] in working):
                continue
            spec = self._coming.pop(name)
            if name in self._renamed:
                before, ended = self._renamed.pop(name)
                self._states.pop(before, None)
                ended()
            if name in self._states and has_ended(self._states[name]):
                continue
            self._specs[name] = spec
            self._returns[name] = Returns()
            self._states[name] = _new_state(spec)
            self._show()

    def _admit(self) -> None:
        # One at a time: if a stream fails at once, its place is free for the next.
        while name := (verdict := self._admission(self.states, self._endings.values())).start:
            self._set(after_start(self._states[name]))
            self._start(name)
        for state in self.states:
            if state.state == "waiting" and state.waits_for != (reason := verdict.waits_for(state)):
                self._states[state.name] = replace(state, waits_for=reason)

    def _waiting(self) -> int:
        return sum(state.state == "waiting" for state in self.states)

    def _start(self, name: str) -> None:
        self._loads[name] = LoadMeter(self._clock)
        spec = replace(self._specs[name], last_try=self._returns[name].last_try)
        try:
            before = self._returning.get(name) if self._restarting.get(name, True) else None
            self._streams[name] = self._host.start(spec, before)
            self._returning.pop(name, None)
            self._restarting.pop(name, None)
            self._states[name] = replace(self._states[name], node=self._streams[name].node)
            self._advance(name)
        except NoPlaceError:
            self._set(replace(self._states[name], state="waiting"))
        except Exception as error:
            self._returning.pop(name, None)
            self._fail(name, error)

    def _await_next(self) -> None:
        pending: list[Future[Any]] = [*self._bursts, *self._endings]
        if not pending:
            time.sleep(_WAKE_SECONDS)
        ready, _ = wait(pending, timeout=_WAKE_SECONDS, return_when=FIRST_COMPLETED)
        self._show()  # observers may have skipped the last change
        # In the order of the requests, not in that of a set.
        for burst in [future for future in self._bursts if future in ready]:
            self._take_burst(burst)
        self._give_up_hanging()
        for ending in [future for future in self._endings if future in ready]:
            self._take_ending(ending)

    def _give_up_hanging(self) -> None:
        """Give up bursts that take too long; those of a silent live source end by themselves."""
        now = self._clock()
        for burst, name in list(self._bursts.items()):
            most = START_SECONDS if self._states[name].state == "starting" else STALL_SECONDS
            if now - self._asked[name] > most:
                del self._bursts[burst]
                self._fail(name, ActorLostError(f"The stream has not got on for {most:.0f} seconds."))

    def _take_burst(self, burst: Future[StreamProgress]) -> None:
        name = self._bursts.pop(burst)
        try:
            progress = burst.result()
        except Exception as error:
            self._fail(name, error)
            return
        if progress.done:
            self._removed.discard(name)
            self._set(after_end(self._states[name], progress))
            self._end(name, drain=False)
            return
        if progress.committed > self._states[name].committed:
            self._refusals.pop(name, None)
        load = self._loads[name].after(progress)
        self._set(after_progress(self._states[name], progress, load.frames_per_second, load.cores))
        if name in self._removed:
            self._end(name, drain=True)
        elif name in self._restarting:
            self._returning[name] = self._streams[name]
            self._set(after_change(self._states[name]))
            self._end(name, drain=True)
        elif self._interruption.signal_number is None:
            self._advance(name)

    def _take_ending(self, ending: Future[StreamProgress | None]) -> None:
        name = self._endings.pop(ending)
        if name in self._removed:
            self._removed.remove(name)
            self._returning.pop(name, None)
            progress = None if ending.exception() else ending.result()
            self._set(after_removal(self._states[name], progress))
        elif name in self._returning and self._interruption.signal_number is None:
            self._start(name)

    def _advance(self, name: str) -> None:
        self._bursts[self._streams[name].advance()] = name
        self._asked[name] = self._clock()

    def _fail(self, name: str, error: Exception) -> None:
        """End a stream, for good unless it only lost a process; it keeps its place meanwhile."""
        state = self._states[name]
        if self._may_return(name, error):
            returns = self._returns[name].after_loss(state.committed)
            if returns is not None:
                self._returns[name] = returns
                self._returning[name] = self._streams[name]
                self._set(after_loss(state, _sentence(error)))
                self._end(name, drain=False)
                return
        elif self._may_wait_for_disk(name, error):
            self._refusals[name] = self._refusals.get(name, 0) + 1
            self._returning[name] = self._streams[name]
            self._set(after_refusal(state, _sentence(error)))
            self._end(name, drain=False, pause=retry_seconds(self._refusals[name]))
            return
        self._removed.discard(name)
        self._set(after_failure(state, _sentence(error)))
        if name in self._streams:
            self._end(name, drain=False)

    def _may_return(self, name: str, error: Exception) -> bool:
        return isinstance(error, ActorLostError) and name in self._streams and name not in self._removed

    def _may_wait_for_disk(self, name: str, error: Exception) -> bool:
        is_refused = isinstance(error, UnwritableError) and self._states[name].live
        return is_refused and name in self._streams and name not in self._removed

    def _end(self, name: str, *, drain: bool, pause: float = 0.0) -> Future[StreamProgress | None]:
        """Stop a stream; its end is told after a pause, s, if the run does not end in the meantime."""
        stream = self._streams.pop(name)
        returning = name in self._returning
        keeps_reader = returning and self._restarting.get(name, True)
        heir = self._heir(name)
        if heir is not None and self._coming[heir].open_reader == self._specs[name].open_reader:
            self._returning[heir], keeps_reader = stream, True

        def stop() -> StreamProgress | None:
            try:
                return stream.stop(drain=drain, returns=keeps_reader)
            finally:
                if returning:
                    self._host.repair()
                self._is_ending.wait(pause)

        ending = _in_thread(stop)
        self._endings[ending] = name
        return ending

    def _heir(self, name: str) -> str | None:
        """Return the name under which a stream that was taken from the list goes on."""
        heirs = (new for new, (was, _) in self._renamed.items() if was == name)
        return next(heirs, None) if name in self._removed else None

    def _drain(self) -> None:
        """Let the bursts under way end, then label and commit what was read."""
        self._is_ending.set()
        while self._bursts:
            self._await_next()
        endings = {self._end(name, drain=True): name for name in list(self._streams)}
        while self._endings:
            ready, _ = wait(self._endings, timeout=_WAKE_SECONDS, return_when=FIRST_COMPLETED)
            for ending in ready:
                self._take_ending(ending)
                if ending in endings:
                    name = endings[ending]
                    progress = None if ending.exception() else ending.result()
                    self._set(after_interruption(self._states[name], progress))
        for name in sorted(self._returning.keys() & self._states.keys()):
            self._set(after_interruption(self._states[name], None))

    def _set(self, state: StreamState) -> None:
        self._states[state.name] = state
        self._show()

    def _show(self) -> None:
        for observer in self._observers:
            observer.update(self.states)


def _new_state(spec: StreamSpec, length: int | None = None, earlier_cores: float = 0.0) -> StreamState:
    if spec.max_frames is not None and (length is not None or spec.live):
        length = spec.max_frames if length is None else min(length, spec.max_frames)
    return StreamState(spec.name, line=spec.line, length=length, live=spec.live, earlier_cores=earlier_cores)


def _sentence(error: Exception) -> str:
    if isinstance(error, MlbsError):
        return str(error)
    return f"The stream failed unexpectedly with {type(error).__name__}: {error}."


def _in_thread(call: Callable[[], StreamProgress | None]) -> Future[StreamProgress | None]:
    """Run a blocking call in a daemon thread, so that it cannot delay an immediate end."""
    outcome: Future[StreamProgress | None] = Future()

    def run() -> None:
        try:
            outcome.set_result(call())
        except Exception as error:
            outcome.set_exception(error)

    threading.Thread(target=run, daemon=True).start()
    return outcome
