"""Translates Ray's errors to this package's, with a message about the stream."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence

from ray.exceptions import ObjectLostError, OutOfMemoryError, RayError, RayTaskError

from mlbs_actors.actors.ipc.channels import ChannelClosedError
from mlbs_actors.actors.node.host import Reference
from mlbs_actors.actors.node.processes import LOST_PROCESS, NOTICE_SECONDS, get, wait
from mlbs_actors.errors import ActorLostError, LayerError, MlbsError, SourceError
from mlbs_actors.wording import count_of

__all__ = [
    "COORDINATOR",
    "POOL",
    "SEGMENTER",
    "SINK",
    "cause_of",
    "explain",
    "first_failure",
    "is_loss",
    "last_line",
    "reader_lost",
    "source_failure",
]

#: Parts of a stream, as named in messages.
COORDINATOR = "coordinator"
POOL = "pool of layer processes"
SEGMENTER = "segmenter"
SINK = "sink"


def cause_of(error: BaseException) -> BaseException:
    """Return what was raised in the actor, without Ray's wrapping."""
    return error.cause if isinstance(error, RayTaskError) else error


def first_failure(served: Sequence[Reference], stream: str) -> Exception:
    """Return why one of a stream's processes has closed its channel: the first exception of them.

    Parameters
    ----------
    served : sequence of Reference
        Their calls in which they answer messages.
    stream : str
        The stream's name.
    """
    waiting = list(served)
    deadline = time.monotonic() + NOTICE_SECONDS
    while waiting and (left := deadline - time.monotonic()) > 0:
        ended, waiting = wait(waiting, timeout=left)
        try:
            for one in ended:
                get(one)
        except (RayError, MlbsError) as error:
            return error
    return ActorLostError(
        f"The processes of stream {stream!r} cannot reach each other; what was committed before "
        "is kept. If that happens again and again, run all of Ray as one user."
    )


def explain(error: BaseException, stream: str, roles: Mapping[str, str]) -> MlbsError:
    """Turn any failure of a stream's actors into one MlbsError.

    Parameters
    ----------
    error : BaseException
        As raised by ``ray.get``.
    stream : str
        The stream's name.
    roles : mapping of str to str
        Actor id (:func:`mlbs_actors.actors.node.processes.identity`) to the part that lived there.

    Returns
    -------
    MlbsError
        The actor's own if it raised one, ActorLostError if a process was lost, else LayerError.
    """
    cause = cause_of(error)
    if isinstance(cause, MlbsError):
        return cause
    if not is_loss(cause):
        return LayerError(
            f"Stream {stream!r} failed unexpectedly with {type(cause).__name__}: {last_line(cause)}. "
            "What was committed before is kept; please report this with the video."
        )
    if isinstance(cause, OutOfMemoryError):
        return ActorLostError(
            f"Stream {stream!r} lost a process because the machine ran out of memory; what was committed "
            "before is kept. If that happens again and again, work on fewer streams at once."
        )
    role = roles.get(str(getattr(cause, "actor_id", None)), "part")
    if getattr(cause, "actor_init_failed", False):
        return ActorLostError(f"The {role} of stream {stream!r} could not start: {last_line(cause)}.")
    return ActorLostError(
        f"Stream {stream!r} lost the process of its {role}; what was committed before is kept. "
        "If that happens again and again, look whether the machine runs out of memory."
    )


def is_loss(error: BaseException) -> bool:
    """Whether a process, or its data, is lost, which need not happen again."""
    return isinstance(cause_of(error), (*LOST_PROCESS, ObjectLostError, ChannelClosedError))


def reader_lost(stream: str, frames: int) -> ActorLostError:
    """Report that the process that reads a stream is gone, after this many frames."""
    return ActorLostError(f"The process that reads stream {stream!r} died after {count_of(frames, 'frame')}.")


def source_failure(error: BaseException, source: str, frames: int) -> SourceError:
    """Turn any failure of a stream's reader into a SourceError.

    Only the type of an unexpected exception is stated: its text may contain the source's address, and with it
    a password.

    Parameters
    ----------
    error : BaseException
        As raised by ``ray.get``.
    source : str
        The source, without credentials.
    frames : int
        Frames read before.
    """
    cause = cause_of(error)
    if isinstance(cause, SourceError):
        return cause
    where = f"after {count_of(frames, 'frame')}" if frames else "before its first frame"
    if isinstance(cause, LOST_PROCESS):
        return SourceError(
            f"The process that reads {source} died {where}; it is probably damaged there. "
            "Convert it with another program and run it again."
        )
    return SourceError(f"Reading {source} failed {where} with {type(cause).__name__}.")


def last_line(error: BaseException) -> str:
    """Return the last line of an error's text: in Ray's, what was raised, below the traceback."""
    lines = str(error).strip().splitlines()
    return lines[-1].rstrip(".") if lines else "no message"
