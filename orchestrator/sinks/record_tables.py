"""Reads back the tables of a stream's record: what its commit log says is there, and nothing else."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import pyarrow as pa
import pyarrow.parquet as pq

__all__ = ["COMMIT_LOG", "committed_groups", "part_path", "read_table"]

COMMIT_LOG = "commits.jsonl"


def committed_groups(folder: Path) -> list[dict[str, Any]]:
    """Lines of a stream's commit log, in order; a line that was cut off by a kill does not count.

    Parameters
    ----------
    folder : Path
        Of the stream.
    """
    log = folder / COMMIT_LOG
    if not log.exists():
        return []
    *whole, _torn = log.read_text(encoding="utf-8").split("\n")
    return [json.loads(line) for line in whole]


def part_path(folder: Path, name: Literal["frames", "layers"], group: Mapping[str, Any]) -> Path:
    """Where a group's rows of a table are."""
    return folder / f"{name}-{group['first']:08d}.parquet"


def read_table(
    folder: Path, name: Literal["frames", "layers"], columns: Sequence[str] | None = None
) -> pa.Table:
    """Committed rows of one table of a stream; no columns at all if the tables were not saved.

    Parameters
    ----------
    folder : Path
        Of the stream.
    name : {"frames", "layers"}
    columns : sequence of str, optional
        Those wanted, all by default; those that a part lacks are left out.
    """
    parts = [part_path(folder, name, group) for group in committed_groups(folder)]
    tables = []
    for part in parts:
        if part.exists():
            schema = pq.read_schema(part)
            wanted = None if columns is None else [column for column in columns if column in schema.names]
            tables.append(pq.read_table(part, columns=wanted))
    return pa.concat_tables(tables) if tables else pa.table({})
