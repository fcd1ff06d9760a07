"""Which frames of a record are safely on the disk: the lines of ``commits.jsonl``.

:mod:`orchestrator.storage.commit_log` writes them.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

__all__ = ["COMMIT_LOG", "Commit", "oldest_frame", "permanent", "read_commits"]

COMMIT_LOG = "commits.jsonl"


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
    segment : str, optional
        Folder of their files in the stream's folder; by default they are in that itself.
    archived : mapping of str to int
        Of that folder's archives of pictures, by name: the length that counts so far, bytes.
    merged : bool
        Whether these are all frames of a closed segment, whose tables are one file each.
    """

    generation: int
    first: int
    last: int
    snapshot: str | None
    provisional: bool = False
    segment: str | None = None
    archived: Mapping[str, int] = field(default_factory=dict)
    merged: bool = False


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
        # What was before the first line's segment is deleted.
        expected = commits[-1].last + 1 if commits else 0 if commit.segment is None else commit.first
        if commit.first != expected:
            break
        commits.append(commit)
    return commits


def oldest_frame(folder: Path) -> int:
    """Return the first frame that a stream's log has, 0 if it is empty: those before it are deleted."""
    try:
        with (folder / COMMIT_LOG).open("rb") as log:
            return int(json.loads(log.readline())["first"])
    except (FileNotFoundError, ValueError, TypeError, KeyError):
        return 0


def permanent(commits: Sequence[Commit]) -> list[Commit]:
    """Return the lines that a run that resumes goes on from."""
    return [commit for commit in commits if not commit.provisional]
