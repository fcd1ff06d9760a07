"""Reads the committed tables of a stream's record."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Literal

import pyarrow as pa
import pyarrow.parquet as pq

from mlbs_actors.messages import LayerSummary, Region
from orchestrator.rows.frame_row import FrameRow, ResultRow
from orchestrator.rows.scene_place import ScenePlace
from orchestrator.sinks.commit_log import read_commits

__all__ = ["part_path", "read_rows", "read_table"]

_Table = Literal["frames", "layers"]
_TABLES: tuple[_Table, _Table] = ("layers", "frames")


def part_path(folder: Path, name: _Table, first: int) -> Path:
    """Return the path of the part of a table whose commit begins with frame ``first``."""
    return folder / f"{name}-{first:08d}.parquet"


def read_table(folder: Path, name: _Table) -> pa.Table:
    """Read committed rows of one table of a stream; without columns if the tables were not saved.

    Parameters
    ----------
    folder : Path
        Of the stream.
    name : {"frames", "layers"}
    """
    parts = [part_path(folder, name, commit.first) for commit in read_commits(folder)]
    tables = [pq.read_table(part) for part in parts if part.exists()]
    return pa.concat_tables(tables) if tables else pa.table({})


def read_rows(folder: Path, begin: int = 0, end: float = math.inf) -> Iterator[FrameRow]:
    """Yield committed rows of a stream whose tables were saved, one part at a time; without stage times.

    Parameters
    ----------
    folder : Path
        Of the stream; one that is not there has no rows.
    begin, end : int
        Only parts whose rows are all from ``begin`` to before ``end``.
    """
    for commit in read_commits(folder):
        if commit.first < begin or commit.last >= end:
            continue
        paths = [part_path(folder, name, commit.first) for name in _TABLES]
        if not all(path.exists() for path in paths):
            continue
        of_layers, of_frames = map(_without_times, paths)
        layers: dict[int, list[dict[str, Any]]] = {}
        for row in of_layers:
            layers.setdefault(row["frame"], []).append(row)
        for row in of_frames:
            result = None if row["name"] is None else _result(row, layers.get(row["frame"], []))
            yield FrameRow(row["frame"], row["pts"], row["status"], result, row["name"])


def _without_times(path: Path) -> list[dict[str, Any]]:
    """Read a part without the columns of stage times, which are half of its columns."""
    with pq.ParquetFile(path) as part:
        columns = [name for name in part.schema_arrow.names if not name.startswith("ms_")]
        rows: list[dict[str, Any]] = part.read(columns=columns).to_pylist()
    return rows


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
