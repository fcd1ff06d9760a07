"""The node's layer processes: kept warm, acquired by streams, released, ended when too many are idle.

The pool creates every layer process of its node, so all end with it. Its processes have already imported and
compiled everything. If frames wait for a process and none is ready, one is started for them; all others are
started one after the other, beside the frames.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable
from dataclasses import dataclass

import ray
from ray.exceptions import RayError

from mlbs_actors.actors.ipc.channels import ChannelAddress
from mlbs_actors.actors.node.failures import last_line
from mlbs_actors.actors.node.processes import LOST_PROCESS, Handle, identity, spawn
from mlbs_actors.actors.parts import PartFactory
from mlbs_actors.actors.stream.layer_actor import LayerActor
from mlbs_actors.config import Config
from mlbs_actors.errors import ActorLostError, LayerError

__all__ = ["PoolActor", "PoolCensus", "PoolPolicy"]


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
    """

    spare: int = 4
    least: int = 2
    refill_seconds: float = 0.25
    idle_seconds: float = 10.0
    start_seconds: float = 180.0
    release_seconds: float = 3.0


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
class _Idle:
    handle: Handle
    ready: asyncio.Future[None]
    since: float
    awaited: bool = True

    @property
    def soon(self) -> bool:
        """Whether it is worth waiting for: on a busy machine the others take longer than a new one."""
        return self.awaited or self.ready.done()

    def preference(self) -> tuple[bool, float]:
        """Sort key: ready ones first, the last used of them, so that others age; else the first started."""
        return (True, self.since) if self.ready.done() else (False, -self.since)


class PoolActor:
    """Creates and owns every layer process of one node.

    A stream is known by the number that it began with. All methods run in one thread, between whose
    ``await`` s others may run.
    """

    def __init__(self, parts: PartFactory, policy: PoolPolicy) -> None:
        self._parts = parts
        self._policy = policy
        self._node = ray.get_runtime_context().get_node_id()
        self._idle: list[_Idle] = []
        self._busy: dict[int, dict[str, Handle]] = {}  # by stream and process
        self._closed = False
        self._news = asyncio.Event()  # an idle process is ready, or a stream has ended

    async def begin(self, run: int) -> int:
        """Register a new stream; return its number, which must be unused."""
        self._busy[run] = {}
        self._refill()
        return run

    async def acquire(self, run: int, config: Config, *, awaited: bool) -> tuple[Handle, ChannelAddress]:
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

        Raises
        ------
        ActorLostError
            If no process can be started.
        LayerError
            If the stream has ended.
        """
        asked = time.monotonic()
        while run in self._busy:
            process = self._soonest() if awaited else self._ready()
            if process is None:
                self._start_beside_frames()
                self._news.clear()
                await self._news.wait()
                continue
            self._busy[run][identity(process.handle)] = process.handle
            try:
                await asyncio.wait_for(asyncio.shield(process.ready), self._policy.start_seconds)
                address = None
                if run in self._busy:  # else it may belong to another stream by now
                    address = await process.handle.assign.remote(run, config)
            except asyncio.TimeoutError:
                self._busy.get(run, {}).pop(identity(process.handle), None)
                ray.kill(process.handle)
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
        handle = self._busy.get(run, {}).pop(process, None)
        if handle is not None:
            self._keep(handle)

    async def end(self, run: int) -> None:
        """Release the processes that a stream still has; wait until those that do not answer are gone.

        A stream that lost a process is started again at once, and its other processes are warm.
        """
        busy = self._busy.pop(run, {})
        self._news.set()
        await asyncio.gather(*(self._take_back(run, handle) for handle in busy.values()))

    async def close(self) -> None:
        """End every process, and wait until all are gone."""
        self._closed = True
        idle, self._idle = self._idle, []
        busy = [handle for own in self._busy.values() for handle in own.values()]
        self._busy = {}
        await asyncio.gather(*(_end(handle) for handle in [*busy, *(process.handle for process in idle)]))

    async def census(self) -> PoolCensus:
        """Count the processes."""
        return PoolCensus(idle=len(self._idle), busy=sum(map(len, self._busy.values())))

    async def _take_back(self, run: int, handle: Handle) -> None:
        try:
            await asyncio.wait_for(_answered(handle.release.remote(run)), self._policy.release_seconds)
        except (asyncio.TimeoutError, RayError):
            await _end(handle)
        else:
            self._keep(handle)

    def _keep(self, handle: Handle) -> None:
        ready: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        ready.set_result(None)
        self._idle.append(_Idle(handle, ready, time.monotonic()))
        self._news.set()
        asyncio.get_running_loop().call_later(self._policy.idle_seconds, self._shrink)

    def _soonest(self) -> _Idle:
        """Return the idle process that will be ready first, or a new one."""
        soon = [process for process in self._idle if process.soon]
        soonest = max(soon, key=_Idle.preference, default=None)
        if soonest is None:
            return self._start(awaited=True)
        self._idle.remove(soonest)
        return soonest

    def _ready(self) -> _Idle | None:
        """Return an idle process that is ready."""
        ready = max(self._idle, key=_Idle.preference, default=None)
        if ready is None or not ready.ready.done():
            return None
        self._idle.remove(ready)
        return ready

    def _start(self, *, awaited: bool) -> _Idle:
        handle = spawn(LayerActor, self._parts, awaited, node=self._node)
        ready = asyncio.ensure_future(_answered(handle.__ray_ready__.remote()))
        ready.add_done_callback(lambda _: self._news.set())
        return _Idle(handle, ready, time.monotonic(), awaited)

    def _refill(self) -> None:
        while len(self._idle) < self._policy.spare:
            self._idle.append(self._start(awaited=True))

    def _start_beside_frames(self) -> None:
        """Start a low-priority process, unless one is starting."""
        if all(process.ready.done() for process in self._idle):
            self._idle.append(self._start(awaited=False))

    def _top_up(self) -> None:
        """Start a process if too few are idle and none is starting, and check again after a while."""
        if self._closed or len(self._idle) >= min(self._policy.least, self._policy.spare):
            return
        self._start_beside_frames()
        asyncio.get_running_loop().call_later(self._policy.refill_seconds, self._top_up)

    def _shrink(self) -> None:
        surplus = sorted(self._idle, key=lambda process: process.since)
        for process in surplus[: max(0, len(surplus) - self._policy.spare)]:
            if time.monotonic() - process.since >= self._policy.idle_seconds:
                self._idle.remove(process)
                ray.kill(process.handle)


async def _answered(answer: Awaitable[object]) -> None:
    await answer


async def _end(handle: Handle) -> None:
    ray.kill(handle)
    while True:
        try:
            await handle.__ray_ready__.remote()
        except LOST_PROCESS:
            return
        await asyncio.sleep(0.01)  # the call overtook the kill
