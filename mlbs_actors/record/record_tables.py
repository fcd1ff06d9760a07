"""Reads the committed tables of a stream's record."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Literal

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from mlbs_actors.messages import LayerSummary, Region
from mlbs_actors.record.commits import Commit, read_commits
from mlbs_actors.record.frame_row import FrameRow, ResultRow
from mlbs_actors.record.scene_place import ScenePlace

__all__ = ["BATCH_ROWS", "TABLES", "newest_part", "part_of", "part_path", "read_rows", "read_table"]

_Table = Literal["frames", "layers"]
TABLES: tuple[_Table, _Table] = ("layers", "frames")

#: Rows in memory at once: a segment may be a day.
BATCH_ROWS = 4096


def part_path(folder: Path, name: _Table, first: int | None) -> Path:
    """Return the path of the part of a table whose commit begins with frame ``first``.

    ``folder`` is the stream's or a segment's; a segment's whole table is in one part, without a number.
    """
    return folder / (f"{name}.parquet" if first is None else f"{name}-{first:08d}.parquet")


def part_of(folder: Path, name: _Table, commit: Commit) -> Path:
    """Return the path of the part of a stream's table that has the rows of a commit."""
    place = folder if commit.segment is None else folder / commit.segment
    return part_path(place, name, None if commit.merged else commit.first)


def newest_part(folder: Path, name: _Table) -> Path | None:
    """Return the path of the newest part of a stream's table that counts, if there is one."""
    paths = (part_of(folder, name, commit) for commit in reversed(read_commits(folder)))
    return next((path for path in paths if path.exists()), None)


def read_table(folder: Path, name: _Table, begin: int = 0) -> pa.Table:
    """Read committed rows of one table of a stream; without columns if the tables were not saved.

    Parameters
    ----------
    folder : Path
        Of the stream.
    name : {"frames", "layers"}
    begin : int
        First frame.
    """
    commits = [commit for commit in read_commits(folder) if commit.last >= begin]
    parts = [part_of(folder, name, commit) for commit in commits]
    tables = []
    for path in parts:
        if path.exists():
            # Not by pq.read_table: where pandas is installed, that imports it, which takes seconds.
            with pq.ParquetFile(path) as part:
                tables.append(part.read_row_groups(_groups(part, begin, math.inf)))
    table = pa.concat_tables(tables) if tables else pa.table({})
    return table.filter(pc.greater_equal(table["frame"], begin)) if tables and begin else table


def read_rows(folder: Path, begin: int = 0, end: float = math.inf) -> Iterator[FrameRow]:
    """Yield committed rows of a stream whose tables were saved, one after the other; without stage times.

    Parameters
    ----------
    folder : Path
        Of the stream; one that is not there has no rows.
    begin, end : int
        Frames from ``begin`` to before ``end``.
    """
    for commit in read_commits(folder):
        if commit.last < begin or commit.first >= end:
            continue
        paths = [part_of(folder, name, commit) for name in TABLES]
        if not all(path.exists() for path in paths):
            continue
        of_layers, of_frames = (_without_times(path, begin, end) for path in paths)
        layer = next(of_layers, None)
        for row in of_frames:
            layers = []
            while layer is not None and layer["frame"] <= row["frame"]:
                if layer["frame"] == row["frame"]:
                    layers.append(layer)
                layer = next(of_layers, None)
            if begin <= row["frame"] < end:
                result = None if row["name"] is None else _result(row, layers)
                yield FrameRow(row["frame"], row["pts"], row["status"], result, row["name"])


def _without_times(path: Path, begin: int, end: float) -> Iterator[dict[str, Any]]:
    """Yield the rows of a part without the columns of stage times, which are half of its columns."""
    with pq.ParquetFile(path) as part:
        columns = [name for name in part.schema_arrow.names if not name.startswith("ms_")]
        groups = _groups(part, begin, end)
        for batch in part.iter_batches(BATCH_ROWS, row_groups=groups, columns=columns):
            yield from batch.to_pylist()


def _groups(part: pq.ParquetFile, begin: int, end: float) -> list[int]:
    """Return the groups of rows that may have frames from ``begin`` to before ``end``."""
    column = part.schema_arrow.names.index("frame")
    groups = (part.metadata.row_group(number) for number in range(part.num_row_groups))
    spans = [group.column(column).statistics for group in groups]
    return [
        number
        for number, span in enumerate(spans)
        if span is None or not span.has_min_max or (span.max >= begin and span.min < end)
    ]


def _result(frame: dict[str, Any], layers: Sequence[dict[str, Any]]) -> ResultRow:
    # Tables of earlier versions have fewer columns.
    camera, scene = frame.get("camera"), frame.get("scene")
    return ResultRow(
        layers=tuple(
            LayerSummary(
                layer=row["layer"],
                kind=row["kind"],
                region=Region(row["x"], row["y"], row["w"], row["h"]),
                area=row["area"],
                centroid=(row["cx"], row["cy"]),
                velocity=(row["vx"], row["vy"]),
                confidence=row["confidence"],
                state=row.get("state", "moving"),  # tables of earlier versions do not have it
                score=row.get("score", row["confidence"]),  # nor this
            )
            for row in layers
        ),
        run_length_codes=tuple(row["rle"] for row in layers),
        shape=(frame["height"], frame["width"]),
        pixel_aspect=frame.get("pixel_aspect", 1.0),
        camera_motion=(frame["camera_dx"], frame["camera_dy"]),
        latency_frames=frame["latency_frames"],
        stage_ms={},
        camera=None if camera is None else tuple(camera),
        scene=None
        if scene is None
        else ScenePlace((frame["scene_height"], frame["scene_width"]), tuple(scene)),
    )
