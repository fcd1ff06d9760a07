"""The record of a camera in segments: a folder for each hour or day, so that the oldest can be deleted.

``20261127T140000Z/`` holds what a record of a file has in the stream's folder, but each kind of pictures is
one archive, and the tables of a closed segment are one part each. It is named by the time at which its hour
began, UTC. A segment begins with a commit, so it may hold some seconds of the one before.
"""

from __future__ import annotations

import re
import shutil
from collections import deque
from collections.abc import Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path

from mlbs_actors.record.commits import Commit, permanent, read_commits
from mlbs_actors.record.record_tables import TABLES, part_path
from orchestrator.storage.commit_log import CommitLog
from orchestrator.storage.durable_files import publish, remove_temporary
from orchestrator.storage.merged_tables import merge_parts
from orchestrator.storage.picture_archive import (
    ArchivedPicture,
    append_pictures,
    archived_pictures,
    cut_archive,
    end_archive,
)

__all__ = ["Segments", "archive_path", "archived_masks", "segment_folders", "segment_time"]

_TIME = "%Y%m%dT%H%M%SZ"
_NAME = re.compile(r"(\d{8}T\d{6}Z)(-\d+)?")  # a number after it if the clock was set back


def segment_time(name: str) -> float:
    """Return when a segment began, seconds since 1970."""
    found = _NAME.fullmatch(name)
    assert found is not None  # a name in a commit log
    return datetime.strptime(found[1], _TIME).replace(tzinfo=timezone.utc).timestamp()


def segment_folders(folder: Path) -> list[Path]:
    """List the folders of a stream's segments, whether they count or not."""
    return sorted(path for path in folder.iterdir() if _NAME.fullmatch(path.name) and path.is_dir())


def archive_path(segment: Path, part: str) -> Path:
    """Return the path of the archive of a part of ``--save``."""
    return segment / f"{part}.tar"


def archived_masks(folder: Path) -> dict[str, ArchivedPicture]:
    """Return the committed masks in the segments of a stream, by their frames' names."""
    lengths = {one.segment: one.archived.get("masks", 0) for one in read_commits(folder) if one.segment}
    return {
        Path(picture.name).stem: picture
        for segment, length in lengths.items()
        for picture in archived_pictures(archive_path(folder / segment, "masks"), length)
    }


@dataclass(frozen=True, slots=True)
class _Picture:
    frame: int
    part: str
    name: str
    content: bytes
    time: int


class Segments:
    """The segments of one stream's record; made and used only while other processes are kept out.

    Parameters
    ----------
    folder : Path
        Of the stream.
    seconds : int
        Length of a segment.

    Attributes
    ----------
    name : str or None
        Of the open segment; None before the first row.
    """

    def __init__(self, folder: Path, seconds: int) -> None:
        self._folder = folder
        self._seconds = seconds
        self._pictures: list[_Picture] = []
        commits = permanent(read_commits(folder))
        newest = commits[-1] if commits else None
        self.name = None if newest is None else newest.segment
        self._lengths = {} if newest is None else dict(newest.archived)
        closed = (one.segment for one in commits if one.segment not in (None, self.name) and not one.merged)
        self._unmerged = deque(dict.fromkeys(closed))
        self._merging: tuple[str, Future[list[Path]]] | None = None
        self._clear_up(commits)

    @property
    def folder(self) -> Path:
        """Folder of the open segment."""
        assert self.name is not None
        return self._folder / self.name

    def advance(self, time: float) -> bool:
        """Begin the segment of a time, seconds since 1970, unless that is open; return whether it began.

        What is jitter of the camera's clock begins none.
        """
        period = int(time // self._seconds)
        if self.name is not None:
            open_period = int(segment_time(self.name) // self._seconds)
            if open_period - 1 <= period <= open_period:
                return False
            self._unmerged.append(self.name)
        began = datetime.fromtimestamp(period * self._seconds, timezone.utc).strftime(_TIME)
        names = (began, *(f"{began}-{number}" for number in range(2, 1000)))
        self.name = next(name for name in names if not (self._folder / name).exists())
        self._lengths = {}
        self.folder.mkdir()
        return True

    def put(self, frame: int, part: str, name: str, content: bytes, time: float) -> None:
        """Add a picture of a frame, taken at a time; it is written once that frame is committed."""
        self._pictures.append(_Picture(frame, part, name, content, int(time)))

    def begin(self, frame: str) -> None:
        """Begin a frame: archives have nothing of it from before the run was resumed."""

    def drafts(self, before: float) -> list[Path]:
        """Return no files to publish: pictures are in archives."""
        return []

    def append(self, before: float) -> dict[str, int]:
        """Append the pictures of the frames before a number; return the lengths that are to be committed."""
        due = [one for one in self._pictures if one.frame < before]
        lengths = dict(self._lengths)
        for part in dict.fromkeys(one.part for one in due):
            pictures = ((one.name, one.content, one.time) for one in due if one.part == part)
            path = archive_path(self.folder, part)
            lengths[part] = append_pictures(path, lengths.get(part, 0), pictures)
        return lengths

    def committed(self, before: float, archived: Mapping[str, int]) -> None:
        """Note that the pictures of the frames before a number count, and how long the archives are."""
        self._pictures = [one for one in self._pictures if one.frame >= before]
        self._lengths = dict(archived)

    def discard(self) -> None:
        """Forget what was not committed."""
        self._pictures = []

    def merge(self, log: CommitLog) -> None:
        """Merge the tables of the closed segments, one after the other, beside the work on the frames."""
        if self._merging is not None and self._merging[1].done():
            segment, outcome = self._merging
            self._merging = None
            self._finish(log, segment, outcome)
        if self._merging is None and self._unmerged:
            segment = self._unmerged.popleft()
            commits = [commit for commit in read_commits(self._folder) if commit.segment == segment]
            thread = ThreadPoolExecutor(1)
            self._merging = segment, thread.submit(merge_parts, self._folder, commits)
            thread.shutdown(wait=False)

    def merge_all(self, log: CommitLog) -> None:
        """Merge what is left, and wait for it."""
        while self._merging is not None or self._unmerged:
            if self._merging is not None:
                wait([self._merging[1]])
            self.merge(log)

    def _finish(self, log: CommitLog, segment: str, outcome: Future[list[Path]]) -> None:
        commits = [commit for commit in read_commits(self._folder) if commit.segment == segment]
        if not commits:
            return  # it has been deleted meanwhile
        publish(outcome.result())
        for part, length in commits[-1].archived.items():
            end_archive(archive_path(self._folder / segment, part), length)
        log.merge(segment)
        for commit in commits:
            for table in TABLES:
                part_path(self._folder / segment, table, commit.first).unlink(missing_ok=True)

    def _clear_up(self, commits: Sequence[Commit]) -> None:
        """Remove unfinished work of a killed run."""
        counted = {commit.segment for commit in commits}
        for path in segment_folders(self._folder):
            if path.name not in counted:
                shutil.rmtree(path)
                continue
            remove_temporary(path)
            its = [commit for commit in commits if commit.segment == path.name]
            if its[-1].merged:
                for part in path.glob("*-*.parquet"):
                    part.unlink()
            elif path.name == self.name:
                for video in path.glob("*.mp4"):
                    if not video.stat().st_size:
                        video.unlink()
                for archive in path.glob("*.tar"):
                    cut_archive(archive, self._lengths.get(archive.stem, 0))
                for part in path.glob("*-*.parquet"):
                    if int(part.stem.partition("-")[2]) > its[-1].last:
                        part.unlink()
