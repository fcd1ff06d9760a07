"""Streams on a node, as the driver sees them: started, asked for one burst after the other, stopped.

No frames or results pass through here. The driver creates a stream's reader, segmenter and coordinator; the
node's pool creates its layers.
"""

from __future__ import annotations

import secrets
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from itertools import count
from threading import Lock

from ray.exceptions import GetTimeoutError, RayError

from mlbs_actors.actors.ipc.wakeup import WakeupEvent
from mlbs_actors.actors.node.burst_limiter import BurstLimiter
from mlbs_actors.actors.node.failures import COORDINATOR, explain
from mlbs_actors.actors.node.host import Handle, Reference
from mlbs_actors.actors.node.pool import PoolActor, PoolCensus, PoolPolicy
from mlbs_actors.actors.node.processes import cores_of, end, get, here, identity, kill, spawn, spawn_standby
from mlbs_actors.actors.node.reservation import Reservation
from mlbs_actors.actors.parts import EngineParts, PartFactory
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


#: Actors whose processes may be started before there is a stream for them.
_STANDBY = (CoordinatorActor, SegmenterActor)


def sinks_of(cores: int) -> int:
    """Return the number of sinks of a node; a stream's record is written by one of them."""
    return max(1, cores // _CORES_A_SINK)


class _Standby:
    """A started process without a stream."""

    def __init__(self, handle: Handle) -> None:
        self.handle = handle
        self._ready: Future[object] = handle.__ray_ready__.remote().future()

    def is_ready(self) -> bool:
        """Whether it has started, or has failed to."""
        return self._ready.done()


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
        self._shared = count(1)
        self._pool = self._new_pool()
        self._sinks = [self._new_sink() for _ in range(sinks_of(cores_of(self._node)))]
        self._burst_limiter = BurstLimiter(max(1, cores_of(self._node) // _CORES_A_BURST), _BURST_SECONDS)
        self._run = 0
        self._standby: list[_Standby] = []
        self._preparing = Lock()
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
        run, (coordinator, segmenter) = self._take_standby(spec.name)
        before = before if isinstance(before, StreamActors) else None
        reader = None if before is None else before.living_reader
        if before is None or reader is None:
            reader = spawn(
                LiveReaderActor if spec.live else ReaderActor,
                spec.open_reader,
                node=self._node,
                reservation=reservation,
                name=self._named(f"{spec.name}, reader", run),
            )
        elif before.reopened_by is not None:
            # The coordinator may have been lost before it could pass this on.
            reader.reopen.remote(before.reopened_by)
        sink = self._sinks[run % len(self._sinks)]
        return StreamActors(
            spec,
            self._parts,
            coordinator,
            StreamLinks(reader=reader, segmenter=segmenter, pool=self._pool, sink=sink),
            run=run,
            burst_limiter=self._burst_limiter,
            under_way=self.prepare,
            wakeup=WakeupEvent() if self._beside_driver else None,
        )

    def prepare(self) -> bool:
        """Prepare the processes of the next stream, or of one that restarts after a loss.

        They are started one after the other in repeated calls, at low priority.

        Returns
        -------
        bool
            Whether all are ready.
        """
        with self._preparing:
            if self._closed or not all(process.is_ready() for process in self._standby):
                return False
            if len(self._standby) == len(_STANDBY):
                return True
            self._standby.append(self._start_standby())
            return False

    def _take_standby(self, stream: str) -> tuple[int, list[Handle]]:
        """Return a new stream's number and processes: the standby ones that are ready, and new ones."""
        with self._preparing:
            # Only the last one started can be unready.
            if self._standby and not self._standby[-1].is_ready():
                kill(self._standby.pop().handle)
            while len(self._standby) < len(_STANDBY):
                self._standby.append(self._start_standby(stream))
            taken, self._standby = [process.handle for process in self._standby], []
            self._run += 1
            return self._run, taken

    def _start_standby(self, stream: str | None = None) -> _Standby:
        """Start a process of the next stream, which waits for it if it is known."""
        kind = _STANDBY[len(self._standby)]
        warm = self._parts.warm_coordinator if kind is CoordinatorActor else self._parts.warm_segmenter
        part = "coordinator" if kind is CoordinatorActor else "segmenter"
        name = self._named(part if stream is None else f"{stream}, {part}", self._run + 1)
        return _Standby(spawn_standby(kind, warm, awaited=stream is not None, node=self._node, name=name))

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
        with self._preparing:
            if self._closed:
                return
            self._closed = True
        with suppress(RayError, GetTimeoutError):
            get(self._pool.close.remote(), _STOP_SECONDS)
        end([self._pool, *self._sinks, *(process.handle for process in self._standby)])

    def _new_pool(self) -> Handle:
        name = self._named("pool", next(self._shared))
        return spawn(PoolActor, self._parts, self._policy, node=self._node, name=name)

    def _new_sink(self) -> Handle:
        return spawn(SinkActor, node=self._node, name=self._named("sink", next(self._shared)))

    def _named(self, part: str, number: int) -> str:
        """Name a process for Ray's lists: the reader, coordinator and segmenter of a stream by one number."""
        return f"{part} {number} ({self._mark})"


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
    parts : PartFactory
    coordinator : Handle
        Not initialised yet.
    links : StreamLinks
        The other processes; the segmenter is not initialised yet.
    run : int
        The stream's number.
    burst_limiter : BurstLimiter
        Of the node.
    under_way : callable
        Called repeatedly once the stream is under way.
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
        parts: PartFactory,
        coordinator: Handle,
        links: StreamLinks,
        *,
        run: int,
        burst_limiter: BurstLimiter,
        under_way: Callable[[], object],
        wakeup: WakeupEvent | None,
    ) -> None:
        self._name = spec.name
        self._live = spec.live
        self._coordinator = coordinator
        self._links = links
        self._roles = {identity(coordinator): COORDINATOR} | links.roles()
        # By reference: the coordinator must not begin before the pool has registered the stream.
        self._run: Reference = links.pool.begin.remote(run)
        segmenter_begun: Reference = links.segmenter.become.remote(parts, spec.config)
        begun: Reference = coordinator.become.remote(spec, parts, links, self._run, segmenter=segmenter_begun)
        self._begun: Future[None] = begun.future()
        self._burst_limiter = burst_limiter
        self._under_way = under_way
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
            progress = self._burst_limiter.submit(self._ask_for_burst, self._wait_inside_a_call)
        self._bursts += 1
        if self._bursts > 1:  # in parallel with the burst, as starting processes takes time here
            self._under_way()
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
        self._wake()
        if drain:
            with suppress(MlbsError):
                self._final = self._explained(self._coordinator.finish.remote()).result()
        end([self._coordinator, self._links.segmenter], _STOP_SECONDS)
        reader = self._links.reader
        if self._live and returns and _answers(reader):
            self.living_reader = reader
        else:
            # It releases its device or file if it can; it is ended in any case.
            with suppress(RayError, GetTimeoutError):
                get(reader.close.remote(), _CLOSE_SECONDS)
            end([reader], _STOP_SECONDS)
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
                explained.set_result(progress)
            else:
                explained.set_exception(explain(self._failure_at_start() or error, self._name, self._roles))

        answer.add_done_callback(pass_on)
        return explained

    def _failure_at_start(self) -> BaseException | None:
        """Return the error that kept the stream from starting, which later calls do not report."""
        return self._begun.exception() if self._begun.done() else None
