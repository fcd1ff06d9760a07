"""Keeps ``objects.csv`` and ``objects.json`` of a stream up to date while its record grows."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from pathlib import Path

from pydantic import TypeAdapter, ValidationError

from mlbs_actors.record.commits import read_commits
from mlbs_actors.record.frame_row import FrameRow
from mlbs_actors.record.record_tables import read_rows
from orchestrator.sinks.object_list import ListState, ObjectList
from orchestrator.storage.durable_files import publish, temporary_path
from orchestrator.storage.share_of_time import ShareOfTime

__all__ = ["OBJECTS_CSV", "OBJECTS_JSON", "ObjectFiles"]

OBJECTS_CSV, OBJECTS_JSON = "objects.csv", "objects.json"

#: What the list is continued from: reading the tables of a camera's week again would take minutes.
_STATE = ".objects"

#: The most that writing may take. A camera's files grow for weeks, and they are always written whole.
_SHARE_OF_TIME = 1 / 50

_STATES = TypeAdapter(ListState)


class ObjectFiles:
    """The two files of one stream.

    Parameters
    ----------
    folder : Path
        Of the stream, which may have committed rows already.
    stream : str
        Its name.
    clock : callable
        Monotonic time, s.
    """

    def __init__(self, folder: Path, stream: str, clock: Callable[[], float] = time.monotonic) -> None:
        self._folder = folder
        self._stream = stream
        self._objects = _continued(folder)
        self._provisional = False
        self._writing = ShareOfTime(_SHARE_OF_TIME, clock=clock)

    def add(self, rows: Iterable[FrameRow], *, provisional: bool) -> None:
        """Add committed rows; write the files unless that took place a moment ago.

        Parameters
        ----------
        rows : iterable of FrameRow
        provisional : bool
            Whether a record that is opened again does not have them any more.
        """
        self._objects.add(rows)
        self._provisional |= provisional
        if self._writing.is_due:
            self.write(complete=False)

    def forget_before(self, frame: int) -> None:
        """Leave out what was seen only before a frame whose predecessors are deleted."""
        self._objects.forget_before(frame)

    def write(self, *, complete: bool) -> None:
        """Write the files; ``complete`` if the stream came to its end."""
        with self._writing.spent():
            self._write(complete=complete)

    def _write(self, *, complete: bool) -> None:
        contents = {
            OBJECTS_CSV: self._objects.csv(complete=complete),
            OBJECTS_JSON: self._objects.json(self._stream, complete=complete),
        }
        if not complete and not self._provisional:
            contents[_STATE] = _STATES.dump_json(self._objects.state).decode()
        paths = [self._folder / name for name in contents]
        for path in paths:
            temporary_path(path).write_text(contents[path.name], encoding="utf-8")
        publish(paths)
        if complete:
            (self._folder / _STATE).unlink(missing_ok=True)


def _continued(folder: Path) -> ObjectList:
    """Return the list of all committed rows: those since the last state, if it can be read, and that."""
    commits = read_commits(folder)
    try:
        state = _STATES.validate_json((folder / _STATE).read_bytes())
    except (FileNotFoundError, ValidationError):
        state = ListState.begun()
    if not commits or state.rows > commits[-1].last + 1:
        state = ListState.begun()  # it is of another record
    shown = None
    for commit in reversed([commit for commit in commits if commit.first < state.rows]):
        rows = read_rows(folder, commit.first, min(commit.last + 1, state.rows))
        results = [row.result for row in rows if row.result is not None]
        if results:
            shown = results[-1]
            break
    return ObjectList(state, shown).add(read_rows(folder, state.rows))
