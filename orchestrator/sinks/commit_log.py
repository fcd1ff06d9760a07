"""``commits.jsonl``: which frames of a stream are safely on the disk, and which process may add to it.

Opening the log increments its *generation*. A surviving process of a killed run finds, before it commits,
that there is a newer one, and is refused: checking and committing are done under one lock, which the system
releases when a process dies.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path

from filelock import FileLock, Timeout

from mlbs_actors.errors import SinkError
from orchestrator.run.durable_files import append_line, replace_file

__all__ = ["COMMIT_LOG", "Commit", "CommitLog", "read_commits"]

COMMIT_LOG = "commits.jsonl"

_GENERATION, _LOCK = ".generation", ".lock"

#: How long another process may take for its commit, s.
_LOCK_SECONDS = 10.0


@dataclass(frozen=True, slots=True)
class Commit:
    """A line: frames whose files and rows count.

    Attributes
    ----------
    generation : int
        Number of restarts of the stream before it.
    first, last : int
        Frames of the source, both included.
    snapshot : str or None
        Newest snapshot to go back to after these frames.
    provisional : bool
        Labelled without the frames that would have followed, because the run was interrupted.
    """

    generation: int
    first: int
    last: int
    snapshot: str | None
    provisional: bool = False


def read_commits(folder: Path) -> list[Commit]:
    """Read the complete, consecutive lines of a stream's log; none if there is no log."""
    try:
        lines = (folder / COMMIT_LOG).read_bytes().split(b"\n")
    except FileNotFoundError:
        return []
    commits: list[Commit] = []
    for line in lines[:-1]:  # a last line without newline was torn by a kill
        try:
            commit = Commit(**json.loads(line))
        except (ValueError, TypeError):
            break
        if commit.first != (commits[-1].last + 1 if commits else 0):
            break
        commits.append(commit)
    return commits


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
        self._lock = FileLock(folder / _LOCK, timeout=_LOCK_SECONDS)
        with self._locked():
            known = (folder / _GENERATION).exists()
            self.generation = self._newest() + 1 if known else 0
            replace_file(folder / _GENERATION, f"{self.generation}\n".encode())
            commits = [commit for commit in read_commits(folder) if not commit.provisional]
            self.rows = commits[-1].last + 1 if commits else 0
            content = "".join(_line(commit) + "\n" for commit in commits).encode()
            if (folder / COMMIT_LOG).exists() and (folder / COMMIT_LOG).read_bytes() != content:
                replace_file(folder / COMMIT_LOG, content)

    @contextmanager
    def exclusive(self) -> Iterator[None]:
        """Keep other processes out while the ``with`` block publishes files and commits them.

        Raises
        ------
        SinkError
            If the stream has been started again since, by this run or another.
        """
        with self._locked():
            if self._newest() != self.generation:
                raise SinkError(f"The stream in {self._folder} has been started again; this one is over.")
            yield

    def add(self, last: int, snapshot: str | None, *, provisional: bool) -> None:
        """Commit the frames up to ``last``; only inside :meth:`exclusive`."""
        append_line(
            self._folder / COMMIT_LOG, _line(Commit(self.generation, self.rows, last, snapshot, provisional))
        )
        self.rows = last + 1

    def _newest(self) -> int:
        return int((self._folder / _GENERATION).read_text(encoding="ascii"))

    @contextmanager
    def _locked(self) -> Iterator[None]:
        try:
            self._lock.acquire()
        except Timeout:
            raise SinkError(
                f"Another process is writing to {self._folder} and does not end; end it, then resume the run."
            ) from None
        try:
            yield
        finally:
            self._lock.release()


def _line(commit: Commit) -> str:
    """Format a commit as JSON; ``provisional`` is rare and written only if true."""
    fields = asdict(commit)
    if not commit.provisional:
        del fields["provisional"]
    return json.dumps(fields)
