"""Actor processes: starting, identifying, asking and ending them.

All other modules reach the host of the actors (:mod:`mlbs_actors.actors.node.host`) through these functions.
"""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from typing import Any

from ray.exceptions import GetTimeoutError, OutOfMemoryError, RayActorError

from mlbs_actors.actors.node.host import Handle, Host, RayHost, Reference
from mlbs_actors.actors.node.idle_threads import relax_thread_timers
from mlbs_actors.actors.node.priority import stepping_back
from mlbs_actors.actors.node.process_memory import settle_memory
from mlbs_actors.actors.node.reservation import Reservation
from mlbs_actors.errors import MlbsError

__all__ = [
    "LOST_PROCESS",
    "NOTICE_SECONDS",
    "cores_of",
    "end",
    "get",
    "here",
    "hosted_by",
    "identity",
    "is_answered",
    "is_there",
    "kill",
    "spawn",
    "spawn_standby",
    "wait",
]

#: Errors of calls to actors whose process is gone; Ray reports those that it has ended for lack of memory
#: separately.
LOST_PROCESS = (RayActorError, OutOfMemoryError)

#: How long Ray may take to notice that a process is gone, s.
NOTICE_SECONDS = 10.0

_host: Host = RayHost()


@contextmanager
def hosted_by(host: Host) -> Iterator[None]:
    """Have another host than Ray run the actors of this process, until the end of the ``with`` block."""
    global _host
    before, _host = _host, host
    try:
        yield
    finally:
        _host = before


def spawn(
    kind: type,
    *arguments: object,
    node: str,
    reservation: Reservation | None = None,
    name: str | None = None,
) -> Handle:
    """Start an actor on one node and return at once; it is never restarted.

    Parameters
    ----------
    kind : type
        Plain class to run in a process of its own.
    *arguments : object
        Its constructor's arguments.
    node : str
        Id of the node; there is no fallback to another one.
    reservation : Reservation, optional
        A granted one of that node, for an actor that takes it; all others ask for no resources.
    name : str, optional
        For Ray's lists of actors; unique.

    Returns
    -------
    Handle
        Errors at the start are raised by the first call.

    Raises
    ------
    MlbsError
        If what runs the actors has ended.
    """
    if not is_there():
        raise MlbsError("The Ray session has ended; start a new run in another one.")
    return _host.spawn(kind, arguments, node=node, reservation=reservation, name=name)


def spawn_standby(
    kind: type, warm: Callable[[], object], *, awaited: bool, node: str, name: str | None = None
) -> Handle:
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
    name : str, optional
        As for :func:`spawn`.

    Returns
    -------
    Handle
        Call its ``become`` first, with the constructor's arguments; errors at the start are raised there.
        Keyword arguments are only waited for: calls of different actors may overtake each other. After its
        ``rest``, which drops all that it holds, it may ``become`` another one.
    """

    def prepare(self: object) -> None:
        relax_thread_timers()
        with nullcontext() if awaited else stepping_back():
            warm()
        settle_memory()

    def become(self: object, *arguments: object, **after: object) -> None:
        kind.__init__(self, *arguments)  # type: ignore[misc]

    def rest(self: object) -> None:
        vars(self).clear()
        gc.collect()
        settle_memory()

    members = {"__init__": prepare, "become": become, "rest": rest}
    return spawn(type(kind.__name__, (kind,), members), node=node, name=name)


def get(reference: Reference, timeout: float | None = None) -> Any:
    """Wait for the answer of a call.

    Parameters
    ----------
    reference : Reference
    timeout : float, optional
        At most this long, s.

    Returns
    -------
    object

    Raises
    ------
    GetTimeoutError
        If there is none in time.
    RayError
        If the call failed; one of LOST_PROCESS if the actor is gone.
    """
    return _host.get(reference, timeout)


def wait(
    references: Sequence[Reference], *, least: int = 1, timeout: float | None = None
) -> tuple[list[Reference], list[Reference]]:
    """Wait for some answers, errors included, without getting them.

    Parameters
    ----------
    references : sequence of Reference
    least : int
        As many as these end the waiting.
    timeout : float, optional
        At most this long, s.

    Returns
    -------
    there, others : list of Reference
        ``there`` has at most ``least``.
    """
    return _host.wait(references, least, timeout)


def is_answered(reference: Reference) -> bool:
    """Whether :func:`get` would not wait."""
    there, _ = _host.wait([reference], 1, 0)
    return bool(there)


def is_there() -> bool:
    """Whether what runs the actors has not ended: then nothing is left of them, and nothing may be asked."""
    return _host.is_there()


def kill(handle: Handle) -> None:
    """End an actor whatever it is doing, without waiting for it; see :func:`end`."""
    _host.kill(handle)


def identity(handle: Handle) -> str:
    """Return the id of an actor, which errors about it contain."""
    return _host.identity(handle)


def here() -> str:
    """Return the id of the calling process's node."""
    return _host.here()


def cores_of(node: str) -> int:
    """Return the number of cores of a node."""
    return _host.cores(node)


def end(handles: Iterable[Handle], seconds: float = 10.0) -> bool:
    """End actors at once, whatever they are doing, and wait until it is known that they are gone.

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
    if not is_there():
        return True
    deadline = time.monotonic() + seconds
    ending = list(handles)
    for handle in ending:
        kill(handle)
    left = [handle for handle in ending if not _is_gone(handle, deadline)]
    return not left


def _is_gone(handle: Handle, deadline: float) -> bool:
    while (left := deadline - time.monotonic()) > 0:
        try:
            get(handle.__ray_ready__.remote(), left)
        except LOST_PROCESS:
            return True
        except GetTimeoutError:
            return False
        time.sleep(0.01)  # the call overtook the kill
    return False
