"""Writes ``counts.csv``, ``counts.parquet`` and ``counts.json`` of a stream with the commits of its record.

Hours that have ended stand at the beginning of ``counts.csv`` and are never changed; the state that commits
hold says how long that part is. Behind them is the open hour, as it was at the last writing.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import pyarrow.parquet as pq

from orchestrator.counts.table import HEADER, csv_rows, table_of
from orchestrator.counts.tally import HEAT_COLUMNS, HEAT_ROWS, PICTURE, CountState, HourCounts, Tally
from orchestrator.storage.durable_files import temporary_path
from orchestrator.storage.share_of_time import ShareOfTime

__all__ = ["COUNTS_CSV", "COUNTS_JSON", "COUNTS_PARQUET", "CountFiles"]

COUNTS_CSV, COUNTS_PARQUET, COUNTS_JSON = "counts.csv", "counts.parquet", "counts.json"

#: The most that writing may take while no hour ends, and the least time between two writings, s.
_SHARE_OF_TIME, _LEAST_SECONDS = 1 / 50, 5.0


class CountFiles:
    """The files of one stream's counts.

    Parameters
    ----------
    folder : Path
        Of the stream.
    stream : str
        Its name.
    clock : callable
        Monotonic time, s.
    """

    def __init__(self, folder: Path, stream: str, clock: Callable[[], float] = time.monotonic) -> None:
        self._folder = folder
        self._stream = stream
        self._writing = ShareOfTime(_SHARE_OF_TIME, _LEAST_SECONDS, clock)

    @property
    def length(self) -> int:
        """Bytes of ``counts.csv``; 0 if it does not exist."""
        path = self._folder / COUNTS_CSV
        return path.stat().st_size if path.exists() else 0

    def drafts(self, tally: Tally, *, at_once: bool = False) -> list[Path]:
        """Write the files under temporary names, unless that took place a moment ago and no hour has ended.

        They are to be published before the state of the tally is, which this changes.

        Parameters
        ----------
        tally : Tally
        at_once : bool
            Whether to write them in any case.
        """
        closed = tally.take_closed()
        if not (closed or at_once or self._writing.is_due):
            return []
        with self._writing.spent():
            return self._written(tally, closed)

    def _written(self, tally: Tally, closed: Sequence[HourCounts]) -> list[Path]:
        path = self._folder / COUNTS_CSV
        certain = path.read_bytes()[: tally.state.closed_bytes] if path.exists() else b""
        certain = (certain or HEADER.encode()) + csv_rows(self._stream, closed).encode()
        tally.state.closed_bytes = len(certain)
        now = [] if tally.state.hour is None else [tally.state.hour]
        content = certain + csv_rows(self._stream, now).encode()
        temporary_path(path).write_bytes(content)
        table, summary = self._folder / COUNTS_PARQUET, self._folder / COUNTS_JSON
        pq.write_table(table_of(content), temporary_path(table))
        temporary_path(summary).write_text(_summary(self._stream, tally.state) + "\n", encoding="utf-8")
        return [path, table, summary]


def _summary(stream: str, state: CountState) -> str:
    heat = [state.heat.get(cell, 0) for cell in range(HEAT_COLUMNS * HEAT_ROWS)]
    return json.dumps(
        {
            "stream": stream,
            "objects": state.present.get(PICTURE, 0),
            "zones": {name: number for name, number in state.present.items() if name != PICTURE},
            "crossings": state.crossings,
            "events": state.events,
            "heat": {"columns": HEAT_COLUMNS, "rows": HEAT_ROWS, "label_maps": heat},
        }
    )
