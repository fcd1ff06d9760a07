"""Files that are either complete or missing, even after a kill or a power cut.

A file is written under a temporary name, synced, and renamed; the rename is durable once its folder is
synced. Groups of files share the waits: write all, sync all, rename all, sync the folder once.
"""

from __future__ import annotations

import os
import secrets
from collections.abc import Iterable
from pathlib import Path

from mlbs_actors.errors import SinkError

__all__ = ["UnwritableError", "append_line", "publish", "remove_temporary", "replace_file", "temporary_path"]

#: Part of this process's temporary names, as a process of a killed run may live on for a while.
_OWN = secrets.token_hex(4)


class UnwritableError(SinkError):
    """The disk does not take what is to be written now; it may do so later."""


def temporary_path(path: Path) -> Path:
    """Return the name under which this process writes ``path`` until it is published; hidden, same folder."""
    return path.with_name(f".{path.name}.{_OWN}.part")


def remove_temporary(folder: Path) -> None:
    """Delete temporary files of a folder that were never published, by any process."""
    for path in folder.glob(".*.part"):
        path.unlink(missing_ok=True)


def publish(paths: Iterable[Path]) -> None:
    """Rename complete temporary files to their own names, durably.

    Raises
    ------
    OSError
        As the disk says; files already renamed stay.
    """
    drafts = [(temporary_path(path), path) for path in paths]
    for draft, _ in drafts:
        _sync(draft)
    for draft, path in drafts:
        draft.replace(path)
    for folder in sorted({path.parent for _, path in drafts}):
        _sync(folder)


def replace_file(path: Path, content: bytes) -> None:
    """Replace ``path`` atomically: readers see the old content or the new one."""
    temporary_path(path).write_bytes(content)
    publish([path])


def append_line(path: Path, line: str) -> None:
    """Append a line to a log and wait until it is on the disk."""
    is_new = not path.exists()
    with path.open("a", encoding="utf-8") as file:
        file.write(line + "\n")
        file.flush()
        os.fsync(file.fileno())
    if is_new:
        _sync(path.parent)


def _sync(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
