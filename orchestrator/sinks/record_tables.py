"""Reads the committed tables of a stream's record."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import pyarrow as pa
import pyarrow.parquet as pq

from orchestrator.sinks.commit_log import read_commits

__all__ = ["part_path", "read_table"]


def part_path(folder: Path, name: Literal["frames", "layers"], first: int) -> Path:
    """Return the path of the part of a table whose commit begins with frame ``first``."""
    return folder / f"{name}-{first:08d}.parquet"


def read_table(
    folder: Path, name: Literal["frames", "layers"], columns: Sequence[str] | None = None
) -> pa.Table:
    """Read committed rows of one table of a stream; without columns if the tables were not saved.

    Parameters
    ----------
    folder : Path
        Of the stream.
    name : {"frames", "layers"}
    columns : sequence of str, optional
        The columns to read, all by default; those that a part lacks are left out.
    """
    parts = [part_path(folder, name, commit.first) for commit in read_commits(folder)]
    tables = []
    for part in parts:
        if part.exists():
            schema = pq.read_schema(part)
            wanted = None if columns is None else [column for column in columns if column in schema.names]
            tables.append(pq.read_table(part, columns=wanted))
    return pa.concat_tables(tables) if tables else pa.table({})
