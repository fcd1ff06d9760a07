"""What a layer is given: frames, trajectories, evidence and published maps, made by hand.

As of what a layer receives, nothing can be written to them: kernels are compiled for that.
"""

from __future__ import annotations

import numpy as np
from joined_evidence import joined_evidence
from read_only import read_only

from mlbs_actors.messages import (
    BACKGROUND,
    Array,
    FrameEvidence,
    LayerEvidence,
    LayerKind,
    LayerSummary,
    Region,
    Segmentation,
    readonly,
)

SHAPE = (120, 160)
WHOLE = Region(0, 0, SHAPE[1], SHAPE[0])
CAR = Region(60, 40, 40, 30)


def picture(seed: int = 0) -> Array:
    return read_only(np.random.default_rng(seed).integers(0, 256, (*SHAPE, 3)).astype(np.uint8))


def grid(region: Region, spacing: int = 6) -> Array:
    """Trajectories all over a region."""
    x, y = np.meshgrid(
        np.arange(region.x + 2, region.x + region.width - 1, spacing),
        np.arange(region.y + 2, region.y + region.height - 1, spacing),
    )
    return np.stack([x.ravel(), y.ravel()], axis=1).astype(np.float32)


def tracks(
    layer: int, positions: Array, last_frame: int = -1, motion: tuple[float, float] = (0.0, 0.0)
) -> LayerEvidence:
    motions = np.tile(np.array(motion, np.float32), (len(positions), 1))
    kind: LayerKind = "object" if layer else "background"
    return LayerEvidence(layer, kind, last_frame, read_only(positions), read_only(motions))


def frame_of(
    layers: list[LayerEvidence],
    frame_index: int = 0,
    flow: tuple[float, float] = (0.0, 0.0),
    reliable: bool = False,
    image: Array | None = None,
) -> FrameEvidence:
    """Cells of one pixel; nothing is explained by the camera's motion, unless a test says otherwise."""
    made = joined_evidence(
        layers,
        frame_index=frame_index,
        shape=SHAPE,
        camera=np.eye(3),
        flow=np.full((*SHAPE, 2), flow, np.float32),
        flow_reliable=np.full(SHAPE, reliable),
        unexplained=np.full(SHAPE, 255, np.uint8),
        colours=picture() if image is None else image,
        retired=(),
        latency_frames=0,
    )
    return readonly(made)


def published(
    frame_index: int,
    labels: Array,
    normaliser: int = 64,
    velocity: tuple[float, float] = (0.0, 0.0),
) -> Segmentation:
    """Every object's summary is that of its pixels in the map; they all have the same velocity."""
    summaries = []
    for layer in np.unique(labels[labels != BACKGROUND]):
        rows, columns = np.nonzero(labels == layer)
        x, y = int(columns.min()), int(rows.min())
        box = Region(x, y, int(columns.max()) + 1 - x, int(rows.max()) + 1 - y)
        centre = float(columns.mean()), float(rows.mean())
        summaries.append(LayerSummary(int(layer), "object", box, len(rows), centre, velocity, 1.0))
    made = Segmentation(
        frame_index=frame_index,
        labels=labels.astype(np.uint16),
        normaliser=np.full(SHAPE, normaliser, np.uint8),
        fallback=np.zeros(SHAPE, np.int8),
        layers=tuple(summaries),
        camera_motion=(0.0, 0.0),
        latency_frames=0,
    )
    return readonly(made)


def owned(region: Region, layer: int = 1) -> Array:
    labels = np.zeros(SHAPE, int)
    labels[region.slices] = layer
    return labels
