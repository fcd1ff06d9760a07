"""Actor processes: starting, identifying and ending them on a node."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from typing import Any, TypeAlias

import ray
from ray.exceptions import GetTimeoutError, OutOfMemoryError, RayActorError
from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

from mlbs_actors.actors.node.idle_threads import relax_thread_timers
from mlbs_actors.actors.node.priority import stepping_back
from mlbs_actors.actors.node.process_memory import settle_memory
from mlbs_actors.actors.node.reservation import Reservation

__all__ = [
    "LOST_PROCESS",
    "NOTICE_SECONDS",
    "Handle",
    "Reference",
    "ask",
    "end",
    "identity",
    "spawn",
    "spawn_standby",
]

#: A Ray actor handle; Ray makes its methods at run time, so it has no static type.
Handle: TypeAlias = Any

#: A Ray object reference; its type is known where it is created.
Reference: TypeAlias = "ray.ObjectRef[Any]"

#: Errors of calls to actors whose process is gone; Ray reports those that it has ended for lack of memory
#: separately.
LOST_PROCESS = (RayActorError, OutOfMemoryError)

#: How long Ray may take to notice that a process is gone, s.
NOTICE_SECONDS = 10.0


def spawn(
    kind: type,
    *arguments: object,
    node: str,
    reservation: Reservation | None = None,
    name: str | None = None,
) -> Handle:
    """Start an actor on one node and return at once.

    Ray's own restarts and retries are off: a restarted actor would be an empty one, and a retried call could
    feed a frame to a model twice.

    Parameters
    ----------
    kind : type
        Plain class to run in a process of its own.
    *arguments : object
        Its constructor's arguments.
    node : str
        Ray's id of the node; there is no fallback to another one.
    reservation : Reservation, optional
        A granted one of that node, for an actor that takes it; all others ask for no resources.
    name : str, optional
        For Ray's lists of actors; unique.

    Returns
    -------
    Handle
        Errors at the start are raised by the first call.
    """
    actor: Handle = ray.remote(num_cpus=0, max_restarts=0, max_task_retries=0)(kind)
    options: dict[str, object] = {"scheduling_strategy": _there_or_nowhere(node), "name": name}
    if reservation is not None:
        options |= reservation.options()
    return actor.options(**options).remote(*arguments)


def spawn_standby(kind: type, warm: Callable[[], object], *, awaited: bool, node: str) -> Handle:
    """Start an actor's process before its arguments are known; return at once.

    Parameters
    ----------
    kind : type
        As for :func:`spawn`.
    warm : callable
        Picklable; called in the process, to import what the actor will need. Then its memory is tuned.
    awaited : bool
        Whether somebody waits for the process; else it has low priority.
    node : str

    Returns
    -------
    Handle
        Call its ``become`` first, with the constructor's arguments; errors at the start are raised there.
        Keyword arguments are only waited for: calls of different actors may overtake each other.
    """

    def wait(self: object) -> None:
        relax_thread_timers()
        with stepping_back(awaited=awaited):
            warm()
        settle_memory()

    def become(self: object, *arguments: object, **after: object) -> None:
        kind.__init__(self, *arguments)  # type: ignore[misc]

    return spawn(type(kind.__name__, (kind,), {"__init__": wait, "become": become}), node=node)


def ask(call: Callable[[], object], *, node: str) -> Reference:
    """Call a picklable function once in some process of a node; return its answer's reference at once."""
    task: Handle = ray.remote(num_cpus=0, max_retries=0)(_called)
    answer: Reference = task.options(scheduling_strategy=_there_or_nowhere(node)).remote(call)
    return answer


def _called(call: Callable[[], object]) -> object:
    return call()


def _there_or_nowhere(node: str) -> NodeAffinitySchedulingStrategy:
    return NodeAffinitySchedulingStrategy(node_id=node, soft=False)


def identity(handle: Handle) -> str:
    """Return Ray's id of an actor, which errors about it contain."""
    return str(handle._actor_id.hex())


def end(handles: Iterable[Handle], seconds: float = 10.0) -> bool:
    """End actors at once, whatever they are doing, and wait until Ray knows that they are gone.

    Parameters
    ----------
    handles : iterable of Handle
        Actors, dead ones included.
    seconds : float
        How long to wait for all of them, s.

    Returns
    -------
    bool
        Whether all are gone.
    """
    deadline = time.monotonic() + seconds
    ending = list(handles)
    for handle in ending:
        ray.kill(handle)
    left = [handle for handle in ending if not _is_gone(handle, deadline)]
    return not left


def _is_gone(handle: Handle, deadline: float) -> bool:
    while (left := deadline - time.monotonic()) > 0:
        try:
            ray.get(handle.__ray_ready__.remote(), timeout=left)
        except LOST_PROCESS:
            return True
        except GetTimeoutError:
            return False
        time.sleep(0.01)  # the call overtook the kill
    return False
