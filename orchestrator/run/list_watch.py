"""Reads the list of streams again during the run (``--watch``)."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from mlbs_actors.errors import ConfigError, SourceError
from orchestrator.run.file_watch import FileWatch
from orchestrator.run.stream_list import ListedStream, parse_stream_list
from orchestrator.sources.presence import require_source

__all__ = ["ListChange", "ListWatch"]


@dataclass(frozen=True, slots=True)
class ListChange:
    """Changes to the list since it was last read.

    Attributes
    ----------
    added : tuple of ListedStream
        New names with a source, in the order of the list.
    removed : tuple of str
        Names that are gone.
    """

    added: tuple[ListedStream, ...]
    removed: tuple[str, ...]


class ListWatch:
    """Finds the changes of a list of streams.

    A line that cannot be used is reported and changes nothing, nor does any name end while there is such a
    line: it may be a misspelled one. A name that has results stands for their source throughout the run; one
    that is gone may come back with it.

    Parameters
    ----------
    path : Path
    streams : sequence of ListedStream
        What the run began with.
    recorded : callable
        Returns for a name the source, without credentials, of which the run has results; None without any.
    report : callable
        Receives each message for the user.
    clock : callable
        Monotonic time, s.
    """

    def __init__(
        self,
        path: Path,
        streams: Sequence[ListedStream],
        recorded: Callable[[str], str | None],
        report: Callable[[str], None],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._path = path
        self._report = report
        self._recorded = recorded
        self._present = {stream.name: stream.source for stream in streams}
        self._file = FileWatch(path, clock)

    def look(self) -> ListChange | None:
        """Check the list if it is time; return its changes, or None."""
        return self._read() if self._file.has_changed() else None

    def _read(self) -> ListChange | None:
        try:
            streams, faults = parse_stream_list(self._path)
        except ConfigError as error:
            self._report(f"{error} Nothing is changed.")
            return None
        usable = [stream for stream in streams if self._is_usable(stream, faults)]
        for number, fault in sorted(faults.items()):
            self._report(f"{self._path}, line {number}: {fault}. The line is ignored until it is mended.")
        listed = {stream.name for stream in streams}
        removed = () if faults else tuple(name for name in self._present if name not in listed)
        added = tuple(stream for stream in usable if stream.name not in self._present)
        self._present |= {stream.name: stream.source for stream in added}
        for name in removed:
            del self._present[name]
        return ListChange(added, removed) if added or removed else None

    def _is_usable(self, stream: ListedStream, faults: dict[int, str]) -> bool:
        """Whether a line can be used; else its fault is added."""
        assert stream.line is not None  # of the list
        present, recorded = self._present.get(stream.name), self._recorded(stream.name)
        if present == stream.source:
            return True
        if present is not None or recorded not in (None, str(stream.source)):
            faults[stream.line] = (
                f"the name {stream.name!r} stands for another source in this run; choose another one"
            )
            return False
        try:
            require_source(stream.source)
        except SourceError as error:
            faults[stream.line] = str(error).rstrip(".")
            return False
        return True
