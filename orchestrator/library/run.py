"""A run of streams as its program holds it: results to iterate, streams to add and remove, states."""

from __future__ import annotations

import asyncio
import atexit
import logging
import signal
from collections import Counter, deque
from collections.abc import AsyncIterator, Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from threading import Lock, Thread
from types import TracebackType
from typing import Any, Generic, TypeVar, cast

from ray.exceptions import RayActorError

from mlbs_actors.actors.node.host import Handle, Reference
from mlbs_actors.actors.node.memory import node_memory
from mlbs_actors.actors.node.processes import end, get, here, is_there, spawn
from mlbs_actors.actors.stream.protocol import StreamSpec
from mlbs_actors.config import Config
from mlbs_actors.errors import ConfigError, MlbsError
from orchestrator.events.delivery import Deliveries
from orchestrator.interruption import Interruption
from orchestrator.library.delivered_record import delivered
from orchestrator.library.result_queue import ResultQueue
from orchestrator.library.starting import listed_stream
from orchestrator.options import Arguments
from orchestrator.run.driver import Driver
from orchestrator.run.hosting import Room, admission_to, host_of
from orchestrator.run.job import Job
from orchestrator.run.listed_stream import ListedStream, StreamsFile
from orchestrator.run.need import USUAL_NEED
from orchestrator.run.run_folder import RunFolder
from orchestrator.run.spec_change import SpecChange
from orchestrator.run.status_file import STATUS, StatusFile
from orchestrator.run.stream_state import ENDED, StreamState

__all__ = ["Run"]

_log = logging.getLogger(__name__)

#: Results of a stream that may wait for the program; beyond, the stream waits. Those under way come on top.
_MOST_WAITING = 64

#: Results that the program takes at once, and how long it waits for the first before it looks at the streams,
#: s.
_MOST_TAKEN, _WAIT_SECONDS = 16, 0.5

_SESSION_ENDED = "The Ray session has ended before the run; close the run before ray.shutdown()."

#: What a run yields.
Yielded = TypeVar("Yielded")


class Run(Generic[Yielded]):
    """Streams that run on Ray; made by :func:`orchestrator.start`.

    Iterate it, with ``for`` or ``async for`` and one iteration at a time: it yields every committed result
    once, those of a stream in order, and ends when all streams have ended. A stream that fails ends alone;
    :meth:`status` says why. A ``with`` or ``async with`` block closes it, or else the end of the program.

    Parameters
    ----------
    listed : sequence of ListedStream
        Its first streams.
    folder : RunFolder
        In which no run has begun.
    arguments : Arguments
    config : Config
    session : ExitStack
        What is left when the run is closed, or cannot begin; it is emptied.
    shared : bool
        Whether others use the Ray session, too.
    references : bool
        Whether it yields references to results.

    Raises
    ------
    ConfigError
        If the output folder or the cluster cannot be used.
    """

    def __init__(
        self,
        listed: Sequence[ListedStream],
        folder: RunFolder,
        arguments: Arguments,
        config: Config,
        session: ExitStack,
        *,
        shared: bool,
        references: bool,
    ) -> None:
        self._folder = folder
        deliveries = Deliveries((), self._folder.path, _log.warning)
        self._job = Job(
            StreamsFile(tuple(listed), {}), arguments, config, self._folder, None, _log.warning, deliveries
        )
        self._references = references
        self._buffer: deque[tuple[str, Yielded]] = deque()
        self._taken: Counter[str] = Counter()  # results of each stream
        self._asked: Reference | None = None  # answers that a cancelled iteration leaves are not lost
        self._states: dict[str, StreamState] = {}
        self._changes: list[SpecChange] = []
        self._joining = {stream.name for stream in listed}  # of which the driver has not said anything yet
        self._changing = Lock()
        self._failure: Exception | None = None
        self._interruption = Interruption(_log.info)
        room = Room(node_memory(), USUAL_NEED)
        with ExitStack() as held:
            held.push(session.pop_all())  # left last: what comes below needs Ray to end
            self._folder.create(self._job.description)
            withdrawal = held.enter_context(ExitStack())
            withdrawal.callback(self._folder.withdraw)
            held.enter_context(self._folder.locked())
            self._queue: Handle = spawn(ResultQueue, node=here())
            held.callback(end, [self._queue])
            self._host = host_of(self._folder.path, room.places, room.need, _log.info, shared=shared)
            withdrawal.pop_all()
            self._held = held.pop_all()  # until it is closed
        self._status = StatusFile(self._folder.path / STATUS)
        self._driver = Driver(
            [self._spec(spec) for spec in self._job.specs],
            self._host,
            admission=admission_to(self._host, room),
            observers=[self._status, self],
            interruption=self._interruption,
            changes=self._next_change,
            is_behind=self._is_behind,
        )
        self._thread = Thread(target=self._drive, name="mlbs-actors-run", daemon=True)
        self._thread.start()
        # Ray leaves its session at exit, in a call that it registered before this one and that comes after
        # it. A run that went on would then set up a session, or join one of somebody else's.
        atexit.register(self.close)

    def add(self, name: str, source: str | Path) -> None:
        """Start another stream, or one that was removed, which goes on where it was.

        Raises
        ------
        ConfigError
            If the name is taken, one of them cannot be used, or there is no such file.
        """
        stream = listed_stream(name, source)
        with self._changing:
            known = self._states.get(name)
            if name in self._joining or (known is not None and not known.interrupted):
                raise ConfigError(f"The run has a stream {name!r} already; choose another name.")
            if not self._thread.is_alive():
                raise ConfigError("The run has been stopped; start another one.")
            self._joining.add(name)
            self._changes.append(SpecChange(added=(self._spec(self._job.add(stream)),)))

    def remove(self, name: str) -> None:
        """Have a stream end soon; what was read is labelled, and comes from the run.

        Raises
        ------
        ConfigError
            If there is no such stream.
        """
        with self._changing:
            if name not in self._states and name not in self._joining:
                raise ConfigError(f"The run has no stream {name!r}.")
            self._joining.discard(name)
            self._changes.append(SpecChange(removed=(name,)))

    def status(self) -> dict[str, StreamState]:
        """Return the states of all streams by their names, as ``status.json`` has them."""
        with self._changing:
            return dict(self._states)

    def stop(self) -> None:
        """End all streams: what was read is labelled, and can still be taken from the run."""
        self._interruption.ask(signal.SIGTERM)
        self._thread.join()

    def close(self) -> None:
        """Stop, and release everything; results that were not taken are dropped. May be called twice."""
        self.stop()
        self._held.close()
        atexit.unregister(self.close)

    def update(self, states: Sequence[StreamState]) -> None:
        """Receive the states of all streams from the driver."""
        with self._changing:
            self._states = {state.name: state for state in states}
            self._joining -= {state.name for state in states if state.state not in ENDED}

    def __enter__(self) -> Run[Yielded]:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    async def __aenter__(self) -> Run[Yielded]:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await asyncio.to_thread(self.close)

    def __iter__(self) -> Iterator[Yielded]:
        return self

    def __next__(self) -> Yielded:
        while not self._buffer:
            may_end = self._has_ended()  # before it is asked: results come before the end of their stream
            try:
                self._take(get(self._ask()))
            except RayActorError as error:
                raise _lost() from error
            if may_end and not self._buffer:
                self._raise_failure()
                raise StopIteration
        return self._next_taken()

    def __aiter__(self) -> AsyncIterator[Yielded]:
        return self

    async def __anext__(self) -> Yielded:
        while not self._buffer:
            may_end = self._has_ended()
            try:
                self._take(await self._ask())
            except RayActorError as error:
                raise _lost() from error
            if may_end and not self._buffer:
                self._raise_failure()
                raise StopAsyncIteration
        return self._next_taken()

    def __repr__(self) -> str:
        states = Counter(state.state for state in self.status().values())
        return f"<Run in {self._folder.path}: {', '.join(f'{n} {name}' for name, n in states.items())}>"

    def _ask(self) -> Reference:
        if not is_there():
            raise MlbsError(_SESSION_ENDED)
        if self._asked is None:
            ready, take = self._queue.ready, self._queue.take
            asked = (
                ready.remote(_WAIT_SECONDS) if self._references else take.remote(_MOST_TAKEN, _WAIT_SECONDS)
            )
            self._asked = cast(Reference, asked)
        return self._asked

    def _take(self, answer: Sequence[Any]) -> None:
        self._asked = None
        for one in answer:
            if isinstance(one, str):
                self._buffer.append((one, self._queue.take_one.remote()))
            else:
                self._buffer.append((one.stream, one))

    def _next_taken(self) -> Yielded:
        name, result = self._buffer.popleft()
        self._taken[name] += 1
        return result

    def _has_ended(self) -> bool:
        if not self._thread.is_alive():
            return True
        with self._changing:
            ended = all(state.state in ENDED for state in self._states.values())
            return ended and not (self._changes or self._joining or self._driver.has_processes)

    def _raise_failure(self) -> None:
        if self._failure is not None:
            raise MlbsError(f"The run has failed: {self._failure}") from self._failure

    def _is_behind(self, name: str, committed: int) -> bool:
        return committed - self._taken[name] >= _MOST_WAITING and self._thread.is_alive()

    def _spec(self, spec: StreamSpec) -> StreamSpec:
        return delivered(spec, self._queue)

    def _next_change(self) -> SpecChange | None:
        if not is_there():
            raise MlbsError(_SESSION_ENDED)
        with self._changing:
            return self._changes.pop(0) if self._changes else None

    def _drive(self) -> None:
        try:
            exit_status = self._driver.run()
            self._status.finish(self._driver.states, exit_status)
        except Exception as error:
            self._failure = error
            _log.exception("The run has failed.")
        finally:
            if is_there():
                self._host.close()


def _lost() -> MlbsError:
    return MlbsError("The process that keeps the results is lost; start another run.")
