"""The sink of a node: writes the records of some streams, off the frame's critical path."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Sequence

from ray.exceptions import RayError

from mlbs_actors.actors.ipc.shared_memory import Shared, SharedMemory, Slot, SlotPool
from mlbs_actors.actors.node.host import Handle, Reference
from mlbs_actors.actors.node.idle_threads import relax_thread_timers
from mlbs_actors.actors.node.process_memory import settle_memory
from mlbs_actors.actors.node.processes import get, is_answered
from mlbs_actors.actors.stream.messages import GapRow, LabelRow
from mlbs_actors.actors.stream.order import FrameOrder
from mlbs_actors.actors.stream.protocol import Opening, Snapshot, StreamSink, StreamSpec
from mlbs_actors.determinism import limit_process
from mlbs_actors.errors import SinkError
from mlbs_actors.messages import LayerAppearance, Segmentation
from mlbs_actors.segmentation.attached_parts import join_parts
from mlbs_actors.source import GapStatus, SourceFrame

__all__ = ["Record", "SinkActor"]

#: Most rows under way to the sink; above that the stream waits. Each holds a frame and a label map.
_PENDING_ROWS = 14

#: Rows per call of the sink, of a file and of a camera: single calls would take half as long as the writing,
#: but somebody may be watching a camera.
_FILE_ROWS, _CAMERA_ROWS = 8, 4

#: Least time between two calls of the sink for fewer rows, s.
_CALL_SECONDS = 0.1

#: Newest label maps in the sink that others may still read: with the next frame the layers, with the one
#: after it the coordinator.
_READ_ROWS = 2

#: Most snapshots under way to the disk; above that the oldest is abandoned.
_PENDING_SNAPSHOTS = 3

#: Interval of checks for an awaited snapshot, s.
_LOOK_SECONDS = 0.05


class SinkActor:
    """Writes the records of some streams of one node, each identified by the stream's number in the pool.

    A record has no holes: after a row that could not be written, or was lost, no other row of that stream is
    accepted.
    """

    def __init__(self) -> None:
        limit_process()
        relax_thread_timers()
        self._records: dict[int, tuple[StreamSink, FrameOrder, SharedMemory]] = {}
        self._settings: dict[int, object] = {}  # for records that are not open yet

    def open(self, run: int, open_sink: Callable[[], StreamSink]) -> Opening:
        """Open a stream's record."""
        sink = open_sink()
        settle_memory()
        before = sink.opening.resume_from
        self._records[run] = sink, FrameOrder(-1 if before is None else before.rows - 1), SharedMemory()
        if run in self._settings:
            sink.configure(self._settings.pop(run))
        return sink.opening

    def configure(self, run: int, settings: object) -> None:
        """See :meth:`StreamSink.configure`; of a record that is not open yet, once it is."""
        if run in self._records:
            self._record(run)[0].configure(settings)
        else:
            self._settings[run] = settings

    def take(self, run: int, rows: Sequence[LabelRow | GapRow]) -> int:
        """Write the next rows; return the number of label maps committed so far."""
        sink, order, memory = self._record(run)
        committed = 0
        for row in rows:
            if isinstance(row, GapRow):
                with order.step(row.index, after=row.index - 1):
                    committed = sink.gap(row.index, row.pts, row.status)
                continue
            segmentation, frame = memory.load(row.segmentation), memory.load(row.frame)
            background = None if row.background is None else memory.load(row.background)
            with order.step(frame.index, after=frame.index - 1):
                committed = sink.write(join_parts(segmentation), frame, background)
        return committed

    def keep(self, run: int, snapshot: Snapshot) -> bool:
        """See :meth:`StreamSink.keep`."""
        return self._record(run)[0].keep(snapshot)

    def provisional(self, run: int) -> None:
        """See :meth:`StreamSink.provisional`."""
        self._record(run)[0].provisional()

    def silent(self, run: int) -> None:
        """See :meth:`StreamSink.silent`."""
        self._record(run)[0].silent()

    def close(self, run: int, whole: bool = False) -> int:
        """Commit the rest, close the stream's files and forget it; return the final count, 0 if forgotten."""
        self._settings.pop(run, None)
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
    spec : StreamSpec
    slots : SlotPool
        Of the stream.

    Attributes
    ----------
    committed : int
        Label maps committed, as far as the sink has answered.
    rows, label_maps : int
        Sent or expected, before the snapshot that the stream went back to and since.
    kept : int
        Rows before the newest snapshot kept.
    """

    def __init__(self, sink: Handle, run: int, spec: StreamSpec, slots: SlotPool) -> None:
        self._slots = slots
        self._sink = sink
        self._run = run
        self._opened: Reference = sink.open.remote(run, spec.open_sink)
        self._batch_rows = _CAMERA_ROWS if spec.live else _FILE_ROWS
        # In the order of the record: expected rows, rows to send, and batches under way to the sink.
        self._expected: deque[GapRow | Shared[SourceFrame]] = deque()
        self._batch: list[LabelRow | GapRow] = []
        self._pending: deque[tuple[Reference, list[LabelRow | GapRow]]] = deque()
        self._in_use: deque[tuple[Slot, ...]] = deque()  # of the newest label maps
        self._sent = time.monotonic()
        self._is_silent = False
        self._submitted: deque[Snapshot] = deque(maxlen=_PENDING_SNAPSHOTS)
        self._asked: tuple[Snapshot, Reference] | None = None
        self._next_asked = 0
        self.committed = self.rows = self.label_maps = self.kept = 0

    def opening(self) -> Opening:
        """Wait until the record is open; raises the error of opening it."""
        opening: Opening = get(self._opened)
        if opening.resume_from is not None:
            self.rows, self.label_maps = opening.resume_from.rows, opening.resume_from.label_maps
            self.committed, self.kept = self.label_maps, self.rows
        return opening

    def expect(self, frame: Shared[SourceFrame]) -> None:
        """Register that the next row is a frame whose label map will follow."""
        self._expected.append(frame)
        self.rows, self.label_maps = self.rows + 1, self.label_maps + 1

    def gap(self, index: int, pts: float, status: GapStatus) -> None:
        """Register that the next row is a frame without label map; raises the error of an earlier row."""
        self._expected.append(GapRow(index, pts, status))
        self.rows += 1
        self._hand_over_gaps()

    def write(self, segmentation: Shared[Segmentation], background: Shared[LayerAppearance] | None) -> None:
        """Send the label map of the first expected frame; raises the error of an earlier row."""
        frame = self._expected.popleft()
        assert isinstance(frame, Shared)  # gaps at the front are sent at once
        self._hand_over(LabelRow(segmentation, frame, background))
        self._hand_over_gaps()

    def submit_snapshot(self, snapshot: Snapshot) -> None:
        """Have a snapshot kept once its files are complete."""
        self._submitted.append(snapshot)

    def await_snapshot(self, seconds: float) -> None:
        """Wait, for a limited time, until the newest snapshot is kept; raises the error of a row."""
        deadline = time.monotonic() + seconds
        self.send()
        self.collect()
        while self._submitted and time.monotonic() < deadline:
            time.sleep(_LOOK_SECONDS)
            self.collect()

    def provisional(self) -> None:
        """See :meth:`StreamSink.provisional`."""
        self._sink.provisional.remote(self._run)

    def silent(self) -> None:
        """Report, once until the next row, that all rows are under way and the source sends nothing."""
        if not self._is_silent:
            self._is_silent = True
            self.send()
            self._sink.silent.remote(self._run)

    def send_if_due(self) -> None:
        """Send the current batch unless another was sent just now."""
        if time.monotonic() - self._sent >= _CALL_SECONDS:
            self.send()

    def send(self) -> None:
        """Send the current batch, even if it is not full."""
        batch = self._batch
        if batch:
            self._sent = time.monotonic()
            self._pending.append((self._sink.take.remote(self._run, batch), batch))
            self._batch = []

    def collect(self) -> None:
        """Take the answers that have arrived, without waiting; raises the error of a row."""
        while self._pending and is_answered(self._pending[0][0]):
            self._take_answer()
        if self._asked is not None and is_answered(self._asked[1]):
            snapshot, kept = self._asked
            self._asked = None
            if get(kept):
                self.kept = snapshot.rows
                if snapshot in self._submitted:
                    while self._submitted.popleft() != snapshot:
                        continue
        if self._submitted and self._asked is None:
            # Cyclically: the files of one may never be complete.
            self._next_asked = (self._next_asked + 1) % len(self._submitted)
            snapshot = self._submitted[self._next_asked]
            self._asked = snapshot, self._sink.keep.remote(self._run, snapshot)

    def close(self, *, whole: bool) -> None:
        """Wait until every row is committed and the files are closed; see :meth:`StreamSink.close`."""
        self.send()
        while self._pending:
            self._take_answer()
        self.committed = get(self._sink.close.remote(self._run, whole))

    def close_after_failure(self) -> None:
        """Commit the rows that were sent and close the files, whatever else fails."""
        self.send()
        while self._pending:
            try:
                self._take_answer()
            except RayError:
                continue
        try:
            self.committed = max(self.committed, get(self._sink.close.remote(self._run)))
        except RayError:
            return

    def _hand_over_gaps(self) -> None:
        while self._expected and isinstance(self._expected[0], GapRow):
            row = self._expected.popleft()
            assert isinstance(row, GapRow)
            self._hand_over(row)

    def _hand_over(self, row: LabelRow | GapRow) -> None:
        self._batch.append(row)
        self._is_silent = False
        if len(self._batch) == self._batch_rows:
            self.send()
        while self._pending and self._under_way > _PENDING_ROWS:
            self._take_answer()

    @property
    def _under_way(self) -> int:
        sent = sum(len(batch) for _, batch in self._pending)
        return len(self._expected) + len(self._batch) + sent

    def _take_answer(self) -> None:
        answer, batch = self._pending.popleft()
        self.committed = get(answer)
        self._in_use.extend(row.slots for row in batch if isinstance(row, LabelRow))
        while len(self._in_use) > _READ_ROWS:
            self._slots.release(self._in_use.popleft())
