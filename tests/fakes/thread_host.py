"""Runs actors in threads of this process, which takes milliseconds where processes take seconds.

The actors are the same classes, and their channels the same pipes. What they are given and what they answer
is pickled, so they share nothing else. An actor that is killed, or that dies (:func:`die`), ends in its next
operation on a channel or its next call to the host; then its pipes are closed, and its calls fail with Ray's
errors.
"""

from __future__ import annotations

import asyncio
import inspect
import os
import pickle
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from concurrent.futures import Future
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field
from itertools import count
from multiprocessing.connection import Connection, wait
from types import ModuleType
from typing import Any
from weakref import WeakSet

import pytest
from ray.exceptions import ActorDiedError, GetTimeoutError, RayActorError, RayError, RayTaskError

from mlbs_actors.actors.ipc import channels
from mlbs_actors.actors.node import pool, processes
from mlbs_actors.actors.stream import (
    coordinator_actor,
    layer_actor,
    live_reader,
    reader,
    segmenter_actor,
    sink,
)
from mlbs_actors.determinism import single_threaded

#: Limit for an actor's thread to end, s; it ends at once unless the machine is very busy.
_END_SECONDS = 120.0

#: What an actor does to the process that it has for itself.
_TO_ITS_PROCESS: Mapping[str, Callable[..., Any]] = {
    "limit_process": lambda: None,
    "relax_thread_timers": lambda: None,
    "settle_memory": lambda: None,
    "stepping_back": nullcontext,
    "unique_memory": lambda process: 0,
}
_WITH_PROCESSES: Sequence[ModuleType] = (
    coordinator_actor,
    layer_actor,
    live_reader,
    pool,
    processes,
    reader,
    segmenter_actor,
    sink,
)

#: Number of cores of the only node.
_CORES = 2


class ActorKilled(BaseException):
    """Ends the thread of an actor; no code of the product may catch it."""


class _Here(threading.local):
    actor: _Actor | None = None


_here = _Here()
_numbers = count(1)


def die() -> None:
    """End the calling actor as a fault would: its thread, or else its process."""
    if _here.actor is None:
        os._exit(1)
    raise ActorKilled


def pause(seconds: float) -> None:
    """Do nothing for a while, or until the calling actor is killed."""
    if _here.actor is None:
        time.sleep(seconds)
    else:
        _here.actor.wait_for(lambda: False, seconds)


def hang() -> None:
    """Do nothing any more, until the calling actor is killed."""
    pause(10_000.0)


def process_id() -> int:
    """Return the number of the calling actor, or else of its process."""
    return os.getpid() if _here.actor is None else _here.actor.number


class _ActorConnection(Connection):
    """A connection of the actor that opens it: ends with it, and its waiting is interrupted by a kill."""

    def __init__(self, handle: int, readable: bool = True, writable: bool = True) -> None:
        super().__init__(handle, readable, writable)
        self._actor = _here.actor
        if self._actor is not None:
            self._actor.connections.add(self)

    def send_bytes(self, buf: Any, offset: int = 0, size: int | None = None) -> None:
        if self._actor is not None:
            self._actor.check()
        super().send_bytes(buf, offset, size)

    def recv_bytes(self, maxlength: int | None = None) -> bytes:
        self.poll(None)
        return super().recv_bytes(maxlength)

    def poll(self, timeout: float | None = 0.0) -> bool:
        if self._actor is None:
            return super().poll(timeout)
        there = wait([self, self._actor.killing], timeout)
        self._actor.check()
        return bool(there)


def _nothing() -> None:
    """Do what an actor does that is not asynchronous."""


#: Of the running host, by number.
_references: dict[int, ThreadReference] = {}
_handles: dict[int, ThreadHandle] = {}


class ThreadReference:
    """The answer of a call, known to all actors by its number."""

    def __init__(self) -> None:
        self.number = next(_numbers)
        self.answer: Future[bytes] = Future()
        _references[self.number] = self

    def __reduce__(self) -> tuple[Any, ...]:
        return _reference, (self.number,)

    def __await__(self) -> Generator[Any, None, Any]:
        return asyncio.wrap_future(self.future()).__await__()

    def future(self) -> Future[Any]:
        """Return a future of the answer that cannot be cancelled."""
        copy: Future[Any] = Future()
        copy.set_running_or_notify_cancel()

        def pass_on(answer: Future[bytes]) -> None:
            if (error := answer.exception()) is not None:
                copy.set_exception(error)
            else:
                copy.set_result(pickle.loads(answer.result()))

        self.answer.add_done_callback(pass_on)
        return copy


@dataclass(eq=False)
class _Call:
    method: str
    given: bytes
    reference: ThreadReference


@dataclass(frozen=True)
class ThreadHandle:
    """An actor, known to all others by its number."""

    actor: _Actor

    def __getattr__(self, name: str) -> _Method:
        if name.startswith("__") and name not in ("__ray_ready__", "__ray_call__"):
            raise AttributeError(name)
        return _Method(self.actor, name)

    def __reduce__(self) -> tuple[Any, ...]:
        return _handle, (self.actor.number,)


@dataclass(frozen=True)
class _Method:
    actor: _Actor
    name: str

    def options(self, *, name: str) -> _Method:
        return self

    def remote(self, *arguments: object, **named: object) -> ThreadReference:
        call = _Call(self.name, pickle.dumps((arguments, named)), ThreadReference())
        self.actor.submit(call)
        return call.reference


@dataclass(eq=False)
class _Actor:
    """A thread that answers the calls of one actor, in their order or, if it is asynchronous, at once."""

    host: ThreadHost
    kind: type
    given: bytes
    number: int = field(default_factory=lambda: next(_numbers))
    connections: WeakSet[_ActorConnection] = field(default_factory=WeakSet)
    children: list[_Actor] = field(default_factory=list)
    calls: deque[_Call] = field(default_factory=deque)
    unanswered: set[_Call] = field(default_factory=set)
    begin_calls: Callable[[], object] = _nothing
    stop: Callable[[], object] = _nothing
    killed: bool = False
    death: RayActorError | None = None

    def __post_init__(self) -> None:
        _handles[self.number] = ThreadHandle(self)
        self.killing, self._kill = os.pipe()
        self.thread = threading.Thread(target=self._run, name=self.kind.__name__, daemon=True)
        self.thread.start()

    @property
    def identity(self) -> str:
        return f"{self.number:032x}"

    def submit(self, call: _Call) -> None:
        with self.host.news:
            death = self.death
            if death is None:
                self.unanswered.add(call)
                self.calls.append(call)
                self.host.news.notify_all()
                self.begin_calls()
        if death is not None:
            call.reference.answer.set_exception(death)

    def kill(self) -> None:
        with self.host.news:
            if self.killed or self.death is not None:
                return
            self.killed = True
            os.write(self._kill, b"!")
            self.host.news.notify_all()
            self.stop()

    def check(self) -> None:
        """Raise ActorKilled if the actor was killed."""
        if self.killed and threading.current_thread() is self.thread:
            raise ActorKilled

    def wait_for(self, condition: Callable[[], bool], timeout: float | None) -> bool:
        """Wait until something is so, or raise ActorKilled."""
        with self.host.news:
            come = self.host.news.wait_for(lambda: self.killed or condition(), timeout)
        self.check()
        return come

    def _run(self) -> None:
        _here.actor = self
        death = RayActorError(self.identity, f"The actor {self.identity} died unexpectedly.")
        try:
            try:
                arguments = pickle.loads(self.given)
                instance = self.kind(*arguments)
            except Exception as error:
                death = ActorDiedError(self._task_error(error))
            else:
                if inspect.getmembers(self.kind, inspect.iscoroutinefunction):
                    self._serve_at_once(instance)
                else:
                    self._serve_in_turn(instance)
        except ActorKilled:
            pass
        finally:
            self._end(death)

    def _serve_in_turn(self, instance: object) -> None:
        while True:
            self.wait_for(lambda: bool(self.calls), None)
            call = self.calls.popleft()
            try:
                arguments, named = pickle.loads(call.given)
                arguments = [self.host.resolved(one) for one in arguments]
                named = {key: self.host.resolved(one) for key, one in named.items()}
                answer = pickle.dumps(_method(instance, call.method)(*arguments, **named))
            except Exception as error:
                self._answer(call, self._failed(error))
            else:
                self._answer(call, answer)

    def _serve_at_once(self, instance: object) -> None:
        loop = asyncio.new_event_loop()
        tasks: set[asyncio.Task[None]] = set()

        def begin_tasks() -> None:
            while self.calls:
                tasks.add(loop.create_task(self._task(instance, self.calls.popleft())))

        async def cancel_all() -> None:
            others = asyncio.all_tasks() - {asyncio.current_task()}
            for task in others:
                task.cancel()
            await asyncio.gather(*others, return_exceptions=True)

        with self.host.news:
            self.begin_calls = lambda: loop.call_soon_threadsafe(begin_tasks)
            self.stop = lambda: loop.call_soon_threadsafe(loop.stop)
            begin_tasks()
            if self.killed:
                self.stop()
        loop.run_forever()
        with self.host.news:
            self.begin_calls = self.stop = _nothing
        loop.run_until_complete(cancel_all())
        loop.close()

    async def _task(self, instance: object, call: _Call) -> None:
        try:
            arguments, named = pickle.loads(call.given)
            arguments = [await one if isinstance(one, ThreadReference) else one for one in arguments]
            method = _method(instance, call.method)
            answer = method(*arguments, **named)
            answer = pickle.dumps(await answer if inspect.isawaitable(answer) else answer)
        except Exception as error:
            self._answer(call, self._failed(error))
        else:
            self._answer(call, answer)

    def _answer(self, call: _Call, answer: bytes | Exception) -> None:
        with self.host.news:
            self.unanswered.discard(call)
        if isinstance(answer, Exception):
            call.reference.answer.set_exception(answer)
        else:
            call.reference.answer.set_result(answer)
        with self.host.news:
            self.host.news.notify_all()

    def _failed(self, error: Exception) -> Exception:
        """Return what :meth:`ThreadHost.get` raises: of a call that was given a failed answer, its error."""
        if isinstance(error, RayError):
            return error
        failed: Exception = self._task_error(error).as_instanceof_cause()  # type: ignore[no-untyped-call]
        return failed

    def _task_error(self, error: Exception) -> RayTaskError:
        """Wrap an error as Ray does; without its traceback, whose frames would keep the actor alive."""
        told = "".join(traceback.format_exception(error))
        cause = pickle.loads(pickle.dumps(error))
        where = {"proctitle": self.kind.__name__, "ip": "127.0.0.1", "actor_id": self.identity}
        return RayTaskError(self.kind.__name__, told, cause, **where)  # type: ignore[no-untyped-call]

    def _end(self, death: RayActorError) -> None:
        for child in self.children:
            child.kill()
        for connection in list(self.connections):
            connection.close()
        with self.host.news:
            self.death = death
            unanswered, self.unanswered = self.unanswered, set()
            self.calls.clear()
        for call in unanswered:
            call.reference.answer.set_exception(death)
        with self.host.news:
            self.host.news.notify_all()
        os.close(self.killing)
        os.close(self._kill)


def answered(value: object) -> Any:
    """Return a reference to an answer that is there."""
    reference = ThreadReference()
    reference.answer.set_result(pickle.dumps(value))
    return reference


def _reference(number: int) -> ThreadReference:
    return _references[number]


def _handle(number: int) -> ThreadHandle:
    return _handles[number]


def _method(instance: object, name: str) -> Callable[..., Any]:
    if name == "__ray_ready__":
        return lambda: True
    if name == "__ray_call__":
        return lambda function, *arguments: function(instance, *arguments)
    method: Callable[..., Any] = getattr(instance, name)
    return method


class ThreadHost:
    """A :class:`~mlbs_actors.actors.node.host.Host` of one node, in this process."""

    def __init__(self) -> None:
        self.news = threading.Condition()  # a call, an answer, or a kill
        self._actors: list[_Actor] = []
        self.there = True

    def spawn(
        self, kind: type, arguments: Sequence[object], *, node: str, reservation: object, name: str | None
    ) -> ThreadHandle:
        """Start a thread for an actor, which ends with the actor that starts it."""
        actor = _Actor(self, kind, pickle.dumps(arguments))
        self._actors.append(actor)
        if _here.actor is not None:
            _here.actor.children.append(actor)
        return _handles[actor.number]

    def get(self, reference: Any, timeout: float | None) -> Any:
        if not self._wait_for(reference.answer.done, timeout):
            raise GetTimeoutError(f"There was no answer within {timeout} s.")
        if (error := reference.answer.exception()) is not None:
            raise error
        return pickle.loads(reference.answer.result())

    def wait(
        self, references: Sequence[Any], least: int, timeout: float | None
    ) -> tuple[list[Any], list[Any]]:
        def there() -> list[Any]:
            return [one for one in references if one.answer.done()]

        self._wait_for(lambda: len(there()) >= least, timeout)
        chosen = there()[:least]
        return chosen, [one for one in references if one not in chosen]

    def is_there(self) -> bool:
        return self.there

    def kill(self, handle: ThreadHandle) -> None:
        handle.actor.kill()

    def identity(self, handle: ThreadHandle) -> str:
        return handle.actor.identity

    def here(self) -> str:
        return "this process"

    def cores(self, node: str) -> int:
        return _CORES

    def resolved(self, given: object) -> object:
        """Return what an actor is given for an argument: for a reference its answer."""
        return self.get(given, None) if isinstance(given, ThreadReference) else given

    def kill_oldest(self, kind: str) -> bool:
        """Kill the living actor of this class that was started first; return whether there was one."""
        living = [one for one in self._actors if one.kind.__name__ == kind and one.death is None]
        if living:
            living[0].kill()
        return bool(living)

    def close(self) -> None:
        """End all actors."""
        for actor in self._actors:
            actor.kill()
        for actor in self._actors:
            actor.thread.join(_END_SECONDS)
        left = [actor.kind.__name__ for actor in self._actors if actor.thread.is_alive()]
        assert not left, f"threads that do not end: {left}"
        _references.clear()
        _handles.clear()

    def _wait_for(self, condition: Callable[[], bool], timeout: float | None) -> bool:
        if _here.actor is not None:
            return _here.actor.wait_for(condition, timeout)
        with self.news:
            return self.news.wait_for(condition, timeout)


@contextmanager
def threads() -> Iterator[ThreadHost]:
    """Run the actors of this process in threads, until the end of the ``with`` block."""
    host = ThreadHost()
    with pytest.MonkeyPatch.context() as patch, single_threaded(), processes.hosted_by(host):
        patch.setattr(channels, "Connection", _ActorConnection)
        for module in _WITH_PROCESSES:
            for name, instead in _TO_ITS_PROCESS.items():
                if hasattr(module, name):
                    patch.setattr(module, name, instead)
        try:
            yield host
        finally:
            host.close()
