"""The rows of a record, as Parquet parts.

Two tables: ``frames``, a row per frame of the source, and ``layers``, a row per frame and object layer. Each
part is a closed file of its own (a Parquet file without its footer cannot be read), and all parts of a
table have the same columns.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from pycocotools import mask as coco_mask

from mlbs_actors.actors.stream.protocol import GapStatus
from mlbs_actors.messages import Array, FrameStatus, LayerSummary, Region, Segmentation
from orchestrator.events.scene import ScenePlace

__all__ = [
    "FrameRow",
    "ResultRow",
    "frame_schema",
    "layer_schema",
    "run_length_code",
    "stages_of",
    "write_frames",
    "write_layers",
]

#: Stage for the time of those that the first part did not have.
OTHER_STAGES = "other"


@dataclass(frozen=True, slots=True)
class ResultRow:
    """Values of a segmentation for the tables, without maps, so that waiting rows keep no frames in memory.

    Attributes
    ----------
    layers : tuple of LayerSummary
    run_length_codes : tuple of str
        One for each of ``layers``.
    shape : (H, W)
    pixel_aspect : float
        Width of a pixel for its height.
    camera_motion : (float, float)
        px/frame.
    latency_frames : int
    stage_ms : mapping of str to float
    camera : tuple of float, optional
        Of the segmentation, row by row.
    scene : ScenePlace, optional
        Where the scene is; None while that is unknown, and if no zone is fixed to it.
    """

    layers: tuple[LayerSummary, ...]
    run_length_codes: tuple[str, ...]
    shape: tuple[int, int]
    pixel_aspect: float
    camera_motion: tuple[float, float]
    latency_frames: int
    stage_ms: Mapping[str, float]
    camera: tuple[float, ...] | None = None
    scene: ScenePlace | None = None

    @classmethod
    def of(
        cls, segmentation: Segmentation, pixel_aspect: float, scene: ScenePlace | None = None
    ) -> ResultRow:
        """Summarise a segmentation of a frame."""
        labels, camera = segmentation.labels, segmentation.camera
        height, width = labels.shape
        return cls(
            layers=segmentation.layers,
            run_length_codes=tuple(
                run_length_code(labels, layer.layer, layer.region) for layer in segmentation.layers
            ),
            shape=(height, width),
            pixel_aspect=pixel_aspect,
            camera_motion=segmentation.camera_motion,
            latency_frames=segmentation.latency_frames,
            stage_ms=dict(segmentation.stage_ms),
            camera=None if camera is None else tuple(camera.ravel().tolist()),
            scene=scene,
        )


@dataclass(frozen=True, slots=True)
class FrameRow:
    """One frame of the source in the record.

    Attributes
    ----------
    frame : int
        Source index.
    pts : float
        Seconds since the source's first frame.
    status : FrameStatus or GapStatus
    result : ResultRow, optional
    name : str, optional
        File name of the mask, without extension. Both are None without a label map.
    """

    frame: int
    pts: float
    status: FrameStatus | GapStatus
    result: ResultRow | None = None
    name: str | None = None


def run_length_code(labels: Array, layer: int, region: Region) -> str:
    """Encode the mask of one layer as COCO's compressed run-length string (column-major).

    Parameters
    ----------
    labels : (H, W) uint16
    layer : int
    region : Region
        Contains all the layer's pixels; only there they are searched for.
    """
    height, width = labels.shape
    # A row of zeros below each column ends its last run, which may continue at the top of the next one.
    pitch = min(region.height + 1, height)
    inside = np.zeros(region.width * pitch + 2, np.bool_)  # with a zero before and after them all
    columns = inside[1:-1].reshape(region.width, pitch)
    np.equal(labels[region.slices].T, layer, out=columns[:, : region.height])
    changes = (inside[1:] != inside[:-1]).nonzero()[0]
    bounds = changes + changes // pitch * (height - pitch) + (region.x * height + region.y)
    bounds = np.concatenate(([0], bounds, [height * width]))
    counts = bounds[1:] - bounds[:-1]
    if counts[-1] == 0:
        counts = counts[:-1]  # the last run is the layer's own
    plain = {"size": [height, width], "counts": counts.tolist()}
    return str(coco_mask.frPyObjects(plain, height, width)["counts"].decode("ascii"))


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
