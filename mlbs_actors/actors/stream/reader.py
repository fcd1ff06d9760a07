"""The open source of a stream, in a process of its own: a damaged video can abort the one that decodes it."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import NoReturn, TypeAlias

import ray
from ray.exceptions import GetTimeoutError

from mlbs_actors.actors.ipc.channels import (
    Channel,
    ChannelAddress,
    ChannelClosedError,
    ChannelListener,
    connect,
)
from mlbs_actors.actors.ipc.shared_memory import Shared, SharedMemory, Slot, SlotPool
from mlbs_actors.actors.node.idle_threads import relax_thread_timers
from mlbs_actors.actors.node.processes import NOTICE_SECONDS, Handle, Reference
from mlbs_actors.actors.stream.protocol import FrameReader, SourceFrame, SourceSilence
from mlbs_actors.determinism import limit_process
from mlbs_actors.pickling import pickled_by_values

__all__ = ["LEAST_ASKED", "Answer", "ReadAhead", "ReadNext", "ReaderActor", "Skip", "answer"]

#: What a reader says when it is asked for its next row: where a picture is, what has none, or the end.
Answer: TypeAlias = "Shared[SourceFrame] | SourceFrame | SourceSilence | None"

#: Frames that are asked for at least, so that a slow one (a key frame) is made up for, and at most: they are
#: asked for several at once, since a decoder finds its last frames in the caches as long as it goes on.
LEAST_ASKED, _MOST_ASKED = 3, 6


@pickled_by_values
@dataclass(frozen=True, slots=True)
class ReadNext:
    """Asks a reader for its next row.

    Attributes
    ----------
    slot : Slot
        For a picture.
    fresh : bool
        Whether a live source is to be waited for; else only what it gave before is wanted.
    """

    slot: Slot
    fresh: bool = True


@dataclass(frozen=True, slots=True)
class Skip:
    """Asks a reader to pass over frames."""

    frames: int


class ReaderActor:
    """Opens a source at the first read, so that what is wrong with it is raised there."""

    def __init__(self, open_reader: Callable[[], FrameReader]) -> None:
        limit_process()
        relax_thread_timers()
        self._open_reader = open_reader
        self._reader: FrameReader | None = None
        self._memory = SharedMemory()
        self._channel = ChannelListener()

    def address(self) -> ChannelAddress:
        """Return the channel through which the stream asks for its frames."""
        return self._channel.address

    def serve(self) -> None:
        """Do what is asked for, until no more can come; raises SourceError."""
        self._channel.serve(self._answers)

    def read(self, message: ReadNext) -> Answer:
        """Return the next frame or that there is none at present, None at the end; raises SourceError."""
        return answer(self._next(), message.slot, self._memory)

    def skip(self, message: Skip) -> None:
        """Read frames and throw them away, and what comes between them; raises SourceError."""
        for _ in range(message.frames):
            while isinstance(self._next(), SourceSilence):
                continue

    def problem(self) -> str | None:
        """Return what was wrong with the source so far, as a sentence, or None."""
        return None if self._reader is None else self._reader.problem

    def close(self) -> None:
        """Release the source."""
        if self._reader is not None:
            self._reader.close()

    def _answers(self, message: ReadNext | Skip) -> Iterator[Answer]:
        if isinstance(message, Skip):
            self.skip(message)
            yield None
        else:
            yield self.read(message)

    def _next(self) -> SourceFrame | SourceSilence | None:
        if self._reader is None:
            self._reader = self._open_reader()
        return self._reader.read()


def answer(said: SourceFrame | SourceSilence | None, slot: Slot, memory: SharedMemory) -> Answer:
    """What a reader answers: pictures go into the slot."""
    return memory.share(said, slot) if isinstance(said, SourceFrame) and said.image is not None else said


class ReadAhead:
    """The coordinator's end of a reader: keeps a bounded number of reads under way.

    Parameters
    ----------
    reader : Handle
        A :class:`ReaderActor`.
    max_frames : int or None
        Frames after which no more are asked for.
    slots : SlotPool
        For the frames; whoever gets one gives its slot back.
    memory : SharedMemory
        The coordinator's.
    """

    _most_asked = _MOST_ASKED

    def __init__(self, reader: Handle, max_frames: int | None, slots: SlotPool, memory: SharedMemory) -> None:
        self._reader = reader
        self._left = max_frames
        self._slots = slots
        self._memory = memory
        self._asked: deque[Slot] = deque()
        self._channel: Channel | None = None

    def begin(self) -> None:
        """Have the reader serve, before the first :meth:`next`; raises as that does."""
        self._serve(ray.get(self._reader.address.remote()))

    def skip(self, frames: int) -> None:
        """Pass over frames, before the first :meth:`next`; raises as that does."""
        self._pass_over(frames)
        self._send(Skip(frames))
        self._receive()

    def next(self) -> tuple[Shared[SourceFrame] | None, SourceFrame | SourceSilence] | None:
        """Return the next frame or silence, a picture with where it is, or None at the end.

        Raises
        ------
        RayError
            If the reader raised, or its process died.
        """
        self._ask()
        if not self._asked:
            self.stop()
            return None
        slot = self._asked.popleft()
        said = self._receive()
        if isinstance(said, Shared):
            return said, self._memory.load(said)
        self._slots.release([slot])
        if said is None:
            self.stop()
            return None
        is_frame = isinstance(said, SourceFrame) and said.status != "gap"
        if self._left is not None and not is_frame:
            self._left += 1
        return None, said

    def keeps_up(self, seconds: float) -> bool:
        """Whether :meth:`next` would wait no longer than that, s."""
        self._ask()
        assert self._channel is not None  # begun
        return not self._asked or self._channel.has_message(seconds)

    def problem(self) -> str | None:
        """Return :attr:`FrameReader.problem`, after :meth:`stop`; raises RayError if the process died."""
        problem: str | None = ray.get(self._reader.problem.remote())
        return problem

    def stop(self) -> None:
        """Ask for no more frames and forget those that were asked for."""
        self._left = 0
        self._asked.clear()
        if self._channel is not None:
            self._channel.close()

    def finish(self) -> None:
        """Come to an end soon, without a frame that could not be had again."""
        self.stop()

    def forget(self, rows: int) -> None:
        """Note that nobody will go back to before so many rows."""

    def _serve(self, address: ChannelAddress) -> None:
        with suppress(ChannelClosedError):
            self._channel = connect(address)
        # Not before: a reader that outlives its stream must not wait for who never takes the channel.
        self._served: Reference = self._reader.serve.remote()
        if self._channel is None:
            self._raise_cause()

    def _raise_cause(self) -> NoReturn:
        """Raise why the reader has closed its channel."""
        ray.get(self._served, timeout=NOTICE_SECONDS)
        raise GetTimeoutError("A reader that was asked for more serves no more.")

    def _pass_over(self, frames: int) -> None:
        if self._left is not None:
            self._left -= frames

    def _ask(self) -> None:
        if len(self._asked) >= LEAST_ASKED:
            return
        while len(self._asked) < self._most_asked and self._left != 0:
            slot = self._slots.acquire("frame")
            self._send(self._request(slot))
            self._asked.append(slot)
            if self._left is not None:
                self._left -= 1

    def _request(self, slot: Slot) -> ReadNext:
        return ReadNext(slot)

    def _send(self, message: object) -> None:
        assert self._channel is not None  # begun
        # Of a reader that is gone there may still be answers, and then the cause.
        with suppress(ChannelClosedError):
            self._channel.send(message)

    def _receive(self) -> Answer:
        assert self._channel is not None  # begun
        try:
            said: Answer = self._channel.receive()
        except ChannelClosedError:
            self._raise_cause()
        return said
