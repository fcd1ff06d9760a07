"""Streams on a node, as the driver sees them: started, asked for one burst after the other, stopped.

No frames or results pass through here. The driver creates a stream's reader, segmenter and coordinator; the
node's pool creates its layers.
"""

from __future__ import annotations

import secrets
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass
from itertools import count
from threading import Lock

from ray.exceptions import GetTimeoutError, RayError

from mlbs_actors.actors.ipc.wakeup import WakeupEvent
from mlbs_actors.actors.node.burst_limiter import BurstLimiter
from mlbs_actors.actors.node.failures import COORDINATOR, explain
from mlbs_actors.actors.node.host import Handle, Reference
from mlbs_actors.actors.node.pool import PoolActor, PoolCensus, PoolPolicy
from mlbs_actors.actors.node.processes import cores_of, end, get, here, identity, is_there, spawn
from mlbs_actors.actors.node.reservation import Reservation
from mlbs_actors.actors.parts import EngineParts, PartFactory
from mlbs_actors.actors.standby import StandbyProcesses
from mlbs_actors.actors.stream.coordinator_actor import CoordinatorActor
from mlbs_actors.actors.stream.links import StreamLinks
from mlbs_actors.actors.stream.live_reader import LiveReaderActor
from mlbs_actors.actors.stream.protocol import RunningStream, StreamProgress, StreamSpec
from mlbs_actors.actors.stream.reader import ReaderActor
from mlbs_actors.actors.stream.segmenter_actor import SegmenterActor
from mlbs_actors.actors.stream.sink import SinkActor
from mlbs_actors.errors import MlbsError
from mlbs_actors.source import FrameReader

__all__ = ["Node", "StreamActors", "sinks_of"]

#: Cores per sink: writing a frame takes a tenth of its CPU time, so a single sink would limit a node of more
#: than about eight.
_CORES_A_SINK = 4

#: Cores that a stream of a file keeps busy, which limits the bursts at once.
_CORES_A_BURST = 2

#: A burst that takes longer blocks no other stream, s: twice the time in which one takes new frames.
_BURST_SECONDS = 3.0

#: Most frames of a burst: of a camera, or of a stream that has just begun, and of a file. With 8 frames a
#: burst eight files took 6 % more CPU time, for data that the others had evicted from the caches.
_SHORT_BURST, _LONG_BURST = 8, 24

#: Short bursts of a new stream: processes are prepared for the next one between bursts.
_SHORT_BURSTS = 6

#: Timeout for the processes of a stopped stream to end, s.
_STOP_SECONDS = 10.0

#: Timeout for a reader to release its file or device before it is ended, s: not all of those that wait for a
#: camera can.
_CLOSE_SECONDS = 1.0

#: Timeout for an answer of a pool, sink or live reader, after which it counts as lost, s.
_ANSWER_SECONDS = 10.0


def sinks_of(cores: int) -> int:
    """Return the number of sinks of a node; a stream's record is written by one of them."""
    return max(1, cores // _CORES_A_SINK)


@dataclass(frozen=True, slots=True)
class _Home:
    """What a node provides to the streams that run on it."""

    parts: PartFactory
    standby: StandbyProcesses
    burst_limiter: BurstLimiter


class Node:
    """One node's pool of layer processes and its sink processes; a :class:`StreamHost`.

    Needs a Ray session, or another host of actors (:mod:`mlbs_actors.actors.node.host`). The processes end
    with :meth:`close`, or with the driver.

    Parameters
    ----------
    node : str, optional
        Id of the node; by default the driver's own.
    parts : PartFactory, optional
        What the actors run; by default the engine.
    policy : PoolPolicy, optional
    """

    def __init__(
        self,
        node: str | None = None,
        *,
        parts: PartFactory | None = None,
        policy: PoolPolicy | None = None,
    ) -> None:
        drivers = here()
        self._node = drivers if node is None else node
        self._beside_driver = self._node == drivers
        self._parts = parts or EngineParts()
        self._policy = policy or PoolPolicy()
        self._mark = secrets.token_hex(3)  # keeps names apart from those of other drivers and nodes
        self._numbers = count(1)
        self._pool = self._new_pool()
        self._sinks = [self._new_sink() for _ in range(sinks_of(cores_of(self._node)))]
        self._home = _Home(
            self._parts,
            StandbyProcesses(self._node, self._parts, self._policy.streams, self._named),
            BurstLimiter(max(1, cores_of(self._node) // _CORES_A_BURST), _BURST_SECONDS),
        )
        self._runs = count(1)
        self._closing = Lock()
        self._repairing = Lock()
        self._closed = False

    def start(
        self, spec: StreamSpec, before: RunningStream | None = None, *, reservation: Reservation | None = None
    ) -> StreamActors:
        """Create a stream's actors and return at once; errors are raised by ``advance``.

        Parameters
        ----------
        spec : StreamSpec
        before : RunningStream, optional
            See :meth:`StreamHost.start`.
        reservation : Reservation, optional
            A granted one of this node, for the stream; it must last as long as its reader.
        """
        run = next(self._runs)
        before = before if isinstance(before, StreamActors) else None
        reader = None if before is None else before.living_reader
        standby = self._home.standby
        # One that takes a reservation ends with it.
        shared = reader is None and reservation is None and not spec.live
        if shared:
            reader = standby.take(ReaderActor)
        elif before is None or reader is None:
            reader = spawn(
                LiveReaderActor if spec.live else ReaderActor,
                spec.open_reader,
                node=self._node,
                reservation=reservation,
                name=self._named(f"{spec.name}, reader"),
            )
        elif before.reopened_by is not None:
            # The coordinator may have been lost before it could pass this on.
            reader.reopen.remote(before.reopened_by)
        links = StreamLinks(
            reader=reader,
            segmenter=standby.take(SegmenterActor),
            pool=self._pool,
            sink=self._sinks[run % len(self._sinks)],
        )
        return StreamActors(
            spec,
            self._home,
            standby.take(CoordinatorActor),
            links,
            run=run,
            reader_is_shared=shared,
            wakeup=WakeupEvent() if self._beside_driver else None,
        )

    def prepare(self) -> bool:
        """See :meth:`StandbyProcesses.prepare`."""
        return self._home.standby.prepare()

    def repair(self) -> None:
        """Replace the pool and the sinks if they are lost; their streams must be started again."""
        with self._repairing:
            if not _answers(self._pool):
                end([self._pool])
                self._pool = self._new_pool()
            for number, sink in enumerate(self._sinks):
                if not _answers(sink):
                    end([sink])
                    self._sinks[number] = self._new_sink()

    def census(self) -> PoolCensus:
        """Count the node's layer processes."""
        census: PoolCensus = get(self._pool.census.remote())
        return census

    def close(self) -> None:
        """End the layer processes, the pool and the sinks. May be called twice."""
        with self._closing:
            if self._closed:
                return
            self._closed = True
        if not is_there():
            return
        left = self._home.standby.close()
        with suppress(RayError, GetTimeoutError):
            get(self._pool.close.remote(), _STOP_SECONDS)
        end([self._pool, *self._sinks, *left])

    def _new_pool(self) -> Handle:
        return spawn(PoolActor, self._parts, self._policy, node=self._node, name=self._named("pool"))

    def _new_sink(self) -> Handle:
        return spawn(SinkActor, node=self._node, name=self._named("sink"))

    def _named(self, part: str) -> str:
        """Name a process for Ray's lists; those that take one file after the other go by their part only."""
        return f"{part} {next(self._numbers)} ({self._mark})"


def _answers(actor: Handle) -> bool:
    try:
        get(actor.__ray_ready__.remote(), _ANSWER_SECONDS)
    except (RayError, GetTimeoutError):
        return False
    return True


class StreamActors:
    """One stream's actors; a :class:`RunningStream`. Made by :meth:`Node.start`.

    Parameters
    ----------
    spec : StreamSpec
    home : _Home
    coordinator : Handle
        Not initialised yet.
    links : StreamLinks
        The other processes; the segmenter is not initialised yet.
    run : int
        The stream's number.
    reader_is_shared : bool
        Whether the reader takes one file after the other, too; then it is not initialised yet.
    wakeup : WakeupEvent, optional
        For the coordinator between bursts; only on the driver's own node.

    Attributes
    ----------
    living_reader : Handle, optional
        Left by :meth:`stop` for the next start; it ends when its last handle is dropped.
    reopened_by : callable, optional
        What a live source was opened by last, if not by ``spec``.
    """

    def __init__(
        self,
        spec: StreamSpec,
        home: _Home,
        coordinator: Handle,
        links: StreamLinks,
        *,
        run: int,
        reader_is_shared: bool,
        wakeup: WakeupEvent | None,
    ) -> None:
        self._name = spec.name
        self._live = spec.live
        self._coordinator = coordinator
        self._links = links
        self._roles = {identity(coordinator): COORDINATOR} | links.roles()
        # By reference: the coordinator must not begin before the pool has registered the stream.
        self._run: Reference = links.pool.begin.remote(run)
        others: dict[str, Reference] = {"segmenter": links.segmenter.become.remote(home.parts, spec.config)}
        if reader_is_shared:
            others["reader"] = links.reader.become.remote(spec.open_reader)
        begun: Reference = coordinator.become.remote(spec, home.parts, links, self._run, **others)
        self._begun: Future[None] = begun.future()
        self._home = home
        self._reader_is_shared = reader_is_shared
        self._is_whole = False  # has come to its end in order
        self._wakeup = wakeup
        self._is_waiting = False
        self._bursts = 0
        self._kept_waiting = False
        self.living_reader: Handle | None = None
        self.reopened_by: Callable[[], FrameReader] | None = None
        self._stopped = False
        self._final: StreamProgress | None = None

    @property
    def node(self) -> str | None:
        """None: whoever chose the :class:`Node` knows where it is."""
        return None

    def advance(self) -> Future[StreamProgress]:
        """Ask for one bounded burst of frames; do not call again before the future is done.

        Returns
        -------
        Future of StreamProgress
            Carries an MlbsError if the stream failed (see :class:`RunningStream`).
        """
        # Not limited: a camera's stream waits for pictures, a new one for processes, a slow one for its file.
        at_once = self._live or self._bursts == 0 or self._kept_waiting
        if at_once:
            progress = self._ask_for_burst()
        else:
            progress = self._home.burst_limiter.submit(self._ask_for_burst, self._wait_inside_a_call)
        self._bursts += 1
        if self._bursts > 1:  # in parallel with the burst, as starting processes takes time here
            self._home.standby.prepare()
        return progress

    def reopen(self, open_reader: Callable[[], FrameReader]) -> None:
        """See :meth:`RunningStream.reopen`."""
        self.reopened_by = open_reader
        self._coordinator.reopen.remote(open_reader)

    def configure(self, settings: object) -> None:
        """See :meth:`RunningStream.configure`."""
        self._links.sink.configure.remote(self._run, settings)

    def stop(self, *, drain: bool, returns: bool = False) -> StreamProgress | None:
        """End the stream and release its processes; may be called twice, and after a failure.

        Those of a file that came to its end take the next one.

        Parameters
        ----------
        drain : bool
            Label and commit what was read, and wait for it; else only what was sent to the sink is kept.
        returns : bool
            The stream will be started again: a live reader is kept, if it answers.

        Returns
        -------
        StreamProgress or None
            The final progress if drained without an error.
        """
        if self._stopped:
            return self._final
        self._stopped = True
        if not is_there():
            return None
        self._wake()
        if drain:
            with suppress(MlbsError):
                self._final = self._explained(self._coordinator.finish.remote()).result()
        reader = self._links.reader
        rested = {CoordinatorActor: self._coordinator, SegmenterActor: self._links.segmenter}
        if not self._is_whole:
            end(rested.values(), _STOP_SECONDS)
            rested = {}
        if self._live and returns and _answers(reader):
            self.living_reader = reader
        else:
            # It releases its device or file if it can.
            with suppress(RayError, GetTimeoutError):
                get(reader.close.remote(), _CLOSE_SECONDS)
            if self._is_whole and self._reader_is_shared:
                rested[ReaderActor] = reader
            else:
                end([reader], _STOP_SECONDS)
        for kind, handle in rested.items():
            self._home.standby.keep(kind, handle)
        for last in (self._links.pool.end.remote(self._run), self._links.sink.close.remote(self._run)):
            with suppress(RayError, GetTimeoutError):
                get(last, _STOP_SECONDS)
        if self._wakeup is not None:
            self._wakeup.close()
        return self._final

    def _wait_inside_a_call(self) -> None:
        """Have the coordinator wait for its next call inside one."""
        if self._wakeup is not None:
            self._coordinator.wait_inside_a_call.remote(self._wakeup.handle)
            self._is_waiting = True

    def _wake(self) -> None:
        if self._is_waiting:
            assert self._wakeup is not None
            self._wakeup.wake()
            self._is_waiting = False

    def _ask_for_burst(self) -> Future[StreamProgress]:
        self._wake()
        frames = _SHORT_BURST if self._live or self._bursts < _SHORT_BURSTS else _LONG_BURST
        # The process is listed under the name of its call.
        named = self._coordinator.advance.options(name=f"CoordinatorActor.advance of {self._name}")
        return self._explained(named.remote(frames))

    def _explained(self, reference: Reference) -> Future[StreamProgress]:
        """Translate Ray's errors in an answer's future into this package's."""
        answer: Future[StreamProgress] = reference.future()
        explained: Future[StreamProgress] = Future()

        def pass_on(answered: Future[StreamProgress]) -> None:
            error = answered.exception()
            if error is None:
                progress = answered.result()
                self._kept_waiting = progress.kept_waiting
                self._is_whole = progress.done and progress.problem is None and not self._stopped
                explained.set_result(progress)
            else:
                explained.set_exception(explain(self._failure_at_start() or error, self._name, self._roles))

        answer.add_done_callback(pass_on)
        return explained

    def _failure_at_start(self) -> BaseException | None:
        """Return the error that kept the stream from starting, which later calls do not report."""
        return self._begun.exception() if self._begun.done() else None
