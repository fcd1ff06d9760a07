"""A record whose results are handed over to the program as they are committed.

A process may be lost between any two lines. A result is offered to the queue before the call that may commit
it, and settled after that call. If the stream goes back, it says what was not committed again, and so it does
with what was committed after its snapshot: the queue has that already.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable
from dataclasses import replace
from functools import partial

from mlbs_actors.actors.node.host import Handle
from mlbs_actors.actors.node.processes import get
from mlbs_actors.actors.stream.protocol import Snapshot, StreamSink, StreamSpec
from mlbs_actors.messages import LayerAppearance, Segmentation
from mlbs_actors.source import GapStatus, SourceFrame
from orchestrator.library.result import StreamResult
from orchestrator.library.result_queue import Numbered
from orchestrator.sinks.outer_record import OuterRecord
from orchestrator.sinks.record import ends_group
from orchestrator.working_size import enlarged

__all__ = ["DeliveredRecord", "delivered"]


def delivered(spec: StreamSpec, queue: Handle) -> StreamSpec:
    """Return a stream whose results go to a queue, too."""
    return replace(spec, open_sink=partial(DeliveredRecord, spec.open_sink, spec.name, queue, live=spec.live))


class DeliveredRecord(OuterRecord):
    """Writes a record, and hands over its results.

    Parameters
    ----------
    open_record : callable
        Opens the record that is written to.
    name : str
        The stream's.
    queue : Handle
        The run's :class:`~orchestrator.library.result_queue.ResultQueue`.
    live : bool
        Whether it is a camera's record, whose rows are committed with a snapshot.

    Raises
    ------
    SinkError
        Here and from every method, if the record cannot be written.
    """

    def __init__(
        self, open_record: Callable[[], StreamSink], name: str, queue: Handle, *, live: bool = False
    ) -> None:
        super().__init__(open_record)
        self._name = name
        self._queue = queue
        self._live = live
        before = self._record.opening.resume_from
        self._label_maps = self._settled = 0 if before is None else before.label_maps
        self._start: int = get(queue.open.remote(name, self._label_maps))
        self._held: list[Numbered] = []

    def write(
        self, segmentation: Segmentation, frame: SourceFrame, background: LayerAppearance | None = None
    ) -> int:
        """Write one result; return the number of label maps committed."""
        shown = segmentation
        if frame.original is not None:
            shown = enlarged(segmentation, frame.original.shape[:2])
        self._held.append((self._label_maps, pickle.dumps(StreamResult.of(shown, frame, self._name))))
        self._label_maps += 1
        if ends_group(frame.index):
            self._flush()
        return self._settle(self._record.write(segmentation, frame, background))

    def gap(self, index: int, pts: float, status: GapStatus) -> int:
        """Record a frame without a label map; return the number of label maps committed."""
        if ends_group(index):
            self._flush()
        return self._settle(self._record.gap(index, pts, status))

    def keep(self, snapshot: Snapshot) -> bool:
        """Register a snapshot to go back to; of a camera that commits the rows before it."""
        self._flush()
        kept = self._record.keep(snapshot)
        if kept and self._live:
            self._settle(snapshot.label_maps)
        return kept

    def close(self, *, whole: bool) -> int:
        """Commit the rest and close all files; return the number of label maps committed."""
        committed = super().close(whole=whole)
        get(self._queue.settle.remote(self._name, self._start, committed))
        return committed

    def _flush(self) -> None:
        """Have the queue take what it does not have yet, and wait until it has."""
        if self._held:
            get(self._queue.offer.remote(self._name, self._start, self._held))
            self._held = []

    def _settle(self, committed: int) -> int:
        if committed > self._settled:
            if self._held and self._held[0][0] < committed:
                self._flush()  # it was committed before the stream went back
            self._settled = committed
            self._queue.settle.remote(self._name, self._start, committed)
        return committed
