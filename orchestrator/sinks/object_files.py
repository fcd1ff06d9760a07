"""Keeps ``objects.csv`` and ``objects.json`` of a stream up to date while its record grows."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from pathlib import Path

from orchestrator.run.durable_files import publish, temporary_path
from orchestrator.sinks.object_list import ObjectList
from orchestrator.sinks.tables import FrameRow

__all__ = ["OBJECTS_CSV", "OBJECTS_JSON", "ObjectFiles"]

OBJECTS_CSV, OBJECTS_JSON = "objects.csv", "objects.json"

#: The most that writing may take. A camera's files grow for weeks, and they are always written whole.
_SHARE_OF_TIME = 1 / 50


class ObjectFiles:
    """The two files of one stream.

    Parameters
    ----------
    folder : Path
        Of the stream.
    stream : str
        Its name.
    rows : iterable of FrameRow
        Those that are committed already.
    clock : callable
        Monotonic time, s.
    """

    def __init__(
        self,
        folder: Path,
        stream: str,
        rows: Iterable[FrameRow],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._folder = folder
        self._stream = stream
        self._objects = ObjectList(rows)
        self._clock = clock
        self._due = -float("inf")

    def add(self, rows: Iterable[FrameRow]) -> None:
        """Add committed rows; write the files unless that took place a moment ago."""
        for row in rows:
            self._objects.add(row)
        if self._clock() >= self._due:
            self.write(complete=False)

    def write(self, *, complete: bool) -> None:
        """Write the files; ``complete`` if the stream came to its end."""
        begun = self._clock()
        csv, json = self._folder / OBJECTS_CSV, self._folder / OBJECTS_JSON
        temporary_path(csv).write_text(self._objects.csv(complete=complete), encoding="utf-8")
        temporary_path(json).write_text(self._objects.json(self._stream, complete=complete), encoding="utf-8")
        publish([csv, json])
        ended = self._clock()
        self._due = ended + (ended - begun) / _SHARE_OF_TIME
