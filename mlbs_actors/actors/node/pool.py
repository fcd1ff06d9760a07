"""The node's layer processes: kept warm, acquired by streams, released, ended when too many are idle.

The pool creates every layer process of its node, so all end with it. Its processes have already imported and
compiled everything. If frames wait for a process and none is ready, one is started for them; all others are
started one after the other, beside the frames. None is started that would not fit into the node's memory: a
layer works as well in its segmenter's process.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import TypeVar

from ray.exceptions import RayError

from mlbs_actors.actors.ipc.channels import ChannelAddress
from mlbs_actors.actors.node.failures import last_line
from mlbs_actors.actors.node.host import Handle
from mlbs_actors.actors.node.memory import LAYER_BYTES, STREAM_BYTES, NodeMemory, node_memory, unique_memory
from mlbs_actors.actors.node.processes import LOST_PROCESS, here, identity, kill, spawn
from mlbs_actors.actors.parts import PartFactory
from mlbs_actors.actors.stream.layer_actor import LayerActor
from mlbs_actors.config import Config
from mlbs_actors.errors import ActorLostError, LayerError

__all__ = ["PoolActor", "PoolCensus", "PoolPolicy"]

_T = TypeVar("_T")


@dataclass(frozen=True, slots=True)
class PoolPolicy:
    """How many processes are kept idle.

    Attributes
    ----------
    spare : int
        Idle processes that are ready when a stream begins, and kept afterwards; one takes about 110 MB.
    least : int
        With fewer idle ones another is started beside the frames, one after the other: each takes a second of
        CPU time.
    refill_seconds : float
        How long after a birth a spare process is started in its place, s: where objects enter, others leave,
        and the processes of those come back.
    idle_seconds : float
        Idle processes beyond these are ended once they were idle for this long, s.
    start_seconds : float
        An awaited process that takes longer to start is taken to hang, and replaced, s.
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
    least: int = 2
    refill_seconds: float = 0.25
    idle_seconds: float = 10.0
    start_seconds: float = 180.0
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
    awaited: bool = True

    @property
    def is_ready(self) -> bool:
        """Whether it has started, or never will."""
        return self.ready.done()

    @property
    def memory(self) -> int:
        """Unique memory, bytes; 0 as long as it is starting."""
        return unique_memory(self.ready.result()) if self.is_ready and not self.ready.exception() else 0

    @property
    def soon(self) -> bool:
        """Whether it is worth waiting for: on a busy machine the others take longer than a new one."""
        return self.awaited or self.is_ready

    def preference(self) -> tuple[bool, float]:
        """Sort key: ready ones first, the last used of them, so that others age; else the first started."""
        return (True, self.since) if self.is_ready else (False, -self.since)


class PoolActor:
    """Creates and owns every layer process of one node.

    A stream is known by the number that it began with. All methods run in one thread, between whose
    ``await`` s others may run.
    """

    def __init__(self, parts: PartFactory, policy: PoolPolicy) -> None:
        self._parts = parts
        self._policy = policy
        self._node = here()
        self._idle: list[_Process] = []
        self._busy: dict[int, dict[str, _Process]] = {}  # by stream and process
        self._grown: set[int] = set()  # streams that have all they need but layer processes
        self._closed = False
        self._news = asyncio.Event()  # an idle process is ready, or a stream has ended

    async def begin(self, run: int) -> int:
        """Register a new stream; return its number, which must be unused."""
        self._busy[run] = {}
        self._refill()
        return run

    async def acquire(
        self, run: int, config: Config, *, awaited: bool
    ) -> tuple[Handle, ChannelAddress] | None:
        """Acquire a process for a layer of stream ``run`` as soon as one is ready.

        Parameters
        ----------
        run : int
        config : Config
            Of the stream.
        awaited : bool
            Whether frames wait for it: if none is ready, one is started for it. Else it may take as long as
            needed.

        Returns
        -------
        Handle
            A :class:`~mlbs_actors.actors.stream.layer_actor.LayerActor`, assigned.
        ChannelAddress
            Of the channel for the layer and its steps.
        None
            Instead, if memory is too short for another process: at once if it is awaited, else after a while.

        Raises
        ------
        ActorLostError
            If no process can be started.
        LayerError
            If the stream has ended.
        """
        asked = time.monotonic()
        self._grown.add(run)
        while run in self._busy:
            process = self._soonest() if awaited else self._ready()
            if process is None:
                starting = not awaited and self._start_beside_frames()
                if not starting and (awaited or time.monotonic() - asked > self._policy.short_seconds):
                    return None
                self._news.clear()
                with suppress(asyncio.TimeoutError):
                    await asyncio.wait_for(self._news.wait(), self._policy.short_seconds)
                continue
            self._busy[run][identity(process.handle)] = process
            try:
                await asyncio.wait_for(asyncio.shield(process.ready), self._policy.start_seconds)
                address = None
                if run in self._busy:  # else it may belong to another stream by now
                    address = await process.handle.assign.remote(run, config)
            except asyncio.TimeoutError:
                self._busy.get(run, {}).pop(identity(process.handle), None)
                kill(process.handle)
            except LOST_PROCESS as error:
                self._busy.get(run, {}).pop(identity(process.handle), None)
                # An idle one may have died unnoticed: try the next. If one that was just started died,
                # the next would die again.
                if process.since >= asked and run in self._busy:
                    raise ActorLostError(
                        f"No process could be started for a layer: {last_line(error)}."
                    ) from error
            else:
                # Only now: if every start fails, refilling after each attempt would never end.
                asyncio.get_running_loop().call_later(self._policy.refill_seconds, self._top_up)
                if run in self._busy and address is not None:
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
        self._closed = True
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

    def _soonest(self) -> _Process | None:
        """Return the idle process that will be ready first, or a new one if it fits into memory."""
        soon = [process for process in self._idle if process.soon]
        soonest = max(soon, key=_Process.preference, default=None)
        if soonest is None:
            return self._start(awaited=True) if self._fits_another() else None
        self._idle.remove(soonest)
        return soonest

    def _ready(self) -> _Process | None:
        """Return an idle process that is ready."""
        ready = max(self._idle, key=_Process.preference, default=None)
        if ready is None or not ready.is_ready:
            return None
        self._idle.remove(ready)
        return ready

    def _fits_another(self) -> bool:
        """Whether another process fits into memory even when these and all streams have grown."""
        in_use = self._in_use()
        at_work = [process.memory for process in in_use if process.is_ready]
        grown = max([LAYER_BYTES, *at_work])
        to_come = grown * (1 + len(self._idle) + len(in_use) - len(at_work))
        to_come -= sum(process.memory for process in self._idle)
        to_come += STREAM_BYTES * max(self._policy.streams - len(self._grown), 0)
        return self._policy.memory().free >= to_come

    def _start(self, *, awaited: bool) -> _Process:
        handle = spawn(LayerActor, self._parts, awaited, node=self._node)
        ready = asyncio.ensure_future(_answered(handle.process_id.remote()))
        ready.add_done_callback(lambda _: self._news.set())
        return _Process(handle, ready, time.monotonic(), awaited)

    def _refill(self) -> None:
        while len(self._idle) < self._policy.spare and self._fits_another():
            self._idle.append(self._start(awaited=True))

    def _start_beside_frames(self) -> bool:
        """Start a low-priority process, unless one is starting; return whether one is starting now."""
        if not all(process.is_ready for process in self._idle):
            return True
        if not self._fits_another():
            return False
        self._idle.append(self._start(awaited=False))
        return True

    def _top_up(self) -> None:
        """Start a process if too few are idle and none is starting, and check again after a while."""
        if self._closed or len(self._idle) >= min(self._policy.least, self._policy.spare):
            return
        if self._start_beside_frames():
            asyncio.get_running_loop().call_later(self._policy.refill_seconds, self._top_up)

    def _shrink(self) -> None:
        surplus = sorted(self._idle, key=lambda process: process.since)
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
