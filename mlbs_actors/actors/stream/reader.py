"""The reader of a stream, in a process of its own: a damaged video can abort the process that decodes it."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import NoReturn

from ray.exceptions import GetTimeoutError

from mlbs_actors.actors.ipc.channels import (
    Channel,
    ChannelAddress,
    ChannelClosedError,
    ChannelListener,
    connect,
)
from mlbs_actors.actors.ipc.shared_memory import Shared, SharedMemory, Slot, SlotPool
from mlbs_actors.actors.node.host import Handle, Reference
from mlbs_actors.actors.node.idle_threads import relax_thread_timers
from mlbs_actors.actors.node.processes import NOTICE_SECONDS, get
from mlbs_actors.actors.stream.messages import ReaderAnswer, ReadNext, Skip
from mlbs_actors.determinism import limit_process
from mlbs_actors.source import FrameReader, SourceFrame, SourceSilence

__all__ = ["LEAST_ASKED", "ReadAhead", "ReaderActor", "answer"]

#: Least frames under way, to make up for a slow one (a key frame), and most: several are requested at once,
#: as a decoder finds its last frames in the caches as long as it continues.
LEAST_ASKED, _MOST_ASKED = 3, 6


class ReaderActor:
    """Opens a source at the first read, so that errors are raised there."""

    def __init__(self, open_reader: Callable[[], FrameReader]) -> None:
        limit_process()
        relax_thread_timers()
        self._open_reader = open_reader
        self._reader: FrameReader | None = None
        self._memory = SharedMemory()
        self._channel = ChannelListener()

    def address(self) -> ChannelAddress:
        """Return the address of the channel for the stream's requests."""
        return self._channel.address

    def serve(self) -> None:
        """Answer requests until the channel is closed; raises SourceError."""
        self._channel.serve(self._answers)

    def read(self, message: ReadNext) -> ReaderAnswer:
        """Return the next frame or that there is none at present, None at the end; raises SourceError."""
        return answer(self._next(), message.slot, self._memory)

    def skip(self, message: Skip) -> None:
        """Read and discard frames, and silences between them; raises SourceError."""
        for _ in range(message.frames):
            while isinstance(self._next(), SourceSilence):
                continue

    def problem(self) -> str | None:
        """Return the damage of the source so far, as a sentence, or None."""
        return None if self._reader is None else self._reader.problem

    def close(self) -> None:
        """Release the source."""
        if self._reader is not None:
            self._reader.close()

    def _answers(self, message: ReadNext | Skip) -> Iterator[ReaderAnswer]:
        if isinstance(message, Skip):
            self.skip(message)
            yield None
        else:
            yield self.read(message)

    def _next(self) -> SourceFrame | SourceSilence | None:
        if self._reader is None:
            self._reader = self._open_reader()
        return self._reader.read()


def answer(said: SourceFrame | SourceSilence | None, slot: Slot, memory: SharedMemory) -> ReaderAnswer:
    """Make a reader's answer: pictures go into the slot."""
    return memory.share(said, slot) if isinstance(said, SourceFrame) and said.image is not None else said


class ReadAhead:
    """The coordinator's end of a reader: keeps a bounded number of reads under way.

    Parameters
    ----------
    reader : Handle
        A :class:`ReaderActor`.
    max_frames : int or None
        Pictures after which to stop; rows without one do not count.
    slots : SlotPool
        For the frames; the recipient of a frame releases its slot.
    memory : SharedMemory
        The coordinator's.

    Attributes
    ----------
    process : int, optional
        The reader's process id, once it serves.
    """

    process: int | None = None
    _most_asked = _MOST_ASKED

    def __init__(self, reader: Handle, max_frames: int | None, slots: SlotPool, memory: SharedMemory) -> None:
        self._reader = reader
        self._left = max_frames
        self._slots = slots
        self._memory = memory
        self._asked: deque[Slot] = deque()
        self._channel: Channel | None = None

    def begin(self, pictures: int = 0) -> None:
        """Start the reader of a stream that has so many pictures already; raises as :meth:`next` does."""
        self._count(pictures)
        self._serve(get(self._reader.address.remote()))

    def skip(self, frames: int) -> None:
        """Skip frames, before the first :meth:`next`; raises as that does."""
        self._send(Skip(frames))
        self._receive()

    def next(self) -> tuple[Shared[SourceFrame] | None, SourceFrame | SourceSilence] | None:
        """Return the next frame or silence, a picture with its reference, or None at the end.

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
        if self._left is not None:
            self._left += 1
        return None, said

    def keeps_up(self, seconds: float) -> bool:
        """Whether :meth:`next` would wait no longer than that, s, or the source is worth waiting for."""
        return self.is_ready(seconds)

    def is_ready(self, seconds: float) -> bool:
        """Whether :meth:`next` would wait no longer than that, s."""
        self._ask()
        assert self._channel is not None  # begun
        return not self._asked or self._channel.has_message(seconds)

    def problem(self) -> str | None:
        """Return :attr:`FrameReader.problem`, after :meth:`stop`; raises RayError if the process died."""
        problem: str | None = get(self._reader.problem.remote())
        return problem

    def stop(self) -> None:
        """Stop reading, and drop the requests under way."""
        self._left = 0
        self._asked.clear()
        if self._channel is not None:
            self._channel.close()

    def finish(self) -> None:
        """End soon, but only without losing a frame that could not be read again."""
        self.stop()

    def forget(self, rows: int) -> None:
        """Report that rows before this number will not be read again."""

    def _serve(self, address: ChannelAddress) -> None:
        self.process = address.owner
        with suppress(ChannelClosedError):
            self._channel = connect(address)
        # After connecting: a reader that outlives its stream must not wait for a peer that never connects.
        self._served: Reference = self._reader.serve.remote()
        if self._channel is None:
            self._raise_cause()

    def _raise_cause(self) -> NoReturn:
        """Raise why the reader has closed its channel."""
        get(self._served, NOTICE_SECONDS)
        raise GetTimeoutError("A reader that was asked for more serves no more.")

    def _count(self, pictures: int) -> None:
        """Count pictures of earlier starts, unless there is no limit or no more is wanted."""
        if self._left:
            self._left = max(self._left - pictures, 0)  # the limit may have been a higher one

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
        # A reader that is gone may have left answers, and then the cause.
        with suppress(ChannelClosedError):
            self._channel.send(message)

    def _receive(self) -> ReaderAnswer:
        assert self._channel is not None  # begun
        try:
            said: ReaderAnswer = self._channel.receive()
        except ChannelClosedError:
            self._raise_cause()
        return said
