"""The truth of synthetic scenes as results, for tests of what is made of results."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mlbs_actors.messages import Array, LayerSummary, Region, Segmentation


def true_result(index: int, labels: Array, camera_motion: tuple[float, float] = (0.0, 0.0)) -> Segmentation:
    """A result with these labels (H, W), whose objects stand still."""
    return Segmentation(
        frame_index=index,
        labels=labels.astype(np.uint16),
        normaliser=np.zeros((1, 1), np.uint8),
        fallback=np.zeros((1, 1), np.int8),
        layers=tuple(_summaries(labels)),
        camera_motion=camera_motion,
        latency_frames=0,
    )


def _summaries(labels: Array) -> Iterator[LayerSummary]:
    for layer in np.unique(labels[labels > 0]).tolist():
        y, x = np.nonzero(labels == layer)
        region = Region(int(x.min()), int(y.min()), int(np.ptp(x)) + 1, int(np.ptp(y)) + 1)
        centroid = float(x.mean()), float(y.mean())
        yield LayerSummary(layer, "object", region, len(x), centroid, (0.0, 0.0), 1.0)
