"""One stream of a run in the driver's hands, over all starts of its processes."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import replace
from threading import Timer

from mlbs_actors.actors.stream.protocol import RunningStream, StreamHost, StreamProgress, StreamSpec
from orchestrator.run.load import LoadMeter
from orchestrator.run.recovery import STALL_SECONDS, START_SECONDS, Returns
from orchestrator.run.stream_state import StreamState, after_progress

__all__ = ["DrivenStream"]

#: How long a stream that is to wait is not asked, s.
_PAUSE_SECONDS = 0.1


class DrivenStream:
    """What a stream is to be, how it fares, and its processes.

    Parameters
    ----------
    spec : StreamSpec
    host : StreamHost
        Starts its processes.
    clock : callable
        Monotonic time, s.
    length : int, optional
        Frames that it will read, as far as known; for display only.
    earlier_cores : float
        Cores that a camera kept busy in the run that this one resumes.

    Attributes
    ----------
    spec : StreamSpec
        How it starts next.
    state : StreamState
        As the user sees it.
    is_leaving : bool
        It was taken from the list, and has not ended yet.
    has_processes : bool
        Whether it has processes, be it some that are being ended.
    refusals : int
        How often its disk could not be written to since its last progress.
    """

    def __init__(
        self,
        spec: StreamSpec,
        host: StreamHost,
        clock: Callable[[], float],
        length: int | None = None,
        earlier_cores: float = 0.0,
    ) -> None:
        self.spec = spec
        if spec.max_frames is not None and (length is not None or spec.live):
            length = spec.max_frames if length is None else min(length, spec.max_frames)
        self.state = StreamState(
            spec.name, line=spec.line, length=length, live=spec.live, earlier_cores=earlier_cores
        )
        self.is_leaving = False
        self.has_processes = False
        self.refusals = 0
        self._host = host
        self._clock = clock
        self._running: RunningStream | None = None
        self._before: RunningStream | None = None
        self._restarts = False
        self._same_reader = True
        self._losses = Returns()
        self._load = LoadMeter(clock)
        self._newest: StreamProgress | None = None  # since its start
        self._asked_at = 0.0

    @property
    def name(self) -> str:
        """Its name."""
        return self.spec.name

    @property
    def is_at_work(self) -> bool:
        """Whether it has processes, and they are not being ended."""
        return self._running is not None

    @property
    def returns(self) -> bool:
        """Whether it is to be started again after an earlier start."""
        return self._before is not None

    @property
    def is_to_restart(self) -> bool:
        """Whether its processes are to be replaced, as it is to be another one than they know."""
        return self._restarts

    @property
    def committed(self) -> int | None:
        """Its committed label maps; None before the first burst of a start has ended."""
        return None if self._newest is None else self._newest.committed

    @property
    def hangs_for(self) -> float | None:
        """Seconds for which its burst has not ended, if that is too long."""
        most = START_SECONDS if self.state.state == "starting" else STALL_SECONDS
        return most if self._clock() - self._asked_at > most else None

    def start(self) -> None:
        """Start its processes; raises what :meth:`StreamHost.start` does."""
        self._load, self._newest = LoadMeter(self._clock), None
        spec = replace(self.spec, last_try=self._losses.last_try)
        # A reader that lived on reads what it did.
        self._running = self._host.start(spec, self._before if self._same_reader else None)
        self.has_processes = True
        self.state = replace(self.state, node=self._running.node)
        self.give_up_return()

    def give_up_return(self) -> None:
        """Forget the earlier start."""
        self._before, self._restarts, self._same_reader = None, False, True

    def advance(self) -> Future[StreamProgress]:
        """Ask for one burst of frames."""
        assert self._running is not None
        self._asked_at = self._clock()
        return self._running.advance()

    def pause(self) -> Future[StreamProgress]:
        """Ask for nothing; that there is nothing new is the answer, after a moment."""
        self._asked_at = self._clock()
        answer: Future[StreamProgress] = Future()
        timer = Timer(_PAUSE_SECONDS, answer.set_result, [self._newest])
        timer.daemon = True
        timer.start()
        return answer

    def note(self, progress: StreamProgress) -> StreamState:
        """Return its state after a burst."""
        self._newest = progress
        if progress.committed > self.state.committed:
            self.refusals = 0
        load = self._load.after(progress)
        return after_progress(self.state, progress, load.frames_per_second, load.cores)

    def may_go_back(self) -> bool:
        """Count a loss of a process; return whether it is to be started again."""
        losses = self._losses.after_loss(self.state.committed)
        self._losses = losses or self._losses
        return losses is not None

    def become(self, spec: StreamSpec) -> None:
        """Be as ``spec`` says: at the next start, which comes soon if there was one already."""
        if self.is_at_work or self.returns:
            self._same_reader = self._same_reader and spec.open_reader == self.spec.open_reader
            self._restarts = True
        self.spec = spec

    def reopen(self, spec: StreamSpec) -> None:
        """Read a camera from another place, by the processes that it has."""
        if self._running is None or self._restarts:
            self.become(spec)
        else:
            self.spec = spec
            self._running.reopen(spec.open_reader)

    def configure(self, spec: StreamSpec, settings: object) -> None:
        """Have its record follow other settings, from now on and at each start."""
        self.spec = spec
        if self._running is not None:
            self._running.configure(settings)

    def stopping(
        self, *, drain: bool, returns: bool = False, heir: DrivenStream | None = None
    ) -> Callable[[], StreamProgress | None]:
        """Take its processes from it; return a call that ends them.

        Parameters
        ----------
        drain : bool
            Label and commit what was read.
        returns : bool
            It is to be started again.
        heir : DrivenStream, optional
            The stream as which it goes on under another name.
        """
        running, self._running = self._running, None
        assert running is not None
        keeps_reader = returns and self._same_reader
        if returns:
            self._before = running
        elif heir is not None and heir.spec.open_reader == self.spec.open_reader:
            heir._before, keeps_reader = running, True

        def stop() -> StreamProgress | None:
            try:
                return running.stop(drain=drain, returns=keeps_reader)
            finally:
                self.has_processes = False
                if returns:
                    self._host.repair()

        return stop
