"""The rows of a record: what is known of each frame, without its maps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from mlbs_actors.messages import Array, FrameStatus, LayerSummary, Region, Segmentation
from mlbs_actors.record.scene_place import ScenePlace
from mlbs_actors.source import GapStatus

__all__ = ["FrameRow", "ResultRow", "run_length_code"]


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
    from pycocotools import mask as coco_mask  # of an extra; what only reads rows needs none

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
