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

from mlbs_actors.actors.stream.protocol import StreamHost, StreamProgress, StreamSpec
from mlbs_actors.errors import ActorLostError, MlbsError, NoPlaceError
from orchestrator.interruption import Interruption
from orchestrator.retries import retry_seconds
from orchestrator.run.admission import Admission, Verdict
from orchestrator.run.driven_stream import DrivenStream
from orchestrator.run.spec_change import SpecChange
from orchestrator.run.stream_state import (
    ENDED,
    StreamState,
    after_change,
    after_end,
    after_failure,
    after_interruption,
    after_loss,
    after_refusal,
    after_removal,
    after_start,
    exit_code,
    has_ended,
)
from orchestrator.storage.durable_files import UnwritableError

__all__ = ["Driver", "KnownStreams", "Observer"]

#: Longest time until a signal is noticed, s.
_WAKE_SECONDS = 0.2


class Observer(Protocol):
    """Displays or stores the states of the streams."""

    def update(self, states: Sequence[StreamState]) -> None:
        """Receive the states of all streams, in the order of the list; called after every change."""


@dataclass(frozen=True, slots=True)
class KnownStreams:
    """What is known of streams before the run drives them, by name.

    Attributes
    ----------
    lengths : mapping of str to int
        Frames that waiting streams will read, as far as known; for display only.
    loads : mapping of str to float
        Cores that cameras kept busy in the run that this one resumes.
    ended : mapping of str to StreamState
        Streams that have no source, or ended in an earlier run; they are not started.
    """

    lengths: Mapping[str, int] = field(default_factory=dict)
    loads: Mapping[str, float] = field(default_factory=dict)
    ended: Mapping[str, StreamState] = field(default_factory=dict)


_NOTHING_KNOWN = KnownStreams()


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
    known : KnownStreams
    changes : callable, optional
        Called repeatedly for streams to add and names to end; with it the run continues until a signal.
    is_behind : callable, optional
        Takes a stream's name and the number of its committed label maps; returns whether the stream is to
        wait, as whoever takes its label maps has not taken enough of them yet.
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
        known: KnownStreams = _NOTHING_KNOWN,
        changes: Callable[[], SpecChange | None] | None = None,
        is_behind: Callable[[str, int], bool] | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._streams = {
            spec.name: DrivenStream(
                spec, host, clock, known.lengths.get(spec.name), known.loads.get(spec.name, 0.0)
            )
            for spec in specs
        }
        self._earlier: dict[str, StreamState] = {}  # of which no more is known
        for name, state in known.ended.items():
            if name in self._streams:
                self._streams[name].state = state
            else:
                self._earlier[name] = state
        self._host = host
        self._admission = admission
        self._observers = observers
        self._interruption = interruption
        self._changes = changes
        self._is_behind = is_behind
        self._clock = clock
        self._coming: dict[str, DrivenStream] = {}  # new in the list, and not added yet
        self._renamed: dict[str, tuple[str, Callable[[], None]]] = {}
        self._bursts: dict[Future[StreamProgress], DrivenStream] = {}
        # A stream that ended keeps its place until its processes are gone.
        self._endings: dict[Future[StreamProgress | None], DrivenStream] = {}
        self._is_ending = threading.Event()

    @property
    def states(self) -> tuple[StreamState, ...]:
        """The current states, in the order of the list."""
        return (*(one.state for one in self._streams.values()), *self._earlier.values())

    @property
    def has_processes(self) -> bool:
        """Whether any stream has processes still, be it one that has ended; any thread may ask."""
        return any(one.has_processes for one in list(self._streams.values()))

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
            self._remove(name)
        self._coming |= {spec.name: self._new(spec) for spec in change.added}
        self._renamed |= change.renamed
        for spec in change.reopened:
            if one := self._current(spec):
                one.reopen(spec)
        for spec in change.restarted:
            if one := self._current(spec):
                one.become(spec)
        for spec, settings in change.configured:
            if one := self._current(spec, again=False):
                one.configure(spec, settings)
        self._show()

    def _new(self, spec: StreamSpec) -> DrivenStream:
        return DrivenStream(spec, self._host, self._clock)

    def _remove(self, name: str) -> None:
        """End a stream that was taken from the list: after its burst, if it has one."""
        if self._coming.pop(name, None) is not None:
            self._renamed.pop(name, None)
            return
        one = self._streams.get(name)
        if one is None:  # it ended in an earlier run, or has been removed already
            return
        if one.state.state != "waiting":
            one.is_leaving = one.is_at_work or one.returns
        elif one.returns:
            one.give_up_return()
            one.state = after_removal(one.state, None)
        else:
            del self._streams[name]

    def _current(self, spec: StreamSpec, *, again: bool = True) -> DrivenStream | None:
        """Return the stream of a name; instead of one that has ended, one that begins ``again``.

        None for one that ended in an earlier run.
        """
        if spec.name in self._coming:
            return self._coming[spec.name]
        one = self._streams.get(spec.name)
        if one is not None and again and one.state.state in ENDED:
            if one.state.live:  # which was given up
                one.state = replace(one.state, interrupted=True)
            one = self._coming[spec.name] = self._new(spec)
        return one

    def _add_coming(self) -> None:
        """Add the streams of new lines; one that comes back, once its processes are gone."""
        ending = {one.name for one in self._endings.values()}
        ending |= {name for name, one in self._streams.items() if one.is_leaving}
        working = ending | {name for name, one in self._streams.items() if one.is_at_work or one.returns}
        for name in list(self._coming):
            if name in ending or (name in self._renamed and self._renamed[name][0] in working):
                continue
            new = self._coming.pop(name)
            if name in self._renamed:
                before, ended = self._renamed.pop(name)
                self._streams.pop(before, None)
                ended()
            if name in self._earlier:
                if has_ended(self._earlier[name]):
                    continue
                del self._earlier[name]
            if name in self._streams and has_ended(self._streams[name].state):
                continue
            self._streams[name] = new
            self._show()

    def _admit(self) -> None:
        # One at a time: if a stream fails at once, its place is free for the next.
        while name := (verdict := self._verdict()).start:
            self._set(self._streams[name], after_start(self._streams[name].state))
            self._start(self._streams[name])
        for one in self._streams.values():
            reason = verdict.waits_for(one.state)
            if one.state.state == "waiting" and one.state.waits_for != reason:
                one.state = replace(one.state, waits_for=reason)

    def _verdict(self) -> Verdict:
        return self._admission(self.states, [one.name for one in self._endings.values()])

    def _waiting(self) -> int:
        return sum(state.state == "waiting" for state in self.states)

    def _start(self, one: DrivenStream) -> None:
        try:
            one.start()
            self._advance(one)
        except NoPlaceError:
            self._set(one, replace(one.state, state="waiting"))
        except Exception as error:
            one.give_up_return()
            self._fail(one, error)

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
        for burst, one in list(self._bursts.items()):
            if (seconds := one.hangs_for) is not None:
                del self._bursts[burst]
                self._fail(one, ActorLostError(f"The stream has not got on for {seconds:.0f} seconds."))

    def _take_burst(self, burst: Future[StreamProgress]) -> None:
        one = self._bursts.pop(burst)
        try:
            progress = burst.result()
        except Exception as error:
            self._fail(one, error)
            return
        if progress.done:
            one.is_leaving = False
            self._set(one, after_end(one.state, progress))
            self._end(one, drain=False)
            return
        self._set(one, one.note(progress))
        if one.is_leaving:
            self._end(one, drain=True)
        elif one.is_to_restart:
            self._set(one, after_change(one.state))
            self._end(one, drain=True, returns=True)
        elif self._interruption.signal_number is None:
            self._advance(one)

    def _take_ending(self, ending: Future[StreamProgress | None]) -> None:
        one = self._endings.pop(ending)
        if one.is_leaving:
            one.is_leaving = False
            one.give_up_return()
            progress = None if ending.exception() else ending.result()
            self._set(one, after_removal(one.state, progress))
        elif one.returns and self._interruption.signal_number is None:
            self._start(one)

    def _advance(self, one: DrivenStream) -> None:
        committed = one.committed
        waits = committed is not None and self._is_behind is not None and self._is_behind(one.name, committed)
        self._bursts[one.pause() if waits else one.advance()] = one

    def _fail(self, one: DrivenStream, error: Exception) -> None:
        """End a stream, for good unless it may be started again; it keeps its place meanwhile."""
        sentence = _sentence(error)
        stays = one.is_at_work and not one.is_leaving
        if stays and isinstance(error, ActorLostError) and one.may_go_back():
            self._set(one, after_loss(one.state, sentence))
            self._end(one, drain=False, returns=True)
        elif stays and isinstance(error, UnwritableError) and one.state.live:
            one.refusals += 1
            self._set(one, after_refusal(one.state, sentence))
            self._end(one, drain=False, returns=True, pause=retry_seconds(one.refusals))
        else:
            one.is_leaving = False
            self._set(one, after_failure(one.state, sentence))
            if one.is_at_work:
                self._end(one, drain=False)

    def _end(self, one: DrivenStream, *, drain: bool, returns: bool = False, pause: float = 0.0) -> None:
        """Stop a stream; its end is told after a pause, s, if the run does not end in the meantime."""
        heir = next((new for new, (before, _) in self._renamed.items() if before == one.name), None)
        stop = one.stopping(drain=drain, returns=returns, heir=None if heir is None else self._coming[heir])

        def stop_and_pause() -> StreamProgress | None:
            try:
                return stop()
            finally:
                self._is_ending.wait(pause)

        self._endings[_in_thread(stop_and_pause)] = one

    def _drain(self) -> None:
        """Let the bursts under way end, then label and commit what was read."""
        self._is_ending.set()
        self._show()  # that this is the end
        while self._bursts:
            self._await_next()
        drained = [one for one in self._streams.values() if one.is_at_work]
        for one in drained:
            self._end(one, drain=True)
        while self._endings:
            ready, _ = wait(self._endings, timeout=_WAKE_SECONDS, return_when=FIRST_COMPLETED)
            for ending in ready:
                one = self._endings[ending]
                self._take_ending(ending)
                if one in drained:
                    progress = None if ending.exception() else ending.result()
                    self._set(one, after_interruption(one.state, progress))
        for one in self._streams.values():
            if one.returns:
                self._set(one, after_interruption(one.state, None))

    def _set(self, one: DrivenStream, state: StreamState) -> None:
        one.state = state
        self._show()

    def _show(self) -> None:
        for observer in self._observers:
            observer.update(self.states)


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
