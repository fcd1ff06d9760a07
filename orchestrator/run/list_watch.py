"""Reads the list of streams, or the file of cameras, again during the run (``--watch``)."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from mlbs_actors.errors import ConfigError, SourceError
from orchestrator.events.targets import EventTarget
from orchestrator.run.file_watch import FileWatch
from orchestrator.run.identity import other_source
from orchestrator.run.listed_stream import ListedStream, StreamsFile
from orchestrator.run.stream_list import parse_stream_list
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
    changed : tuple of ListedStream
        Names with another source, or with other settings.
    text : str, optional
        The new version of a file of cameras.
    targets : tuple of EventTarget, optional
        Where it has events sent, if that is other than before.
    """

    added: tuple[ListedStream, ...]
    removed: tuple[str, ...]
    changed: tuple[ListedStream, ...]
    text: str | None = None
    targets: tuple[EventTarget, ...] | None = None


class ListWatch:
    """Finds the changes of a list of streams.

    What cannot be used is reported and changes nothing, nor does a name end while there is such a line, as it
    may be a misspelled one; but for a name whose source is now listed under another one, which is renamed.

    Parameters
    ----------
    path : Path
    begun : StreamsFile
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
        begun: StreamsFile,
        recorded: Callable[[str], str | None],
        report: Callable[[str], None],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._path = path
        self._report = report
        self._recorded = recorded
        self._present = {stream.name: stream for stream in begun.streams}
        self._targets = begun.targets
        self._is_faulty = bool(begun.faults) or begun.targets is None
        self._file = FileWatch(path, begun.stamp, clock)

    def look(self) -> ListChange | None:
        """Check the list if it is time; return its changes, or None."""
        return self._read() if self._file.has_changed() else None

    def _read(self) -> ListChange | None:
        try:
            parsed = parse_stream_list(
                self._path, StreamsFile(tuple(self._present.values()), {}, None, self._targets)
            )
        except ConfigError as error:
            self._report(f"{str(error).rstrip('.')}. Nothing is changed.")
            self._is_faulty = True
            return None
        faults = dict(parsed.faults)
        usable = [stream for stream in parsed.streams if self._is_usable(stream, faults)]
        for number, fault in sorted(faults.items()):
            self._report(f"{self._path}, line {number}: {fault}. The line is ignored until it is mended.")
        if self._is_faulty and not faults:
            self._report(f"{self._path} can be used again, all of it.")
        self._is_faulty = bool(faults)
        listed = {stream.name for stream in parsed.streams}
        removed = [name for name in self._present if name not in listed]
        if faults:
            sources = {stream.source.location for stream in parsed.streams}
            renamed = {stream.was for stream in usable}
            removed = [
                name for name in removed if name in renamed or self._present[name].source.location in sources
            ]
        added = [stream for stream in usable if stream.name not in self._present]
        changed = [one for one in usable if one.name in self._present and not self._is_present(one)]
        self._present |= {stream.name: stream for stream in usable}
        for name in removed:
            del self._present[name]
        targets = None if parsed.targets == self._targets else parsed.targets
        self._targets = parsed.targets
        if not (added or removed or changed or targets is not None):
            return None
        return ListChange(tuple(added), tuple(removed), tuple(changed), parsed.text, targets)

    def _is_present(self, stream: ListedStream) -> bool:
        return stream.is_like(self._present[stream.name])

    def _is_usable(self, stream: ListedStream, faults: dict[int, str]) -> bool:
        """Whether a line can be used; else its fault is added."""
        assert stream.line is not None  # of the list
        if stream.name in self._present and self._is_present(stream):
            return True
        recorded = self._recorded(stream.name)
        if recorded is not None and (fault := other_source(stream, recorded)) is not None:
            faults[stream.line] = fault
            return False
        try:
            require_source(stream.source)
        except SourceError as error:
            faults[stream.line] = str(error).rstrip(".")
            return False
        return True
