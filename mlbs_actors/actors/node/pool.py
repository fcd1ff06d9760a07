"""The node's layer processes: started when a layer asks for one, released, kept for the next layers.

The pool creates every layer process of its node, so all end with it. A layer works as well in its
segmenter's process, so no frame waits for one: they are started at low priority beside the frames, for each
stream one after the other, and none that would not fit into the node's memory.
"""

from __future__ import annotations

import asyncio
import secrets
import time
from collections.abc import Awaitable, Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import count
from typing import TypeVar

from ray.exceptions import RayError

from mlbs_actors.actors.ipc.channels import ChannelAddress
from mlbs_actors.actors.node.failures import last_line
from mlbs_actors.actors.node.host import Handle
from mlbs_actors.actors.node.memory import LAYER_BYTES, STREAM_BYTES, NodeMemory, node_memory, unique_memory
from mlbs_actors.actors.node.processes import LOST_PROCESS, cores_of, here, identity, kill, spawn
from mlbs_actors.actors.parts import PartFactory
from mlbs_actors.actors.stream.layer_actor import LayerActor
from mlbs_actors.config import Config
from mlbs_actors.errors import ActorLostError, LayerError

__all__ = ["PoolActor", "PoolCensus", "PoolPolicy"]

_T = TypeVar("_T")


@dataclass(frozen=True, slots=True)
class PoolPolicy:
    """How many processes are kept idle, and how long the pool waits.

    Attributes
    ----------
    spare : int
        Idle processes that are kept for layers born later; one takes about 110 MB.
    idle_seconds : float
        Those beyond are ended once they were idle for this long, s.
    start_seconds : float
        A process that takes longer to start is taken to hang, and replaced, s: where all cores are busy, one
        of low priority takes minutes, and the first ones compile.
    release_seconds : float
        Timeout for a layer's process to leave a stream that has ended, after which it is ended too, s.
    short_seconds : float
        How long a layer waits for a process to be released, if memory is too short to start one, s.
    streams : int
        Streams for which memory is reserved, even before they begin.
    memory : callable
        Measures the node's memory.
    """

    spare: int = 4
    idle_seconds: float = 10.0
    start_seconds: float = 900.0
    release_seconds: float = 3.0
    short_seconds: float = 2.0
    streams: int = 1
    memory: Callable[[], NodeMemory] = node_memory


@dataclass(frozen=True, slots=True)
class PoolCensus:
    """Numbers of processes of a pool.

    Attributes
    ----------
    idle : int
        Waiting for a layer, those still starting included.
    busy : int
        Acquired by streams.
    """

    idle: int
    busy: int


@dataclass(frozen=True, slots=True, eq=False)
class _Process:
    handle: Handle
    ready: asyncio.Future[int]  # its id
    since: float

    @property
    def is_ready(self) -> bool:
        """Whether it has started."""
        return self.ready.done() and self.ready.exception() is None

    @property
    def memory(self) -> int:
        """Unique memory, bytes; 0 as long as it is starting."""
        return unique_memory(self.ready.result()) if self.is_ready else 0


class PoolActor:
    """Creates and owns every layer process of one node.

    A stream is known by the number that it began with. All methods run in one thread, between whose
    ``await`` s others may run.
    """

    def __init__(self, parts: PartFactory, policy: PoolPolicy) -> None:
        self._parts = parts
        self._policy = policy
        self._node = here()
        self._mark = secrets.token_hex(3)  # keeps the names of processes apart from those of other pools
        self._numbers = count(1)
        self._idle: list[_Process] = []
        self._busy: dict[int, dict[str, _Process]] = {}  # by stream and process
        self._grown: set[int] = set()  # streams that have all they need but layer processes
        self._starts: set[asyncio.Future[None]] = set()  # which asyncio itself would forget
        self._failed: dict[_Process | None, BaseException] = {}
        self._most_starting = max(2, cores_of(self._node) // 2)
        self._news = asyncio.Event()  # an idle process is ready, or gone, or a stream has ended

    async def begin(self, run: int) -> int:
        """Register a new stream; return its number, which must be unused."""
        self._busy[run] = {}
        return run

    async def acquire(self, run: int, config: Config) -> tuple[Handle, ChannelAddress] | None:
        """Acquire a process for a layer of stream ``run``, as soon as one has started or is released.

        Parameters
        ----------
        run : int
        config : Config
            Of the stream.

        Returns
        -------
        Handle
            A :class:`~mlbs_actors.actors.stream.layer_actor.LayerActor`, assigned.
        ChannelAddress
            Of the channel for the layer and its steps.
        None
            Instead, if memory is too short for another process, and none is released for a while.

        Raises
        ------
        ActorLostError
            If no process can be started.
        LayerError
            If the stream has ended.
        """
        asked = time.monotonic()
        self._grown.add(run)
        started: _Process | None = None
        while run in self._busy:
            process = self._take_ready()
            if process is None:
                if started in self._failed:
                    error = self._failed.pop(started)
                    raise ActorLostError(f"No process could be started for a layer: {last_line(error)}.")
                if started not in self._idle and self._starting < self._most_starting:
                    started = self._start() if self._fits_another() else None
                if not self._starting and time.monotonic() - asked > self._policy.short_seconds:
                    return None
                self._news.clear()
                with suppress(asyncio.TimeoutError):
                    await asyncio.wait_for(self._news.wait(), self._policy.short_seconds)
                continue
            self._busy[run][identity(process.handle)] = process
            try:
                address = await process.handle.assign.remote(run, config)
            except LOST_PROCESS:  # it may have died unnoticed: try the next
                self._busy.get(run, {}).pop(identity(process.handle), None)
            else:
                if run in self._busy:  # else it has been released with the others
                    return process.handle, address
        raise LayerError("A layer was to be born in a stream that has ended; start the stream again.")

    async def release(self, run: int, process: str, released: None) -> None:
        """Release the process of a retired layer, by its identity; ``released`` is its own answer.

        Not by its layer: a layer that wakes can have another process before the old one is released.
        """
        own = self._busy.get(run, {}).pop(process, None)
        if own is not None:
            self._keep(own)

    async def end(self, run: int) -> None:
        """Release the processes that a stream still has; wait until those that do not answer are gone.

        A stream that lost a process is started again at once, and its other processes are warm.
        """
        busy = self._busy.pop(run, {})
        self._grown.discard(run)
        self._news.set()
        await asyncio.gather(*(self._take_back(run, process) for process in busy.values()))

    async def close(self) -> None:
        """End every process, and wait until all are gone."""
        every = [*self._in_use(), *self._idle]
        self._idle, self._busy = [], {}
        await asyncio.gather(*(_end(process.handle) for process in every))

    async def census(self) -> PoolCensus:
        """Count the processes."""
        return PoolCensus(idle=len(self._idle), busy=len(self._in_use()))

    def _in_use(self) -> list[_Process]:
        return [process for own in self._busy.values() for process in own.values()]

    async def _take_back(self, run: int, process: _Process) -> None:
        released = process.handle.release.remote(run)
        try:
            await asyncio.wait_for(_answered(released), self._policy.release_seconds)
        except (asyncio.TimeoutError, RayError):
            await _end(process.handle)
        else:
            self._keep(process)

    def _keep(self, process: _Process) -> None:
        self._idle.append(replace(process, since=time.monotonic()))
        self._news.set()
        asyncio.get_running_loop().call_later(self._policy.idle_seconds, self._shrink)

    def _take_ready(self) -> _Process | None:
        """Take the idle process that was used last, so that the others age; None if none is ready."""
        ready = [process for process in self._idle if process.is_ready]
        last = max(ready, key=lambda process: process.since, default=None)
        if last is not None:
            self._idle.remove(last)
        return last

    def _fits_another(self) -> bool:
        """Whether another process fits into memory even when these and all streams have grown."""
        grown = max([LAYER_BYTES, *(process.memory for process in self._in_use())])
        to_come = grown * (1 + len(self._idle))
        to_come -= sum(process.memory for process in self._idle)
        to_come += STREAM_BYTES * max(self._policy.streams - len(self._grown), 0)
        return self._policy.memory().free >= to_come

    @property
    def _starting(self) -> int:
        return sum(not process.is_ready for process in self._idle)

    def _start(self) -> _Process:
        name = f"layer process {next(self._numbers)} ({self._mark})"
        handle = spawn(LayerActor, self._parts, node=self._node, name=name)
        ready = asyncio.ensure_future(_answered(handle.process_id.remote()))
        process = _Process(handle, ready, time.monotonic())
        self._idle.append(process)
        self._starts.add(watched := asyncio.ensure_future(self._started(process)))
        watched.add_done_callback(self._starts.discard)
        return process

    async def _started(self, process: _Process) -> None:
        """Wait until a process has started; drop it if it does not, or if none wants it any more."""
        await asyncio.wait({process.ready}, timeout=self._policy.start_seconds)
        if not process.is_ready and process in self._idle:
            if process.ready.done() and (error := process.ready.exception()):
                self._failed[process] = error
            self._idle.remove(process)
            kill(process.handle)
        self._news.set()
        asyncio.get_running_loop().call_later(self._policy.idle_seconds, self._shrink)

    def _shrink(self) -> None:
        ready = (process for process in self._idle if process.is_ready)
        surplus = sorted(ready, key=lambda process: process.since)
        for process in surplus[: max(0, len(surplus) - self._policy.spare)]:
            if time.monotonic() - process.since >= self._policy.idle_seconds:
                self._idle.remove(process)
                kill(process.handle)


async def _answered(answer: Awaitable[_T]) -> _T:
    return await answer


async def _end(handle: Handle) -> None:
    kill(handle)
    while True:
        try:
            await handle.__ray_ready__.remote()
        except LOST_PROCESS:
            return
        await asyncio.sleep(0.01)  # the call overtook the kill
