"""The reader of a live source, a camera, in a process that outlives the others of its stream.

It keeps the frames since the stream's last snapshot in a ring. So a stream that lost its coordinator, a layer
or any other process goes back and gets the same frames again; meanwhile the reader continues and drops frames
that there is no time for. If this very process is lost, the coordinator saves a snapshot of the present
state, and a new reader continues from there.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import replace

from ray.exceptions import GetTimeoutError

from mlbs_actors.actors.ipc.channels import ChannelAddress, ChannelListener
from mlbs_actors.actors.ipc.shared_memory import SharedMemory, Slot, SlotPool
from mlbs_actors.actors.node.host import Handle
from mlbs_actors.actors.node.idle_threads import relax_thread_timers
from mlbs_actors.actors.node.processes import get
from mlbs_actors.actors.stream.messages import Forget, ReaderAnswer, ReadNext, Reopen
from mlbs_actors.actors.stream.reader import LEAST_ASKED, ReadAhead, answer
from mlbs_actors.determinism import limit_process
from mlbs_actors.source import FrameReader, SourceFrame, SourcePosition, SourceSilence

__all__ = ["MOST_PICTURES", "FrameRing", "LiveReadAhead", "LiveReaderActor"]

#: Pictures that are kept, enough for the time between two snapshots. At 1920×1080 that is 400 MB.
MOST_PICTURES = 64

#: A live source answers twice a second; without an answer for this long it counts as lost, s.
_ANSWER_SECONDS = 60.0


class FrameRing:
    """The newest rows of a live source by number; above the most pictures the oldest rows are dropped.

    Parameters
    ----------
    most_pictures : int

    Attributes
    ----------
    next : int
        Number of the next row.
    """

    def __init__(self, most_pictures: int = MOST_PICTURES) -> None:
        self._most_pictures = most_pictures
        self._rows: deque[SourceFrame] = deque()
        self._pictures = 0
        self.next = 0

    @property
    def first(self) -> int:
        """Number of the oldest row that is kept; ``next`` if there is none."""
        return self.next - len(self._rows)

    def __getitem__(self, row: int) -> SourceFrame:
        return self._rows[row - self.first]

    def append(self, frame: SourceFrame) -> None:
        """Add the next row."""
        self._rows.append(frame)
        self.next += 1
        self._pictures += frame.image is not None
        while self._pictures > self._most_pictures:
            self._forget_oldest()

    def forget(self, before: int) -> None:
        """Forget the rows before a number."""
        while self._rows and self.first < before:
            self._forget_oldest()

    def begin_at(self, row: int) -> None:
        """Forget all; the next row has this number."""
        self._rows.clear()
        self._pictures, self.next = 0, row

    def _forget_oldest(self) -> None:
        self._pictures -= self._rows.popleft().image is not None


class LiveReaderActor:
    """Reads a live source for successive starts of its stream.

    Rows are numbered here, across starts: the source's own numbers and times restart with every process. Rows
    that an earlier start had and that are not kept become a row ``gap``.
    """

    def __init__(self, open_reader: Callable[[], FrameReader]) -> None:
        limit_process()
        relax_thread_timers()
        self._open_reader = open_reader
        self._reader: FrameReader | None = None
        self._reopened: int | None = None  # number of the message by which it reads where it does
        self._ring = FrameRing()
        self._memory = SharedMemory()  # of the newest start
        self._row = 0  # the next row of that start
        self._position = SourcePosition()
        self._pts = 0.0  # of the newest row
        self._lag: float | None = None  # of the source's times behind those of the stream, s

    def go_on(self, position: SourcePosition) -> ChannelAddress:
        """Continue after ``position`` for a new start of the stream, through the channel returned."""
        self._channel, self._memory, self._row = ChannelListener(), SharedMemory(), position.rows
        if not self._ring.first <= position.rows <= self._ring.next:
            self._position, self._pts = position, position.pts
            self._ring.begin_at(position.rows)
            self._ring.append(SourceFrame(position.rows, None, position.pts, _name(position.rows), "gap"))
        return self._channel.address

    def serve(self) -> None:
        """Answer that start until its channel is closed; raises SourceError."""
        self._channel.serve(self._answers)

    def read(self, message: ReadNext) -> ReaderAnswer:
        """Return the next row, or that there is none at present; raises SourceError.

        A picture is copied from the ring. Without ``fresh``, None once all kept rows have been returned.
        """
        if self._row == self._ring.next:
            said = self._ask_source() if message.fresh else None
            if not isinstance(said, SourceFrame):
                return said
            self._ring.append(self._placed(said))
        self._row += 1
        return answer(self._ring[self._row - 1], message.slot, self._memory)

    def forget(self, rows: int) -> None:
        """Forget the first ``rows`` rows, which a snapshot covers."""
        self._ring.forget(rows)

    def reopen(self, message: Reopen) -> None:
        """Read from another place; what is between its pictures and those so far is a row ``gap``."""
        if message.number == self._reopened:
            return
        self.close()
        self._reopened = message.number
        self._open_reader, self._reader, self._lag = message.open_reader, None, None
        if self._ring.next:
            rows, pts = self._ring.next, self._pts
            self._position = SourcePosition(rows, pts, time.time())
            self._ring.append(SourceFrame(rows, None, pts, _name(rows), "gap"))

    def problem(self) -> str | None:
        """Return what was wrong with the source so far, as a sentence, or None."""
        return None if self._reader is None else self._reader.problem

    def close(self) -> None:
        """Release the source."""
        if self._reader is not None:
            self._reader.close()

    def _answers(self, message: ReadNext | Forget | Reopen) -> Iterator[ReaderAnswer]:
        if isinstance(message, Forget):
            self.forget(message.rows)
        elif isinstance(message, Reopen):
            self.reopen(message)
        else:
            yield self.read(message)

    def _ask_source(self) -> SourceFrame | SourceSilence | None:
        if self._reader is None:
            self._reader = self._open_reader()
        return self._reader.read()

    def _placed(self, frame: SourceFrame) -> SourceFrame:
        index, began = self._ring.next, self._position
        if self._lag is None:
            away = max(0.0, time.time() - began.time) if began.rows else 0.0
            self._lag = began.pts + away - frame.pts
        self._pts = frame.pts + self._lag
        return replace(frame, index=index, name=_name(index), pts=self._pts)


def _name(row: int) -> str:
    return f"{row:05d}"


class LiveReadAhead(ReadAhead):
    """The coordinator's end of a live source.

    Parameters
    ----------
    reader : Handle
        A :class:`LiveReaderActor`.
    max_frames, slots, memory
        As for :class:`ReadAhead`.
    """

    _most_asked = LEAST_ASKED  # a camera's pictures must not grow old

    def __init__(self, reader: Handle, max_frames: int | None, slots: SlotPool, memory: SharedMemory) -> None:
        super().__init__(reader, max_frames, slots, memory)
        self._fresh = True
        self._answers = False
        self._forgotten = 0

    def go_on(self, position: SourcePosition, pictures: int) -> None:
        """Continue after ``position`` and so many pictures; instead of :meth:`begin`."""
        self._count(pictures)
        self._serve(get(self._reader.go_on.remote(position)))

    def finish(self) -> None:
        """Ask only for the rows that the reader keeps, for nothing new."""
        self._fresh = False

    def keeps_up(self, seconds: float) -> bool:
        """Return True: a camera is waited for, as its stream holds up no other."""
        return True

    def forget(self, rows: int) -> None:
        """See :meth:`LiveReaderActor.forget`."""
        if rows > self._forgotten:
            self._send(Forget(rows))
            self._forgotten = rows

    def reopen(self, message: Reopen) -> None:
        """See :meth:`LiveReaderActor.reopen`."""
        self._send(message)

    def _request(self, slot: Slot) -> ReadNext:
        return ReadNext(slot, self._fresh)

    def _receive(self) -> ReaderAnswer:
        # It may take long to open its source, but then it answers soon.
        assert self._channel is not None  # begun
        if self._answers and not self._channel.has_message(_ANSWER_SECONDS):
            raise GetTimeoutError("A live reader does not answer.")
        said = super()._receive()
        self._answers = True
        return said
