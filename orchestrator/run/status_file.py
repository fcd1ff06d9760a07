"""``status.json``: how each stream of a run stands."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import Any

from orchestrator.events.delivery import Backlog
from orchestrator.run.stream_state import ENDED, StreamState
from orchestrator.storage.durable_files import replace_file

__all__ = ["STATUS", "StatusFile", "recorded_states"]

#: Name of the file, in the run's folder.
STATUS = "status.json"

#: Least time between two writings, s.
_STATUS_SECONDS = 0.5

#: A run that has not written it for so long is dead, s.
_ALIVE_SECONDS = 30.0


class StatusFile:
    """Keeps ``status.json`` up to date; an observer of the driver.

    Parameters
    ----------
    path : Path
    clock : callable
        Monotonic time, s.
    kept : callable, optional
        Returns what :class:`orchestrator.run.retention.Retention` has done; None if all is kept.
    backlogs : callable, optional
        Returns what the targets of events have not acknowledged.
    published : callable, optional
        Returns how far the object store is; None without one.

    Attributes
    ----------
    stopping : callable
        Whether the run has been told to end. That is written at once, as the run may be killed while it
        finishes what was read.
    """

    def __init__(
        self,
        path: Path,
        clock: Callable[[], float] = time.monotonic,
        kept: Callable[[], Mapping[str, Any] | None] = lambda: None,
        backlogs: Callable[[], Sequence[Backlog]] = list,
        published: Callable[[], Mapping[str, Any] | None] = lambda: None,
    ) -> None:
        self.stopping: Callable[[], bool] = lambda: False
        self._path = path
        self._kept = kept
        self._backlogs = backlogs
        self._published = published
        self._clock = clock
        self._written_at: float | None = None
        self._written_as_stopping = False

    def update(self, states: Sequence[StreamState]) -> None:
        """Write the states, not more often than twice a second.

        A full or lost disk does not end the run here: the streams' own records report it.
        """
        now = self._clock()
        is_early = self._written_at is not None and now - self._written_at < _STATUS_SECONDS
        if is_early and self.stopping() == self._written_as_stopping:
            return
        self._written_at = now
        try:
            self._write(states, None)
        except OSError:
            return

    def finish(self, states: Sequence[StreamState], exit_status: int) -> None:
        """Write the final states; OSError if they cannot be written."""
        self._write(states, exit_status)

    def _write(self, states: Sequence[StreamState], exit_status: int | None) -> None:
        streams = {}
        for state in states:
            figures = state.figures()
            streams[figures.pop("name")] = figures
        now, over = datetime.now(timezone.utc), exit_status is not None
        self._written_as_stopping = self.stopping()
        status = {
            "updated": _iso(now),
            "alive_until": None if over else _iso(now + timedelta(seconds=_ALIVE_SECONDS)),
            "ended": over or self._written_as_stopping,
            "exit_status": exit_status,
            "waiting": sum(state.state == "waiting" for state in states),
            "running": sum(state.state != "waiting" and state.state not in ENDED for state in states),
            "kept": self._kept(),
            "events": [backlog.figures() for backlog in self._backlogs()],
            "streams": streams,
        }
        if (published := self._published()) is not None:
            status["published"] = published
        replace_file(self._path, (json.dumps(status, indent=1) + "\n").encode())


def recorded_states(folder: Path) -> dict[str, StreamState]:
    """Read the streams' states in the folder of a run, by name; none if they cannot be read."""
    try:
        streams = json.loads((folder / STATUS).read_text(encoding="utf-8"))["streams"]
        return {name: _state(name, figures) for name, figures in streams.items()}
    except (OSError, ValueError, KeyError, TypeError):
        return {}


def _state(name: str, figures: dict[str, Any]) -> StreamState:
    """Rebuild a state from its figures, without the derived ones."""
    own = {field.name for field in fields(StreamState)}
    return StreamState(name, **{key: value for key, value in figures.items() if key in own})


def _iso(time: datetime) -> str:
    return time.isoformat(timespec="milliseconds")
