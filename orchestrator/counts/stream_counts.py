"""The counts of streams, as their files have them, for whoever looks on."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from pydantic import TypeAdapter, ValidationError

from orchestrator.counts.count_files import COUNTS_CSV, COUNTS_JSON
from orchestrator.counts.table import HEADER
from orchestrator.storage.last_lines import last_lines

__all__ = ["CountReader", "Heat", "StreamCounts", "recent_hours"]

#: Most bytes that a row of the table takes, well measured.
_ROW_BYTES = 400


@dataclass(frozen=True, slots=True)
class Heat:
    """Where objects stood, in cells over the picture.

    Attributes
    ----------
    columns, rows : int
    label_maps : tuple of int
        Of each cell, row by row: in how many label maps an object stood there.
    """

    columns: int
    rows: int
    label_maps: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class StreamCounts:
    """What was counted in a stream up to a commit; see ``counts.json``.

    Attributes
    ----------
    objects : int
        Present.
    zones : mapping of str to int
        Objects in each zone.
    crossings : mapping of str to mapping of str to int
        Line, direction, crossings so far.
    events : mapping of str to int
        Kind, number so far.
    heat : Heat
    """

    objects: int = 0
    zones: Mapping[str, int] = field(default_factory=dict)
    crossings: Mapping[str, Mapping[str, int]] = field(default_factory=dict)
    events: Mapping[str, int] = field(default_factory=dict)
    heat: Heat = field(default_factory=lambda: Heat(0, 0, ()))


_COUNTS = TypeAdapter(StreamCounts)


class CountReader:
    """Reads what was counted in the streams of a run; a file is read again when it has changed.

    Parameters
    ----------
    folder : Path
        Of the run.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._known: dict[str, tuple[str, StreamCounts]] = {}

    def version(self, stream: str) -> str | None:
        """Return what changes with a stream's counts, None without any."""
        try:
            return str((self._folder / stream / COUNTS_JSON).stat().st_mtime_ns)
        except OSError:
            return None

    def of(self, stream: str) -> StreamCounts:
        """Return those of a stream, none while there is no file that can be read."""
        version = self.version(stream)
        if version is None:
            return StreamCounts()
        if stream not in self._known or self._known[stream][0] != version:
            try:
                counts = _COUNTS.validate_json((self._folder / stream / COUNTS_JSON).read_bytes())
            except (OSError, ValidationError):
                return StreamCounts()
            self._known[stream] = version, counts
        return self._known[stream][1]


def recent_hours(folder: Path, most: int) -> list[dict[str, str]]:
    """Return the last rows of a stream's ``counts.csv``, in its order, at most so many."""
    header = HEADER.rstrip("\n")
    rows = [line for line in last_lines(folder / COUNTS_CSV, most, _ROW_BYTES) if line != header]
    return list(csv.DictReader(rows, header.split(",")))
