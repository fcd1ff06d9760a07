"""The output folder of a run: claimed once, locked while it is at work, gone on with only as it was begun."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from mlbs_actors.errors import ConfigError
from mlbs_actors.record.recorded_stream import read_description
from orchestrator.command_options import flag_of
from orchestrator.option import Effect
from orchestrator.options import options
from orchestrator.run.identity import goes_on, is_camera
from orchestrator.run.status_file import recorded_states
from orchestrator.run.stream_settings import words_of_changes
from orchestrator.run.stream_state import StreamState, has_ended
from orchestrator.sinks.record import recorded_frames
from orchestrator.storage.durable_files import replace_file

__all__ = ["RunFolder"]

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


class RunFolder:
    """The output folder of one run.

    Parameters
    ----------
    path : Path
        May exist, but must not hold a run, nor a folder of one of the streams.
    given_as : str
        What names it, for messages.
    """

    def __init__(self, path: Path, given_as: str = "--output") -> None:
        self.path = path
        self._given_as = given_as

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
            going_on = ", or continue that run with --resume" if self._given_as == "--output" else ""
            raise ConfigError(
                f"The output folder {self.path} holds a run already; choose another one with "
                f"{self._given_as}{going_on}."
            )
        existing = next((name for name in names if os.path.lexists(self.path / name)), None)
        if existing is not None:
            raise ConfigError(
                f"The output folder {self.path} holds {existing!r} already, where the stream of that name "
                f"would be recorded; choose another folder with {self._given_as}."
            )
        nearest = next(parent for parent in (self.path, *self.path.absolute().parents) if parent.exists())
        if not nearest.is_dir():
            raise ConfigError(f"{nearest} is not a folder; choose another one with {self._given_as}.")
        if not os.access(nearest, os.W_OK | os.X_OK):
            raise ConfigError(
                f"The folder {nearest} cannot be written to; choose another one with {self._given_as}."
            )

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
        """Return the states of the streams, by name; none if they cannot be read."""
        return recorded_states(self.path)

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
                f"{self._given_as}."
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
                f"Another run has begun in {self.path}; choose another folder with {self._given_as}."
            ) from None
        except OSError as error:
            raise ConfigError(f"Cannot write to {self.path}: {error.strerror}.") from None

    def withdraw(self) -> None:
        """Release the folder again, of a run that could not begin."""
        (self.path / "run.json").unlink(missing_ok=True)

    def redescribe(self, description: dict[str, Any]) -> None:
        """Replace ``run.json`` by the new description; OSError if it cannot be written."""
        replace_file(self.path / "run.json", (json.dumps(description, indent=2) + "\n").encode())
