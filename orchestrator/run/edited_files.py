"""The files that an operator edits, in the run's folder: every version that was in force, the newest last."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from orchestrator.storage.durable_files import replace_file
from orchestrator.yaml_file import masked_yaml

__all__ = ["keep_version", "newest_version"]

Edited = Literal["zones", "cameras"]


def newest_version(run: Path, kind: Edited) -> Path | None:
    """Return the version in force, of which passwords are hidden; None if there never was one."""
    return max(run.glob(f"{kind}-[0-9][0-9][0-9][0-9].yaml"), default=None)


def keep_version(run: Path, kind: Edited, text: str) -> None:
    """Keep the contents of a file as the version in force now; OSError as the disk says."""
    newest, content = newest_version(run, kind), masked_yaml(text).encode()
    if newest is None or newest.read_bytes() != content:
        number = 1 if newest is None else int(newest.stem.rpartition("-")[2]) + 1
        replace_file(run / f"{kind}-{number:04d}.yaml", content)
