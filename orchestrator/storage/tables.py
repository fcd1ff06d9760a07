"""The rows of a record, as Parquet parts.

Two tables: ``frames``, a row per frame of the source, and ``layers``, a row per frame and object layer. Each
part is a closed file of its own (a Parquet file without its footer cannot be read), and all parts of a
table have the same columns.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from mlbs_actors.record.frame_row import FrameRow, ResultRow

__all__ = [
    "frame_schema",
    "layer_schema",
    "stages_of",
    "write_frames",
    "write_layers",
]

#: Stage for the time of those that the first part did not have.
OTHER_STAGES = "other"


def stages_of(schema: pa.Schema) -> tuple[str, ...]:
    """Return the stages of a :func:`frame_schema`."""
    stages = (name.removeprefix("ms_") for name in schema.names if name.startswith("ms_"))
    return tuple(stage for stage in stages if stage != OTHER_STAGES)


def layer_schema() -> pa.Schema:
    """Return the columns of ``layers``; positions in px, velocities in px/frame (mean motion t−1 → t)."""
    return pa.schema(
        [
            ("stream", pa.string()),
            ("frame", pa.int64()),
            ("layer", pa.int32()),
            ("kind", pa.string()),
            *((name, pa.int32()) for name in ("x", "y", "w", "h")),
            ("area", pa.int64()),
            *((name, pa.float32()) for name in ("cx", "cy", "vx", "vy", "confidence")),
            ("rle", pa.string()),
            ("state", pa.string()),
            ("score", pa.float32()),
        ]
    )


def frame_schema(stages: Sequence[str]) -> pa.Schema:
    """Return the columns of ``frames``; those after ``status`` are null without a label map.

    Parameters
    ----------
    stages : sequence of str
        Stages of the pipeline, each a column ``ms_<stage>`` of wall time, ms.
    """
    return pa.schema(
        [
            ("stream", pa.string()),
            ("frame", pa.int64()),
            ("pts", pa.float64()),
            ("status", pa.string()),
            ("layers", pa.int32()),
            ("latency_frames", pa.int32()),
            ("camera_dx", pa.float32()),
            ("camera_dy", pa.float32()),
            ("height", pa.int32()),
            ("width", pa.int32()),
            ("pixel_aspect", pa.float32()),
            ("name", pa.string()),
            ("camera", pa.list_(pa.float32())),
            ("scene", pa.list_(pa.float32())),
            ("scene_height", pa.int32()),
            ("scene_width", pa.int32()),
            *((f"ms_{stage}", pa.float32()) for stage in (*stages, OTHER_STAGES)),
        ]
    )


def write_layers(path: Path, stream: str, rows: Sequence[FrameRow]) -> None:
    """Write one part of ``layers``; empty parts are written too, so that the table always exists."""
    records = [
        {
            "stream": stream,
            "frame": row.frame,
            "layer": layer.layer,
            "kind": layer.kind,
            "state": layer.state,
            "x": layer.region.x,
            "y": layer.region.y,
            "w": layer.region.width,
            "h": layer.region.height,
            "area": layer.area,
            "cx": layer.centroid[0],
            "cy": layer.centroid[1],
            "vx": layer.velocity[0],
            "vy": layer.velocity[1],
            "confidence": layer.confidence,
            "rle": code,
            "score": layer.score,
        }
        for row in rows
        if row.result is not None
        for layer, code in zip(row.result.layers, row.result.run_length_codes, strict=True)
    ]
    pq.write_table(pa.Table.from_pylist(records, layer_schema()), path)


def write_frames(path: Path, stream: str, rows: Sequence[FrameRow], stages: Sequence[str]) -> None:
    """Write one part of ``frames``; see :func:`frame_schema` for ``stages``."""
    records = [
        {"stream": stream, "frame": row.frame, "pts": row.pts, "status": row.status, "name": row.name}
        | ({} if row.result is None else _result_columns(row.result, stages))
        for row in rows
    ]
    pq.write_table(pa.Table.from_pylist(records, frame_schema(stages)), path)


def _result_columns(
    result: ResultRow, stages: Sequence[str]
) -> dict[str, float | int | tuple[float, ...] | None]:
    scene = result.scene
    height, width = (None, None) if scene is None else scene.shape
    return {
        "layers": len(result.layers),
        "latency_frames": result.latency_frames,
        "camera_dx": result.camera_motion[0],
        "camera_dy": result.camera_motion[1],
        "height": result.shape[0],
        "width": result.shape[1],
        "pixel_aspect": result.pixel_aspect,
        "camera": result.camera,
        "scene": None if scene is None else scene.matrix,
        "scene_height": height,
        "scene_width": width,
        **_stage_columns(result.stage_ms, stages),
    }


def _stage_columns(stage_ms: Mapping[str, float], stages: Sequence[str]) -> dict[str, float | None]:
    columns: dict[str, float | None] = {f"ms_{stage}": stage_ms.get(stage) for stage in stages}
    columns[f"ms_{OTHER_STAGES}"] = sum(ms for stage, ms in stage_ms.items() if stage not in stages)
    return columns
