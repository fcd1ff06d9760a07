"""Processes of a node that wait for a stream: started in advance, or left by one that came to its end.

A process from nothing takes seconds, most of them for imports and machine code. So those of the next stream
are prepared while others run, and those of a short file take one file after the other.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass, field
from threading import Lock

from ray.exceptions import GetTimeoutError, RayError

from mlbs_actors.actors.node.host import Handle
from mlbs_actors.actors.node.processes import end, get, kill, spawn_standby
from mlbs_actors.actors.parts import PartFactory
from mlbs_actors.actors.stream.coordinator_actor import CoordinatorActor
from mlbs_actors.actors.stream.reader import ReaderActor
from mlbs_actors.actors.stream.segmenter_actor import SegmenterActor

__all__ = ["StandbyProcesses"]

#: Kinds that are started before there is a stream for them.
_PREPARED: tuple[type, ...] = (CoordinatorActor, SegmenterActor)

#: Processes beyond the first of a kind end once they have waited for this long, s.
_IDLE_SECONDS = 10.0

#: Timeout for a process to drop what its stream has left there, s.
_REST_SECONDS = 10.0


@dataclass(slots=True, eq=False)
class _Process:
    """A process without a stream; ``ready`` is done when it has started, or has failed to."""

    handle: Handle
    ready: Future[object] | None = None
    since: float = field(default_factory=time.monotonic)

    @property
    def is_ready(self) -> bool:
        return self.ready is None or self.ready.done()


class StandbyProcesses:
    """The processes of one node that have no stream at present.

    Parameters
    ----------
    node : str
        Id of the node.
    parts : PartFactory
    most : int
        Processes of a kind that are kept at most.
    named : callable
        Returns the name of a new process of a part.
    """

    def __init__(self, node: str, parts: PartFactory, most: int, named: Callable[[str], str]) -> None:
        self._node = node
        self._named = named
        self._most = most
        self._warm: dict[type, Callable[[], None]] = {
            CoordinatorActor: parts.warm_coordinator,
            SegmenterActor: parts.warm_segmenter,
            ReaderActor: _nothing,
        }
        self._waiting: dict[type, list[_Process]] = {kind: [] for kind in self._warm}  # the newest last
        self._changing = Lock()
        self._closed = False

    def take(self, kind: type) -> Handle:
        """Return a process for a stream: one that is ready, else a new one.

        Call its ``become`` first (:func:`mlbs_actors.actors.node.processes.spawn_standby`).
        """
        with self._changing:
            waiting = self._waiting[kind]
            # Only the last one can be unready, and it has low priority.
            if waiting and not waiting[-1].is_ready:
                kill(waiting.pop().handle)
            return waiting.pop().handle if waiting else self._start(kind, awaited=True)

    def prepare(self) -> bool:
        """Prepare the processes of the next stream, or of one that restarts after a loss.

        They are started one after the other in repeated calls, at low priority.

        Returns
        -------
        bool
            Whether all are ready.
        """
        with self._changing:
            every = [process for waiting in self._waiting.values() for process in waiting]
            if self._closed or not all(process.is_ready for process in every):
                return False
            self._end_idle()
            for kind in _PREPARED:
                if not self._waiting[kind]:
                    handle = self._start(kind, awaited=False)
                    self._waiting[kind].append(_Process(handle, handle.__ray_ready__.remote().future()))
                    return False
            return True

    def keep(self, kind: type, handle: Handle) -> None:
        """Keep a process whose stream has come to its end; end it if it does not answer, or is one too many.

        Parameters
        ----------
        kind : type
            As for :meth:`take`, which has returned it.
        handle : Handle
        """
        with suppress(RayError, GetTimeoutError):
            get(handle.rest.remote(), _REST_SECONDS)
            with self._changing:
                if not self._closed and len(self._waiting[kind]) < self._most:
                    self._waiting[kind].append(_Process(handle))
                    return
        end([handle])

    def close(self) -> Iterable[Handle]:
        """Keep no process any more; return those left, which are to be ended."""
        with self._changing:
            self._closed = True
            left = [process.handle for waiting in self._waiting.values() for process in waiting]
            self._waiting = {kind: [] for kind in self._waiting}
            return left

    def _start(self, kind: type, *, awaited: bool) -> Handle:
        name = self._named(kind.__name__.removesuffix("Actor").lower())
        return spawn_standby(kind, self._warm[kind], awaited=awaited, node=self._node, name=name)

    def _end_idle(self) -> None:
        before = time.monotonic() - _IDLE_SECONDS
        for kind, waiting in self._waiting.items():
            idle = [process for process in waiting[:-1] if process.since < before]
            for process in idle:
                kill(process.handle)
            self._waiting[kind] = [process for process in waiting if process not in idle]


def _nothing() -> None:
    """Prepare nothing: a reader imports what its source needs."""
