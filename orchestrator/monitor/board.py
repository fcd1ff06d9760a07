"""Data of the monitor: the newest states of the streams, and the history of their layer counts."""

from __future__ import annotations

import threading
import time
from collections import defaultdict
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from orchestrator.run.stream_state import StreamState
from orchestrator.sinks.live_picture import live_picture_path

__all__ = ["Board"]

#: Points of a stream's history; when there are more, every second one is dropped, so that they span the run.
_POINTS = 240


class Board:
    """An observer of the driver that can be read from other threads.

    Parameters
    ----------
    pictures : Path
        Folder of the streams' newest pictures.
    clock : callable
        Monotonic time, s.
    """

    def __init__(self, pictures: Path, clock: Callable[[], float] = time.monotonic) -> None:
        self._pictures = pictures
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
            ``seconds`` since the start; ``streams``, in the order of the list: those of ``status.json`` and
            ``name``, ``rank`` (display order: :attr:`StreamState.rank`), ``picture`` (changes with the
            picture, null if there is none), ``layers_over_time`` (pairs of frames read and layers).
        """
        with self._lock:
            states, past = self._states, {name: list(points) for name, points in self._past.items()}
        return {
            "seconds": round(self._clock() - self._started, 1),
            "streams": [
                state.figures()
                | {
                    "rank": state.rank,
                    "picture": self._version(state.name),
                    "layers_over_time": past.get(state.name, []),
                }
                for state in states
            ],
        }

    def picture(self, number: int) -> bytes | None:
        """Return the newest picture (JPEG) of the stream at this index of the list; None if there is none."""
        try:
            return live_picture_path(self._pictures, self.states[number].name).read_bytes()
        except (IndexError, OSError):
            return None

    def _version(self, name: str) -> str | None:
        try:
            return str(live_picture_path(self._pictures, name).stat().st_mtime_ns)
        except OSError:
            return None
