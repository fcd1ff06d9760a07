"""The files of a whole run: its description (``run.json``), its progress (``status.json``), its report."""

from __future__ import annotations

import hashlib
import json
import os
import platform
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import fields
from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from mlbs_actors.config import Config
from mlbs_actors.errors import ConfigError
from mlbs_actors.record.recorded_stream import read_description
from orchestrator.command_options import flag_of
from orchestrator.credentials import mask
from orchestrator.events.delivery import Backlog
from orchestrator.option import Effect
from orchestrator.options import options
from orchestrator.run.identity import goes_on, is_camera
from orchestrator.run.listed_stream import ListedStream
from orchestrator.run.stream_settings import words_of_changes
from orchestrator.run.stream_state import ENDED, StreamState, has_ended
from orchestrator.run.versions import installed_versions
from orchestrator.sinks.record import recorded_frames
from orchestrator.storage.durable_files import replace_file

__all__ = ["RunFolder", "StatusFile", "describe_run"]

#: Keys of ``run.json`` that must not change while there is a file that has not come to its end.
_SAME = {"config": "parameters"} | {
    name: flag_of(name)
    for name, option in options()
    if option.record is not None and option.effect is not Effect.AT_ONCE
}

#: Those that must never change.
_FIXED = {
    name: flag_of(name) for name, option in options() if option.effect is Effect.FIXED and option.record
}

#: Keys that stay as they were when a run was begun.
_LASTING = ("started", "versions", "machine")

#: Least time between two writings of ``status.json``, s.
_STATUS_SECONDS = 0.5

#: A run that has not written it for so long is dead, s.
_ALIVE_SECONDS = 30.0


class RunFolder:
    """The output folder of one run.

    Parameters
    ----------
    path : Path
        May exist, but must not hold a run, nor a folder of one of the streams.
    """

    def __init__(self, path: Path) -> None:
        self.path = path

    def stream(self, name: str) -> Path:
        """Folder of one stream's record."""
        return self.path / name

    def refuse_if_used(self, names: Sequence[str]) -> None:
        """Check that a run can begin here, without leaving a trace if not.

        Raises
        ------
        ConfigError
            If the folder holds a run or part of one, is no folder, or cannot be written to.
        """
        if self.holds_run:
            raise ConfigError(
                f"The output folder {self.path} holds a run already; "
                "choose another one with --output, or continue that run with --resume."
            )
        existing = next((name for name in names if os.path.lexists(self.path / name)), None)
        if existing is not None:
            raise ConfigError(
                f"The output folder {self.path} holds {existing!r} already, where the stream of that name "
                "would be recorded; choose another folder with --output."
            )
        nearest = next(parent for parent in (self.path, *self.path.absolute().parents) if parent.exists())
        if not nearest.is_dir():
            raise ConfigError(f"{nearest} is not a folder; choose another one with --output.")
        if not os.access(nearest, os.W_OK | os.X_OK):
            raise ConfigError(f"The folder {nearest} cannot be written to; choose another one with --output.")

    @property
    def holds_run(self) -> bool:
        """Whether a run has begun here."""
        return os.path.lexists(self.path / "run.json")

    def description(self) -> dict[str, Any]:
        """Read ``run.json``; raises ConfigError."""
        begun = read_description(self.path)
        if begun is None:
            raise ConfigError(
                f"{self.path / 'run.json'} cannot be read; begin anew in another folder with --output."
            )
        return begun

    def recorded_sources(self, begun: Mapping[str, Any]) -> dict[str, str]:
        """Return the sources of the streams of ``run.json`` that have a record, by name."""
        sources: dict[str, str] = begun.get("sources", {})
        return {name: source for name, source in sources.items() if recorded_frames(self.stream(name))}

    def refuse_other(self, begun: Mapping[str, Any], description: Mapping[str, Any]) -> None:
        """Check that the run that has begun in this folder is the one described now.

        A stream without a record may have another source now, or be new or gone, so that wrong lines can be
        corrected. A camera may be at another address, and goes on with other settings.

        Raises
        ------
        ConfigError
            If it is one of something else.
        """
        advice = "give the same ones as then (see its run.json), or another folder with --output."
        recorded, sources = self.recorded_sources(begun), description["sources"]
        if not all(name in sources and goes_on(source, sources[name]) for name, source in recorded.items()):
            raise ConfigError(f"The run in {self.path} had other streams; {advice}")
        states = self.states()
        files = [name for name, source in recorded.items() if not is_camera(source)]
        going_on = [name for name in files if name not in states or not has_ended(states[name])]
        for key, meaning in _SAME.items() if going_on else _FIXED.items():
            if begun.get(key) != description[key]:
                changes = words_of_changes(begun.get(key), description[key])
                raise ConfigError(f"The run in {self.path} had other {meaning} ({changes}); {advice}")

    def states(self) -> dict[str, StreamState]:
        """Read the streams of ``status.json``; none if it cannot be read."""
        try:
            streams = json.loads((self.path / "status.json").read_text(encoding="utf-8"))["streams"]
            return {name: _state(name, figures) for name, figures in streams.items()}
        except (OSError, ValueError, KeyError, TypeError):
            return {}

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Keep other runs out while the ``with`` block runs; the lock of a killed run is released.

        Raises
        ------
        ConfigError
            If another run is at work here.
        """
        lock = FileLock(self.path / ".lock")
        try:
            lock.acquire(timeout=0)
        except Timeout:
            raise ConfigError(
                f"Another run is at work in {self.path}; wait for its end, or choose another folder with "
                "--output."
            ) from None
        except OSError as error:
            raise ConfigError(f"Cannot write to {self.path}: {error.strerror}.") from None
        try:
            yield
        finally:
            lock.release()

    def create(self, description: dict[str, Any]) -> None:
        """Claim the folder by writing ``run.json`` atomically; of two runs one succeeds.

        Raises
        ------
        ConfigError
            If another run was faster, or the folder cannot be written.
        """
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            with tempfile.NamedTemporaryFile(
                "w", dir=self.path, prefix=".run.json.", encoding="utf-8"
            ) as draft:
                json.dump(description, draft, indent=2)
                draft.write("\n")
                draft.flush()
                os.fsync(draft.fileno())
                Path(draft.name).chmod(0o644)
                # A link fails if the name is taken; a rename would replace the other run's file.
                os.link(draft.name, self.path / "run.json")
        except FileExistsError:
            raise ConfigError(
                f"Another run has begun in {self.path}; choose another folder with --output."
            ) from None
        except OSError as error:
            raise ConfigError(f"Cannot write to {self.path}: {error.strerror}.") from None

    def redescribe(self, description: dict[str, Any]) -> None:
        """Replace ``run.json`` by the new description; OSError if it cannot be written."""
        replace_file(self.path / "run.json", (json.dumps(description, indent=2) + "\n").encode())


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


def describe_run(
    streams: Sequence[ListedStream],
    config: Config,
    asked: Mapping[str, object],
    command: Sequence[str] = (),
    before: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Return the content of ``run.json``: everything that the results depend on, without credentials.

    Parameters
    ----------
    streams : sequence of ListedStream
    config : Config
    asked : mapping of str to object
        The options of the command, from :func:`orchestrator.options.recorded`.
    command : sequence of str
        Starts the same run.
    before : mapping, optional
        The content before, whose sources stay, as those of streams that are not listed any more are needed to
        export their results; and with it what is said of the run's beginning.
    """
    parameters = config.model_dump(mode="json")
    earlier = {} if before is None else dict(before)
    sources = {**earlier.get("sources", {}), **{stream.name: str(stream.source) for stream in streams}}
    description = {
        "started": _now(),
        "config": parameters,
        "sources": sources,
        "settings": earlier.get("settings", {}),
        **asked,
        "command": [mask(word) for word in command],
        "hashes": {"config": _digest(parameters), "sources": _digest(sources)},
        "versions": installed_versions(),
        "machine": {"cpu": _cpu(), "system": platform.platform()},
    }
    return description | {key: earlier[key] for key in _LASTING if key in earlier}


def _state(name: str, figures: dict[str, Any]) -> StreamState:
    """Rebuild a state from its figures, without the derived ones."""
    own = {field.name for field in fields(StreamState)}
    return StreamState(name, **{key: value for key, value in figures.items() if key in own})


def _digest(value: object) -> str:
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()


def _cpu() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return platform.machine()
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return mask(next(names, platform.machine()))


def _now() -> str:
    return _iso(datetime.now(timezone.utc))


def _iso(time: datetime) -> str:
    return time.isoformat(timespec="milliseconds")
