"""The open source of a stream, in a process of its own: a damaged video can abort the one that decodes it."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import TypeAlias

import ray

from mlbs_actors.actors.processes import Handle, Reference
from mlbs_actors.actors.shared_memory import Shared, SharedMemory, Slot, SlotPool
from mlbs_actors.actors.stream_protocol import FrameReader, SourceFrame, SourceSilence
from mlbs_actors.determinism import limit_process

__all__ = ["Answer", "ReadAhead", "ReaderActor", "answer"]

#: What a reader says when it is asked for its next row: where a picture is, what has none, or the end.
Answer: TypeAlias = "Shared[SourceFrame] | SourceFrame | SourceSilence | None"

#: Frames that are decoded beside the work on the one before them. Two, so that a slow one (a key
#: frame) is made up for; each is held in memory.
_FRAMES_AHEAD = 2


class ReaderActor:
    """Opens a source at the first read, so that what is wrong with it is raised there."""

    def __init__(self, open_reader: Callable[[], FrameReader]) -> None:
        limit_process()
        self._open_reader = open_reader
        self._reader: FrameReader | None = None
        self._memory = SharedMemory()

    def read(self, slot: Slot) -> Answer:
        """Return the next frame or that there is none at present, None at the end; raises SourceError."""
        return answer(self._next(), slot, self._memory)

    def skip(self, frames: int) -> None:
        """Read frames and throw them away, and what comes between them; raises SourceError."""
        for _ in range(frames):
            while isinstance(self._next(), SourceSilence):
                continue

    def problem(self) -> str | None:
        """Return what was wrong with the source so far, as a sentence, or None."""
        return None if self._reader is None else self._reader.problem

    def close(self) -> None:
        """Release the source."""
        if self._reader is not None:
            self._reader.close()

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

    def __init__(self, reader: Handle, max_frames: int | None, slots: SlotPool, memory: SharedMemory) -> None:
        self._reader = reader
        self._left = max_frames
        self._slots = slots
        self._memory = memory
        self._asked: deque[tuple[Reference, Slot]] = deque()

    def skip(self, frames: int) -> None:
        """Pass over frames, before the first :meth:`next`; raises as that does."""
        self._pass_over(frames)
        ray.get(self._reader.skip.remote(frames))

    def next(self) -> tuple[Shared[SourceFrame] | None, SourceFrame | SourceSilence] | None:
        """Return the next frame or silence, a picture with where it is, or None at the end.

        Raises
        ------
        RayError
            If the reader raised, or its process died.
        """
        self._ask(_FRAMES_AHEAD + 1)
        if not self._asked:
            return None
        reference, slot = self._asked.popleft()
        said = self._value(reference)
        if isinstance(said, Shared):
            return said, self._memory.taken(said)
        self._slots.give_back([slot])
        if said is None:
            self.stop()
            return None
        is_frame = isinstance(said, SourceFrame) and said.status != "gap"
        if self._left is not None and not is_frame:
            self._left += 1
        return None, said

    def problem(self) -> str | None:
        """Return :attr:`FrameReader.problem`; raises RayError if the process died."""
        problem: str | None = ray.get(self._reader.problem.remote())
        return problem

    def stop(self) -> None:
        """Ask for no more frames and forget those that were asked for."""
        self._left = 0
        self._asked.clear()

    def finish(self) -> None:
        """Come to an end soon, without a frame that could not be had again."""
        self.stop()

    def forget(self, rows: int) -> None:
        """Note that nobody will go back to before so many rows."""

    def _pass_over(self, frames: int) -> None:
        if self._left is not None:
            self._left -= frames

    def _ask(self, wanted: int) -> None:
        while len(self._asked) < wanted and self._left != 0:
            slot = self._slots.take("frame")
            self._asked.append((self._read(slot), slot))
            if self._left is not None:
                self._left -= 1

    def _read(self, slot: Slot) -> Reference:
        reference: Reference = self._reader.read.remote(slot)
        return reference

    def _value(self, reference: Reference) -> Answer:
        value: Answer = ray.get(reference)
        return value
