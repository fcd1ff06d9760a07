"""The zones of a run in its folder: every version that was in force, the newest one last."""

from __future__ import annotations

from pathlib import Path

from orchestrator.storage.durable_files import replace_file

__all__ = ["keep_zones", "newest_zones"]


def newest_zones(run: Path) -> Path | None:
    """Return the file with the zones in force; None if there never were any."""
    return max(run.glob("zones-[0-9][0-9][0-9][0-9].yaml"), default=None)


def keep_zones(run: Path, text: str) -> None:
    """Keep the contents of a file of zones as those in force now; OSError as the disk says."""
    newest = newest_zones(run)
    if newest is None or newest.read_text(encoding="utf-8") != text:
        number = 1 if newest is None else int(newest.stem.rpartition("-")[2]) + 1
        replace_file(run / f"zones-{number:04d}.yaml", text.encode())
