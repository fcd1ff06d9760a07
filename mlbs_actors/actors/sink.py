"""A sink of a node: the records of some streams being written, off the frame's critical path."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable

import ray
from ray.exceptions import RayError

from mlbs_actors.actors.order import FrameOrder
from mlbs_actors.actors.processes import Handle, Reference
from mlbs_actors.actors.shared_memory import Shared, SharedMemory, Slot, SlotPool
from mlbs_actors.actors.stream_protocol import GapStatus, Opening, Snapshot, SourceFrame, StreamSink
from mlbs_actors.determinism import limit_process
from mlbs_actors.errors import SinkError
from mlbs_actors.messages import LayerAppearance, Segmentation

__all__ = ["Record", "SinkActor"]

#: Rows that may be under way to the sink; the stream waits at more. Each holds a frame and a label map.
_PENDING_ROWS = 8

#: Newest rows in the sink whose messages others may still read.
_READ_ROWS = 2

#: Snapshots that may be under way to the disk; at more the oldest is given up.
_PENDING_SNAPSHOTS = 3

#: From one look for a snapshot that is waited for to the next, s.
_LOOK_SECONDS = 0.05


class SinkActor:
    """Writes the records of some streams of one node, each known by the stream's number in the pool.

    A record has no holes: after a row that could not be written, or that was lost on its way, no other row of
    that stream is taken.
    """

    def __init__(self) -> None:
        limit_process()
        self._records: dict[int, tuple[StreamSink, FrameOrder, SharedMemory]] = {}

    def open(self, run: int, open_sink: Callable[[], StreamSink]) -> Opening:
        """Open a stream's record."""
        sink = open_sink()
        before = sink.opening.resume_from
        self._records[run] = sink, FrameOrder(-1 if before is None else before.rows - 1), SharedMemory()
        return sink.opening

    def write(
        self,
        run: int,
        shared_segmentation: Shared[Segmentation],
        shared_frame: Shared[SourceFrame],
        background: LayerAppearance | None,
    ) -> int:
        """Take one result; return how many label maps are committed by now."""
        sink, order, memory = self._record(run)
        segmentation, frame = memory.taken(shared_segmentation), memory.taken(shared_frame)
        with order.step(frame.index, after=frame.index - 1):
            return sink.write(segmentation, frame, background)

    def gap(self, run: int, index: int, pts: float, status: GapStatus) -> int:
        """Record a frame without label map; return how many label maps are committed by now."""
        sink, order, _ = self._record(run)
        with order.step(index, after=index - 1):
            return sink.gap(index, pts, status)

    def keep(self, run: int, snapshot: Snapshot) -> bool:
        """See :meth:`StreamSink.keep`."""
        return self._record(run)[0].keep(snapshot)

    def provisional(self, run: int) -> None:
        """See :meth:`StreamSink.provisional`."""
        self._record(run)[0].provisional()

    def close(self, run: int, whole: bool = False) -> int:
        """Commit the rest, close the stream's files and forget it; return the final count, 0 if forgotten."""
        sink, *_ = self._records.pop(run, (None,))
        return 0 if sink is None else sink.close(whole=whole)

    def _record(self, run: int) -> tuple[StreamSink, FrameOrder, SharedMemory]:
        if run not in self._records:
            raise SinkError("A row came for a record that is not open; start the stream again.")
        return self._records[run]


class Record:
    """The coordinator's end of its record: keeps a bounded number of rows under way.

    Parameters
    ----------
    sink : Handle
        The node's :class:`SinkActor`.
    run : int
        The stream's number.
    open_sink : callable
        :attr:`StreamSpec.open_sink`.
    slots : SlotPool
        Of the stream.

    Attributes
    ----------
    committed : int
        Label maps committed, as far as the sink has answered.
    rows, label_maps : int
        What was handed over, before the snapshot that the stream went back to and since.
    kept : int
        Rows before the newest snapshot that is kept.
    """

    def __init__(self, sink: Handle, run: int, open_sink: Callable[[], StreamSink], slots: SlotPool) -> None:
        self._slots = slots
        self._in_use: deque[tuple[Slot, ...]] = deque()  # of the rows that were answered last
        self._sink = sink
        self._run = run
        self._opened: Reference = sink.open.remote(run, open_sink)
        self._pending: deque[tuple[Reference, tuple[Slot, ...]]] = deque()
        self._offered: deque[Snapshot] = deque(maxlen=_PENDING_SNAPSHOTS)
        self._asked: tuple[Snapshot, Reference] | None = None
        self._turn = 0
        self.committed = self.rows = self.label_maps = self.kept = 0

    def opening(self) -> Opening:
        """Wait until the record is open; raises what its opening raised."""
        opening: Opening = ray.get(self._opened)
        if opening.resume_from is not None:
            self.rows, self.label_maps = opening.resume_from.rows, opening.resume_from.label_maps
            self.committed, self.kept = self.label_maps, self.rows
        return opening

    def write(
        self,
        segmentation: Reference,
        frame: Shared[SourceFrame],
        background: Reference | None,
        slots: tuple[Slot, ...],
    ) -> None:
        """Hand over one result; raises what an earlier row raised.

        ``slots`` are those of all messages about its frame. They are given back when two more label maps have
        come to the sink: with the next frame the layers may still read this one, with the one after it the
        coordinator.
        """
        written: Reference = self._sink.write.remote(self._run, segmentation, frame, background)
        self._pending.append((written, slots))
        self.rows, self.label_maps = self.rows + 1, self.label_maps + 1
        self._hold_back()

    def gap(self, index: int, pts: float, status: GapStatus) -> None:
        """Hand over a frame without label map; raises what an earlier row raised."""
        self._pending.append((self._sink.gap.remote(self._run, index, pts, status), ()))
        self.rows += 1
        self._hold_back()

    def offer(self, snapshot: Snapshot) -> None:
        """Have a snapshot kept once its files are there."""
        self._offered.append(snapshot)

    def await_snapshot(self, seconds: float) -> None:
        """Wait until the newest snapshot is kept, but not longer than that; raises what a row raised."""
        deadline = time.monotonic() + seconds
        self.collect()
        while self._offered and time.monotonic() < deadline:
            time.sleep(_LOOK_SECONDS)
            self.collect()

    def provisional(self) -> None:
        """See :meth:`StreamSink.provisional`."""
        self._sink.provisional.remote(self._run)

    def collect(self) -> None:
        """Take the answers that are there, without waiting; raises what a row raised."""
        while self._pending and ray.wait([self._pending[0][0]], timeout=0)[0]:
            self._take_answer()
        if self._asked is not None and ray.wait([self._asked[1]], timeout=0)[0]:
            snapshot, kept = self._asked
            self._asked = None
            if ray.get(kept):
                self.kept = snapshot.rows
                if snapshot in self._offered:
                    while self._offered.popleft() != snapshot:
                        continue
        if self._offered and self._asked is None:
            # In turn: the files of one may never come.
            self._turn = (self._turn + 1) % len(self._offered)
            snapshot = self._offered[self._turn]
            self._asked = snapshot, self._sink.keep.remote(self._run, snapshot)

    def close(self, *, whole: bool) -> None:
        """Wait until every row is committed and the files are closed; see :meth:`StreamSink.close`."""
        while self._pending:
            self._take_answer()
        self.committed = ray.get(self._sink.close.remote(self._run, whole))

    def close_after_failure(self) -> None:
        """Commit the rows that were handed over whole and close the files, whatever else goes wrong."""
        while self._pending:
            try:
                self._take_answer()
            except RayError:
                continue
        try:
            self.committed = max(self.committed, ray.get(self._sink.close.remote(self._run)))
        except RayError:
            return

    def _hold_back(self) -> None:
        while len(self._pending) > _PENDING_ROWS:
            self._take_answer()

    def _take_answer(self) -> None:
        answer, slots = self._pending.popleft()
        self.committed = ray.get(answer)
        if slots:
            self._in_use.append(slots)
            if len(self._in_use) > _READ_ROWS:
                self._slots.give_back(self._in_use.popleft())
