"""Takes what is new in the streams' files into the outbox."""

from __future__ import annotations

import json
import os
import sqlite3
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

from orchestrator.events.census import Census
from orchestrator.events.event_file import EVENTS
from orchestrator.events.event_marks import committed_events
from orchestrator.events.outbox import Outbox

__all__ = ["Intake", "lines_behind"]

#: How much of a file's end is looked at first, bytes.
_BLOCK = 1 << 16


class Intake:
    """Looks for new events in the folders of a run's streams.

    Parameters
    ----------
    folder : Path
        Of the run.
    outbox : Outbox
    say : callable
        Receives a sentence when events cannot be taken.

    Attributes
    ----------
    censuses : dict of str to Census
        What the events of each stream come to.
    """

    def __init__(self, folder: Path, outbox: Outbox, say: Callable[[str], None]) -> None:
        self._folder = folder
        self._outbox = outbox
        self._say = say
        self._seen: dict[str, tuple[int, ...]] = {}
        self._oldest: dict[str, int] = {}
        self._faulty: set[Path] = set()
        self.censuses: dict[str, Census] = {}

    def look(self) -> bool:
        """Take what has come since the last time; return whether there was anything."""
        try:
            paths = sorted(self._folder.glob(f"*/{EVENTS}"))
        except OSError as error:
            self._complain(self._folder, "all streams", error)
            return False
        self._faulty.discard(self._folder)
        found = False
        for path in paths:
            try:
                found |= self._look_into(path)
            except (OSError, sqlite3.Error) as error:
                self._complain(path, path.parent.name, error)
            except (ValueError, KeyError, TypeError):
                continue  # lines that are just replaced cannot be read for a moment
        return found

    def _look_into(self, path: Path) -> bool:
        # A commit can make lines final, and leaves its trace in the folder alone.
        file, folder, stream = path.stat(), path.parent.stat(), path.parent.name
        seen = file.st_ino, file.st_size, file.st_mtime_ns, folder.st_mtime_ns
        if self._seen.get(stream) == seen:
            return False
        final = committed_events(path.parent)
        self._drop_deleted(path, stream)
        self.censuses[stream] = self._outbox.take(stream, partial(lines_behind, path), final)
        self._seen[stream] = seen
        self._faulty.discard(path)
        return True

    def _drop_deleted(self, path: Path, stream: str) -> None:
        """Let go what waits of the lines that have been deleted at the file's begin."""
        with path.open("rb") as file:
            line = file.readline()
        oldest = json.loads(line)["number"] if line.endswith(b"\n") else 1
        if oldest > self._oldest.get(stream, 1):
            self._outbox.drop_before(stream, oldest)
            self._oldest[stream] = oldest

    def _complain(self, path: Path, whose: str, error: Exception) -> None:
        if path not in self._faulty:
            self._faulty.add(path)
            reason = str(getattr(error, "strerror", None) or error).rstrip(".")
            self._say(f"Events of {whose} wait: {reason} ({path}). It is tried again.")


def lines_behind(path: Path, number: int) -> Iterator[bytes]:
    """Yield the whole lines of a file of events behind a number, after some of before.

    It is looked for from the end, as the file may be long.
    """
    with path.open("rb") as file:
        end, size = file.seek(0, os.SEEK_END), _BLOCK
        while size < end:
            file.seek(end - size)
            file.readline()  # the rest of one
            begin = file.tell()
            line = file.readline()
            if line.endswith(b"\n") and json.loads(line)["number"] <= number:
                file.seek(begin)
                break
            size *= 2
        else:
            file.seek(0)
        for line in file:
            if line.endswith(b"\n"):  # the others are being written
                yield line
