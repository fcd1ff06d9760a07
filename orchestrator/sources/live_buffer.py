"""Pictures of a camera that have not been read yet: the newest ones, and a row for every other one.

Pure: the time is an argument. Nothing is lost silently: a picture that was displaced is a row ``dropped``, a
time without pictures a row ``gap``.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from mlbs_actors.messages import Array
from mlbs_actors.source import SourceFrame, SourceStatus

__all__ = ["STALL_SECONDS", "LiveBuffer", "LiveTime", "Picture"]

#: Silence that counts as a stall, and as a gap in the record, s.
STALL_SECONDS = 5.0

#: Pictures kept; few, because the newest are wanted.
CAPACITY = 2

#: Largest deviation of a camera's clock from this machine's before it is reset, s.
_MOST_DRIFT_SECONDS = 5.0

#: A camera's time that goes back by more than this begins anew, as where recordings were joined, s.
_LEAST_RESTART_SECONDS = 0.5


@dataclass(frozen=True, slots=True)
class Picture:
    """One picture as a camera sent it.

    Attributes
    ----------
    time : float, optional
        On the camera's own clock, s.
    convert : callable
        Returns the (H, W, 3) uint8 BGR image, None if it cannot be decoded. Called only if it is needed.
    concealed : bool
        Whether the decoder made up part of it.
    """

    time: float | None
    convert: Callable[[], Array | None]
    concealed: bool = False


class LiveTime:
    """Seconds since the first frame, from the camera's own clock, over all its connections."""

    def __init__(self) -> None:
        self._began: float | None = None
        self._offset: float | None = None
        self._camera_time = -math.inf
        self.last = 0.0
        self._late, self._least_late = 0.0, math.inf

    def reconnected(self) -> None:
        """Accept any time from a new connection."""
        self._offset, self._least_late = None, math.inf

    def of(self, camera_time: float | None, now: float) -> float:
        """Return the time of a picture that arrived at ``now``, by this machine's clock; never decreasing."""
        if self._began is None:
            self._began = now
        arrived = now - self._began
        if camera_time is None:
            pts = arrived
        else:
            restarted = camera_time < self._camera_time - _LEAST_RESTART_SECONDS
            self._camera_time = camera_time
            drift = 0.0 if self._offset is None else camera_time + self._offset - arrived
            if self._offset is None or restarted or abs(drift) > _MOST_DRIFT_SECONDS:
                self._offset, self._least_late = arrived - camera_time, math.inf
            pts = camera_time + self._offset
        self.last = max(self.last, pts)
        self._late = arrived - self.last
        self._least_late = min(self._late, self._least_late)
        return self.last

    @property
    def delay(self) -> float:
        """How long before its arrival the newest picture was taken, s, but for the quickest one's way here.

        A connection may begin with pictures that have waited for it.
        """
        return self._late - self._least_late


@dataclass(slots=True)
class _Row:
    index: int
    pts: float
    status: SourceStatus
    picture: Picture | None
    taken: float | None


class LiveBuffer:
    """Rows in the camera's order."""

    def __init__(self) -> None:
        self._rows: deque[_Row] = deque()
        self._pictures: deque[_Row] = deque()
        self._count = 0

    def __len__(self) -> int:
        return len(self._rows)

    def put(self, picture: Picture, pts: float, taken: float | None = None) -> None:
        """Append a picture taken then, seconds since 1970; if there are too many, the oldest is dropped."""
        row = self._append(pts, "ok", picture, taken)
        self._pictures.append(row)
        if len(self._pictures) > CAPACITY:
            oldest = self._pictures.popleft()
            oldest.status, oldest.picture = "dropped", None

    def gap(self, pts: float) -> None:
        """Append a row for a time without pictures that began at ``pts``."""
        self._append(pts, "gap", None, None)

    def take(self) -> Callable[[], SourceFrame]:
        """Remove the oldest row; return a function that makes it a frame, which takes some milliseconds."""
        row = self._rows.popleft()
        if row.picture is not None:
            self._pictures.popleft()
        return lambda: _frame(row)

    def _append(self, pts: float, status: SourceStatus, picture: Picture | None, taken: float | None) -> _Row:
        row = _Row(self._count, pts, status, picture, taken)
        self._rows.append(row)
        self._count += 1
        return row


def _frame(row: _Row) -> SourceFrame:
    image = None if row.picture is None else row.picture.convert()
    status: SourceStatus = "quarantined" if row.picture is not None and image is None else row.status
    concealed = row.picture is not None and row.picture.concealed
    name = f"{row.index:05d}"
    return SourceFrame(row.index, image, row.pts, name, status, concealed=concealed, taken=row.taken)
