"""``--keep``: deletes the oldest segments of cameras.

Of all cameras that share a limit the oldest closed segment goes first, so each camera takes what it needs and
all reach back about equally far; a camera with a limit of its own stands for itself. The lines of a segment
leave its stream's commit log before its files are deleted; files without lines, of a deletion that was
killed, are deleted by the next one.
"""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

from mlbs_actors.errors import SinkError
from mlbs_actors.record.commits import Commit, permanent, read_commits
from orchestrator.disk_use.measured import bytes_by_kind
from orchestrator.run.retention_limits import Keep
from orchestrator.run.stream_state import StreamState
from orchestrator.storage.commit_log import forget_segment
from orchestrator.storage.segments import segment_folders, segment_time
from orchestrator.storage.share_of_time import ShareOfTime
from orchestrator.storage.snapshot_folder import SNAPSHOTS

__all__ = ["Retention"]

#: Least time between two looks at the folder, s, and the share of the time that they may take.
_LOOK_SECONDS, _SHARE_OF_TIME = 5.0, 1 / 50

#: Share of the size that is left free for what is written until the next look, besides one more snapshot of
#: each stream, of which two are kept.
_FREE, _SNAPSHOTS_TO_COME = 0.02, 1 / 2


@dataclass(frozen=True, slots=True, order=True)
class _Closed:
    """A closed segment, and when it began and ended, seconds since 1970."""

    begin: float
    end: float
    folder: Path


@dataclass(slots=True)
class _Used:
    """What the cameras that share a limit take, and will take with their next snapshots, bytes."""

    size: int = 0
    to_come: int = 0
    closed: list[_Closed] = field(default_factory=list)

    def exceeds(self, keep: Keep) -> bool:
        return keep.size is not None and self.size + self.to_come > (1 - _FREE) * keep.size


class Retention:
    """Deletes the oldest segments of a run's cameras; an observer of the driver.

    Parameters
    ----------
    folder : Path
        Of the run.
    keeps : callable
        Returns what is kept of each camera that has a limit of its own, and for None of all others together.
    say : callable
        Takes a sentence for the user.
    clock : callable
        Seconds since 1970.
    """

    def __init__(
        self,
        folder: Path,
        keeps: Callable[[], Mapping[str | None, Keep]],
        say: Callable[[str], None],
        clock: Callable[[], float] = time.time,
    ) -> None:
        self._folder = folder
        self._keeps = keeps
        self._say = say
        self._clock = clock
        self._looking = ShareOfTime(_SHARE_OF_TIME, _LOOK_SECONDS)
        self._sizes: dict[Path, int] = {}  # of merged segments, bytes
        self._used: dict[str | None, _Used] = {}
        self._begins: dict[str, dict[str, Any]] = {}
        self._too_much: set[str | None] = set()

    def update(self, states: Sequence[StreamState]) -> None:
        """Look at the folder, unless that took place a moment ago."""
        if self._looking.is_due:
            # The disk may have gone, or a file was deleted under our feet.
            with self._looking.spent(), suppress(OSError):
                self.apply()

    @property
    def figures(self) -> dict[str, Any] | None:
        """What is kept, and with what streams begin of which something was deleted, for ``status.json``."""
        limits = self._keeps()
        if not limits:
            return None
        shared = limits.get(None, Keep())
        return {
            "seconds": shared.seconds,
            "bytes": shared.size,
            "bytes_in_use": sum(used.size for used in self._used.values()),
            "begins": self._begins,
        }

    def apply(self) -> None:
        """Delete what is too old, and then what is too much.

        What cannot be deleted now, as a commit is going on or the disk refuses it, is tried again.
        """
        limits = self._keeps()
        self._used = {owner: _Used() for owner in limits}
        if not limits:
            return
        for stream in sorted(path.parent for path in self._folder.glob("*/commits.jsonl")):
            used = self._used.get(stream.name, self._used.get(None))
            if used is None:
                continue  # nothing limits it
            commits = read_commits(stream)
            segments = list(dict.fromkeys(one.segment for one in commits if one.segment is not None))
            if segments:
                if commits[0].first:
                    self._begins[stream.name] = {"frame": commits[0].first, "segment": segments[0]}
                _remove_remains(stream, segments)
                used.closed += _closed_segments(stream, commits)
                self._measure(stream, {one.segment for one in commits if one.merged}, used)
        for owner, used in self._used.items():
            self._limit(owner, used, limits[owner])

    def _limit(self, owner: str | None, used: _Used, keep: Keep) -> None:
        for one in sorted(used.closed):
            too_old = keep.seconds is not None and one.end <= self._clock() - keep.seconds
            if too_old or used.exceeds(keep):
                size = self._sizes.pop(one.folder, None) or _size_of(one.folder)
                try:
                    if forget_segment(one.folder.parent, one.folder.name):
                        shutil.rmtree(one.folder)
                        used.size -= size
                except (OSError, SinkError):
                    break
        if used.exceeds(keep) and not used.closed and owner not in self._too_much:
            self._too_much.add(owner)
            whose = "The cameras take" if owner is None else f"{owner} takes"
            self._say(
                f"{whose} {used.size / 1e6:,.0f} MB, the next snapshots may take "
                f"{used.to_come / 1e6:,.0f} MB, and there is no closed segment to delete. That is more than "
                "--keep allows: give it room for some segments of each camera, or --segment a shorter time."
            )

    def _measure(self, stream: Path, merged: set[str | None], used: _Used) -> None:
        """Add the bytes of a stream's folder; merged segments do not change, and are measured once."""
        for path in stream.iterdir():
            if path.name in merged:
                if path not in self._sizes:
                    self._sizes[path] = _size_of(path)
                used.size += self._sizes[path]
                continue
            size = _size_of(path)
            used.size += size
            if path.name == SNAPSHOTS:
                used.to_come += round(size * _SNAPSHOTS_TO_COME)


def _closed_segments(stream: Path, commits: Sequence[Commit]) -> Iterator[_Closed]:
    """Yield the segments before the one that the stream would resume from."""
    names = list(dict.fromkeys(one.segment for one in permanent(commits) if one.segment is not None))
    for name, following in pairwise(names):
        yield _Closed(segment_time(name), segment_time(following), stream / name)


def _remove_remains(stream: Path, segments: Sequence[str]) -> None:
    """Delete the files of segments whose lines are gone: of a deletion that was killed."""
    for path in segment_folders(stream):
        if path.name < segments[0] and path.name not in segments:
            shutil.rmtree(path, ignore_errors=True)


def _size_of(path: Path) -> int:
    if path.is_dir():
        return bytes_by_kind(path).total()
    try:
        return path.stat().st_size
    except FileNotFoundError:
        return 0  # published or deleted just now
