"""The record of a stream that hides what moves: no part of it gets a picture that shows it.

Frames are held back until the label maps of the next few are known, so that objects are hidden a little
before they have their first label. All else is as without: rows come in the same order, only later. Nothing
of it is kept: after a return to a snapshot the first frames are hidden by their own and later label maps.
"""

from __future__ import annotations

import copy
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace

from mlbs_actors.actors.stream.protocol import Snapshot, StreamSink
from mlbs_actors.messages import Array, LayerAppearance, Segmentation
from mlbs_actors.source import GapStatus, SourceFrame
from orchestrator.pictures.privacy import FRAMES_AFTER, MovingArea, blurred
from orchestrator.sinks.outer_record import OuterRecord

__all__ = ["PrivateRecord"]

#: How long a snapshot waits for rows that are held, s: after that the stream has stopped.
_SNAPSHOT_SECONDS = 2.0


@dataclass(frozen=True, slots=True)
class _Gap:
    index: int
    pts: float
    status: GapStatus


@dataclass(frozen=True, slots=True)
class _Result:
    segmentation: Segmentation
    frame: SourceFrame
    background: LayerAppearance | None


class PrivateRecord(OuterRecord):
    """Writes a record of blurred pictures.

    Parameters
    ----------
    open_record : callable
        Opens the record that is written to.
    clock : callable
        Monotonic time, s.

    Raises
    ------
    SinkError
        Here and from every method, if that cannot be written.
    """

    def __init__(
        self, open_record: Callable[[], StreamSink], clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._clock = clock
        self._newest = clock()  # when a row came
        super().__init__(open_record)
        self._moving = MovingArea()
        self._held: deque[_Result | _Gap] = deque()
        self._results = 0  # of those held
        self._committed = 0

    def write(
        self, segmentation: Segmentation, frame: SourceFrame, background: LayerAppearance | None = None
    ) -> int:
        """Hold one result; write those whose next label maps are known now."""
        camera = segmentation.camera
        self._moving.follow(segmentation.labels, None if camera is None else camera.ravel().tolist())
        # The arrays are valid until the second label map after this one.
        self._held.append(copy.deepcopy(_Result(segmentation, frame, background)))
        self._results += 1
        self._newest = self._clock()
        if self._results > FRAMES_AFTER:
            self._write_oldest()
        return self._committed

    def gap(self, index: int, pts: float, status: GapStatus) -> int:
        """Record a frame without a label map in its turn."""
        self._held.append(_Gap(index, pts, status))
        self._newest = self._clock()
        if not self._results:
            self._write_oldest()
        return self._committed

    def keep(self, snapshot: Snapshot) -> bool:
        """Register a snapshot to go back to; False if its files, or rows before it, are not complete yet."""
        if self._record.keep(snapshot):
            return True
        if not self._held or self._clock() - self._newest < _SNAPSHOT_SECONDS:
            return False
        self._flush()
        return self._record.keep(snapshot)

    def _flush(self) -> None:
        """Write all that is held: nothing may follow for long, or what follows is written otherwise."""
        while self._held:
            self._write_oldest()

    def _write_oldest(self) -> None:
        """Write the oldest label map held, and the gaps up to the next one."""
        oldest = self._held.popleft()
        if isinstance(oldest, _Result):
            self._results -= 1
            frame = _hidden(oldest.frame, self._moving.mask(self._results))
            self._committed = self._record.write(oldest.segmentation, frame, oldest.background)
        else:
            self._committed = self._record.gap(oldest.index, oldest.pts, oldest.status)
        while self._held and isinstance(gap := self._held[0], _Gap):
            self._held.popleft()
            self._committed = self._record.gap(gap.index, gap.pts, gap.status)


def _hidden(frame: SourceFrame, mask: Array) -> SourceFrame:
    """Blur the picture of a frame, the full one if its reader has shrunk it, which is the one recorded."""
    picture = frame.image if frame.original is None else frame.original
    if picture is None:
        return frame
    shown = blurred(picture, mask)
    return replace(frame, image=shown, original=None if frame.original is None else shown)
