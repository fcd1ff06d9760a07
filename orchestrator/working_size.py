"""Process smaller pictures, record in full size (``--max-side``).

The reader passes a shrunk picture to the engine; before anything is written, the label map is enlarged to the
size of the source by nearest neighbour, and the values of the tables are measured on that. Outlines are as
coarse as the smaller picture.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np

from mlbs_actors.messages import Array, LayerAppearance, LayerSummary, Region, Segmentation
from mlbs_actors.source import FrameReader, SourceFrame, SourceSilence
from orchestrator.events.scene import resizing
from orchestrator.sinks.record import StreamRecord

__all__ = ["FullSizeRecord", "ShrinkingReader", "enlarged", "labels_in_size", "resized", "shrunk"]


class ShrinkingReader:
    """A reader whose pictures have no side longer than ``max_side`` px; the originals are kept beside them.

    Parameters
    ----------
    open_reader : callable
        Opens the source.
    max_side : int
    """

    def __init__(self, open_reader: Callable[[], FrameReader], max_side: int) -> None:
        self._reader = open_reader()
        self._max_side = max_side

    @property
    def problem(self) -> str | None:
        """Damage of the source so far."""
        return self._reader.problem

    def read(self) -> SourceFrame | SourceSilence | None:
        """Return the next frame, shrunk."""
        frame = self._reader.read()
        if not isinstance(frame, SourceFrame) or frame.image is None:
            return frame
        return replace(frame, image=shrunk(frame.image, self._max_side), original=frame.image)

    def close(self) -> None:
        """Release the source."""
        self._reader.close()


class FullSizeRecord(StreamRecord):
    """Records results of shrunk pictures in the size of the source."""

    def write(
        self, segmentation: Segmentation, frame: SourceFrame, background: LayerAppearance | None = None
    ) -> int:
        """Write one result; return the number of label maps committed."""
        assert frame.original is not None  # from a ShrinkingReader
        height, width = frame.original.shape[:2]
        whole = replace(frame, image=frame.original, original=None)
        if background is not None:
            background = _enlarged_appearance(background, (height, width))
        return super().write(enlarged(segmentation, (height, width)), whole, background)


def shrunk(image: Array, max_side: int) -> Array:
    """Shrink an (H, W, 3) uint8 image so that no side is longer than ``max_side`` px; never enlarge it."""
    return resized(image, min(max_side, max(image.shape[:2])))


def resized(image: Array, longer_side: int) -> Array:
    """Shrink or enlarge an (H, W, 3) uint8 image so that its longer side has so many px."""
    height, width = image.shape[:2]
    share = longer_side / max(height, width)
    size = (max(1, round(width * share)), max(1, round(height * share)))
    if size == (width, height):
        return image
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA if share < 1 else cv2.INTER_CUBIC))


def enlarged(segmentation: Segmentation, shape: tuple[int, int]) -> Segmentation:
    """Enlarge the segmentation of a smaller picture to ``shape`` (H, W)."""
    small = segmentation.labels.shape
    if small == shape:
        return segmentation
    per_px = (shape[1] / small[1], shape[0] / small[0])
    camera = segmentation.camera
    if camera is not None:
        enlarging = resizing(small, shape)
        camera = enlarging @ camera @ np.linalg.inv(enlarging)
    labels = labels_in_size(segmentation.labels, shape)
    return replace(
        segmentation,
        labels=labels,
        layers=tuple(_measured(layer, labels, per_px) for layer in segmentation.layers),
        camera_motion=_scaled(segmentation.camera_motion, per_px),
        camera=camera,
    )


def _enlarged_appearance(background: LayerAppearance, shape: tuple[int, int]) -> LayerAppearance:
    """Enlarge the background's appearance, whose region is the frame."""
    height, width = shape
    return replace(
        background,
        region=Region(0, 0, width, height),
        colours=np.asarray(cv2.resize(background.colours, (width, height), interpolation=cv2.INTER_LINEAR)),
        known=labels_in_size(background.known, shape),
    )


def labels_in_size(array: Array, shape: tuple[int, int]) -> Array:
    """Bring an (h, w) label map or mask to ``shape`` (H, W) by nearest neighbour."""
    rows, columns = (
        # The pixel at the centre of each new one.
        np.minimum((2 * np.arange(new) + 1) * old // (2 * new), old - 1)
        for new, old in zip(shape, array.shape, strict=True)
    )
    return np.ascontiguousarray(array[rows][:, columns])


def _measured(layer: LayerSummary, labels: Array, per_px: tuple[float, float]) -> LayerSummary:
    y, x = np.nonzero(labels == layer.layer)
    return replace(
        layer,
        region=Region(int(x.min()), int(y.min()), int(np.ptp(x)) + 1, int(np.ptp(y)) + 1),
        area=len(x),
        centroid=(float(x.mean()), float(y.mean())),
        velocity=_scaled(layer.velocity, per_px),
    )


def _scaled(motion: tuple[float, float], per_px: tuple[float, float]) -> tuple[float, float]:
    return motion[0] * per_px[0], motion[1] * per_px[1]
