"""The tables of a closed segment, merged from the parts of its commits."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from mlbs_actors.record.commits import Commit
from mlbs_actors.record.record_tables import BATCH_ROWS, TABLES, part_of, part_path
from orchestrator.storage.durable_files import temporary_path

__all__ = ["merge_parts"]


def merge_parts(folder: Path, commits: Sequence[Commit]) -> list[Path]:
    """Write the tables of a segment into one part each, under temporary names; return their paths.

    Parameters
    ----------
    folder : Path
        Of the stream.
    commits : sequence of Commit
        All of the segment.
    """
    merged = []
    for name in TABLES:
        parts = [path for commit in commits if (path := part_of(folder, name, commit)).exists()]
        if not parts:
            continue
        path = part_path(parts[0].parent, name, None)
        with pq.ParquetWriter(temporary_path(path), pq.read_schema(parts[0])) as writer:
            waiting: list[pa.Table] = []
            for part in parts:
                with pq.ParquetFile(part) as file:
                    waiting.append(file.read(use_threads=False))
                if part is parts[-1] or sum(table.num_rows for table in waiting) >= BATCH_ROWS:
                    writer.write_table(pa.concat_tables(waiting).combine_chunks())
                    waiting = []
        merged.append(path)
    return merged
