"""Folders that commands have made, of a run, and may remove again to make room for a new one."""

from __future__ import annotations

from pathlib import Path

__all__ = ["is_made", "mark_made"]

#: File in each folder that a command has made; without it none is removed to make room for a new one.
_MARK = ".mlbs-actors-made"


def mark_made(folder: Path) -> None:
    """Say in a folder that all that is in it was made by a command."""
    (folder / _MARK).touch()


def is_made(folder: Path, run: Path) -> bool:
    """Whether a folder may be removed: a command has made it, or nothing is in it; never with the run."""
    if not folder.is_dir() or folder.is_symlink() or run.resolve().is_relative_to(folder.resolve()):
        return False
    return (folder / _MARK).exists() or not any(folder.iterdir())
