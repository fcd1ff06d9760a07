"""Data of the monitor: the newest states of the streams, and the history of their layer counts."""

from __future__ import annotations

import threading
import time
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from orchestrator.counts.stream_counts import CountReader, StreamCounts, recent_hours
from orchestrator.events.delivery import Backlog
from orchestrator.events.recent import RecentEvents
from orchestrator.monitor.recorded_files import RecordedFile, recorded_file
from orchestrator.run.stream_state import ENDED, StreamState
from orchestrator.sinks.live_picture import live_picture_path, watch
from orchestrator.sinks.still import STILL, ask_for_still

__all__ = ["Board"]

#: Points of a stream's history; when there are more, every second one is dropped, so that they span the run.
_POINTS = 240

#: Newest rows of a stream's counts that are shown: a day of some zones.
_COUNT_ROWS = 24 * 12

#: Newest events of a stream that are shown.
_EVENTS = 10


class Board:
    """An observer of the driver that can be read from other threads.

    Parameters
    ----------
    pictures : Path
        Folder of the streams' newest pictures.
    folder : Path
        Of the run.
    backlogs : callable
        Returns what the targets of events have not acknowledged.
    clock : callable
        Monotonic time, s.
    """

    def __init__(
        self,
        pictures: Path,
        folder: Path,
        backlogs: Callable[[], Sequence[Backlog]] = list,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.backlogs = backlogs
        self._pictures = pictures
        self._folder = folder
        self._events = RecentEvents(_EVENTS)
        self._counts = CountReader(folder)
        self._clock = clock
        self._started = clock()
        self._lock = threading.Lock()
        self._states: tuple[StreamState, ...] = ()
        self._past: defaultdict[str, list[tuple[int, int]]] = defaultdict(list)

    def update(self, states: Sequence[StreamState]) -> None:
        """Take the states of all streams."""
        with self._lock:
            self._states = tuple(states)
            for state in states:
                past = self._past[state.name]
                if state.layers and (not past or past[-1][0] != state.read):
                    past.append((state.read, state.layers))
                    if len(past) > _POINTS:
                        del past[1::2]

    @property
    def states(self) -> tuple[StreamState, ...]:
        """The newest states, in the order of the list."""
        with self._lock:
            return self._states

    def status(self) -> dict[str, Any]:
        """Return everything that the page shows, in JSON types.

        Returns
        -------
        dict
            ``seconds`` since the start; ``events``, as in ``status.json``; ``streams``, in the order of the
            list: those of ``status.json`` and ``name``, ``rank`` (display order: :attr:`StreamState.rank`),
            ``picture`` and ``counts`` (change with the picture and the counts, null if there are none),
            ``layers_over_time`` (pairs of frames read and layers), ``events`` (the newest ones, the last one
            last).
        """
        with self._lock:
            states, past = self._states, {name: list(points) for name, points in self._past.items()}
        return {
            "seconds": round(self._clock() - self._started, 1),
            "events": [backlog.figures() for backlog in self.backlogs()],
            "streams": [
                state.figures()
                | {
                    "rank": state.rank,
                    "picture": self.version(state.name),
                    "counts": self._counts.version(state.name),
                    "events": self._events.of(self._folder / state.name),
                    "layers_over_time": past.get(state.name, []),
                }
                for state in states
            ],
        }

    def picture(self, number: int) -> bytes | None:
        """Return the newest picture (JPEG) of the stream at this index of the list; None if there is none."""
        states = self.states
        return self.picture_of(states[number].name) if number < len(states) else None

    def picture_of(self, name: str) -> bytes | None:
        """Return the newest picture (JPEG) of a stream; None if there is none."""
        try:
            return live_picture_path(self._pictures, name).read_bytes()
        except OSError:
            return None

    def stream_in(self, path: str, begin: str, end: str) -> str | None:
        """Return the stream whose name is between these in the path of a request; None if there is none."""
        name = unquote(path).removeprefix(begin).removesuffix(end)
        known = any(state.name == name for state in self.states)
        return name if known and unquote(path) == f"{begin}{name}{end}" else None

    def recorded(self, path: str) -> RecordedFile | None:
        """Return the file of a stream's record that the path of a request names; None if it names none.

        A still that is asked for is soon a newer one.
        """
        if (name := self.stream_in(path, "/stills/", ".jpg")) is not None:
            ask_for_still(self._folder / name)
            return RecordedFile(self.still_of(name), "image/jpeg")
        return recorded_file(self._folder, frozenset(state.name for state in self.states), path)

    def counts(self) -> dict[str, StreamCounts]:
        """Return what was counted, by stream, of those that have counts."""
        names = [state.name for state in self.states]
        return {name: self._counts.of(name) for name in names if self._counts.version(name) is not None}

    def counts_of(self, name: str) -> dict[str, Any]:
        """Return what the page shows of a stream's counts: the rows of the last hours, and the heat map."""
        rows = recent_hours(self._folder / name, _COUNT_ROWS)
        return {"hours": rows, "heat": asdict(self._counts.of(name).heat)}

    def still_of(self, name: str) -> Path:
        """Return where the newest frame of a stream is, as it came; it may not be there."""
        return self._folder / name / STILL

    def watch(self, name: str) -> None:
        """Ask for more pictures of a stream for a while."""
        watch(live_picture_path(self._pictures, name))

    def has_ended(self, name: str) -> bool:
        """Whether a stream has ended, or does not exist."""
        return all(state.state in ENDED for state in self.states if state.name == name)

    def version(self, name: str) -> str | None:
        """Return what changes with a stream's newest picture, None without one."""
        try:
            return str(live_picture_path(self._pictures, name).stat().st_mtime_ns)
        except OSError:
            return None
