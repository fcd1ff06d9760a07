"""``commits.jsonl``: which frames of a stream are safely on the disk, and which process may add to it.

Opening the log increments its *generation*. A surviving process of a killed run finds, before it commits,
that there is a newer one, and is refused: checking and committing are done under one lock, which the system
releases when a process dies.

Of a record in segments the lines of a closed one are merged into a single line once its tables are, and the
lines of deleted ones are gone: the log then begins with a later frame.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, replace
from itertools import dropwhile
from pathlib import Path

from filelock import FileLock, Timeout

from mlbs_actors.errors import SinkError
from mlbs_actors.record.commits import COMMIT_LOG, Commit, permanent, read_commits
from orchestrator.storage.durable_files import append_line, replace_file

__all__ = ["CommitLog", "between_commits", "forget_segment"]

_GENERATION, _LOCK = ".generation", ".lock"

#: How long another process may take for its commit, s.
_LOCK_SECONDS = 10.0

#: The same for what can be tried again later, s.
_BRIEF_SECONDS = 1.0


@contextmanager
def between_commits(folder: Path) -> Iterator[None]:
    """Keep a stream from committing while the ``with`` block looks at its files; that must not last long.

    Raises
    ------
    SinkError
        If another process keeps the lock.
    """
    with _locked(folder, _BRIEF_SECONDS):
        yield


def forget_segment(folder: Path, segment: str) -> bool:
    """Remove the lines of a segment, which then counts no more; return whether it was the oldest one.

    Raises
    ------
    SinkError
        If another process keeps the lock.
    OSError
        As the disk says.
    """
    with _locked(folder, _BRIEF_SECONDS):
        commits = read_commits(folder)
        left = list(dropwhile(lambda commit: commit.segment == segment, commits))
        if not left or len(left) == len(commits):
            return False
        _replace(folder, left)
        return True


class CommitLog:
    """The log of one stream, opened for adding to it.

    Opening it removes torn and provisional lines.

    Parameters
    ----------
    folder : Path
        The stream's, which must exist.

    Attributes
    ----------
    generation : int
    rows : int
        Frames of the source that count.

    Raises
    ------
    SinkError
        If another process keeps the lock.
    OSError
        As the disk says; from :meth:`add` too.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        with _locked(folder):
            known = (folder / _GENERATION).exists()
            self.generation = self._newest() + 1 if known else 0
            replace_file(folder / _GENERATION, f"{self.generation}\n".encode())
            commits = permanent(read_commits(folder))
            self.rows = commits[-1].last + 1 if commits else 0
            if (folder / COMMIT_LOG).exists():
                _replace(folder, commits)

    @contextmanager
    def exclusive(self) -> Iterator[None]:
        """Keep other processes out while the ``with`` block publishes files and commits them.

        Raises
        ------
        SinkError
            If the stream has been started again since, by this run or another.
        """
        with _locked(self._folder):
            if self._newest() != self.generation:
                raise SinkError(f"The stream in {self._folder} has been started again; this one is over.")
            yield

    def add(
        self,
        last: int,
        snapshot: str | None,
        *,
        provisional: bool,
        segment: str | None = None,
        archived: Mapping[str, int] | None = None,
    ) -> None:
        """Commit the frames up to ``last``; only inside :meth:`exclusive`."""
        commit = Commit(
            self.generation, self.rows, last, snapshot, provisional, segment, dict(archived or {})
        )
        append_line(self._folder / COMMIT_LOG, _line(commit))
        self.rows = last + 1

    def merge(self, segment: str) -> None:
        """Merge the lines of a closed segment into one; only inside :meth:`exclusive`."""
        commits = read_commits(self._folder)
        its = [commit for commit in commits if commit.segment == segment]
        merged = replace(its[-1], first=its[0].first, merged=True)
        place = commits.index(its[0])
        _replace(self._folder, [*commits[:place], merged, *commits[place + len(its) :]])

    def _newest(self) -> int:
        return int((self._folder / _GENERATION).read_text(encoding="ascii"))


@contextmanager
def _locked(folder: Path, seconds: float | None = None) -> Iterator[None]:
    lock = FileLock(folder / _LOCK, timeout=_LOCK_SECONDS if seconds is None else seconds)
    try:
        lock.acquire()
    except Timeout:
        raise SinkError(
            f"Another process is writing to {folder} and does not end; end it, then resume the run."
        ) from None
    try:
        yield
    finally:
        lock.release()


def _replace(folder: Path, commits: list[Commit]) -> None:
    """Write the whole log, unless it is that already."""
    content = "".join(_line(commit) + "\n" for commit in commits).encode()
    if (folder / COMMIT_LOG).read_bytes() != content:
        replace_file(folder / COMMIT_LOG, content)


def _line(commit: Commit) -> str:
    """Format a commit as JSON; what is not of every record is written only where it says something."""
    fields = asdict(commit)
    for key in ("provisional", "segment", "archived", "merged"):
        if not fields[key]:
            del fields[key]
    return json.dumps(fields)
