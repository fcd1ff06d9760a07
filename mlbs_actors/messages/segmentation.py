"""What the segmenter publishes: the label map of a frame and its objects."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from mlbs_actors.errors import MlbsError
from mlbs_actors.messages.terms import Array, FrameStatus, LayerKind, Region
from mlbs_actors.pickling import pickled_by_values

if TYPE_CHECKING:
    from supervision import Detections

__all__ = ["Boxes", "LayerSummary", "ObjectState", "Segmentation"]

#: Whether an object has moved against the camera lately.
ObjectState = Literal["moving", "resting"]


@pickled_by_values
@dataclass(frozen=True, slots=True)
class LayerSummary:
    """One layer in one published label map: a row of ``layers-*.parquet``.

    Attributes
    ----------
    layer : int
    kind : {"object", "other"}
    region : Region
        Bounding box of the layer's pixels.
    area : int
        Number of pixels, px.
    centroid : (float, float)
        (cx, cy), px.
    velocity : (float, float)
        Mean motion t−1 → t, px/frame.
    confidence : float
        Mean posterior of the label over its pixels, in [0, 1].
    state : {"moving", "resting"}
        Whether it has moved against the camera lately.
    score : float
        Expected intersection over union of its pixels with the object, in [0, 1]
        (:mod:`mlbs_actors.segmentation.mask_score`).
    part_of : int
        Layer that it is a part of, 0 if it is an object of its own; always 0 in what is published.
    """

    layer: int
    kind: LayerKind
    region: Region
    area: int
    centroid: tuple[float, float]
    velocity: tuple[float, float]
    confidence: float
    state: ObjectState = "moving"
    score: float = 0.0
    part_of: int = 0

    @property
    def object(self) -> int:
        """Id of its object: its own, or that of the layer that it is a part of."""
        return self.part_of or self.layer


class Boxes(NamedTuple):
    """The bounding boxes of a frame's objects.

    Attributes
    ----------
    ids : (n,) int64
        Layer ids, ascending.
    xyxy : (n, 4) int32
        Left, top, right and bottom, px; half-open: right and bottom are the first column and row outside.
    """

    ids: np.ndarray[tuple[Any, ...], np.dtype[np.int64]]
    xyxy: np.ndarray[tuple[Any, ...], np.dtype[np.int32]]


@pickled_by_values
@dataclass(frozen=True, slots=True)
class Segmentation:
    """The label map of one frame, and a row for each object in it.

    Attributes
    ----------
    frame_index : int
    labels : (H, W) uint16
        Layer id of every pixel, 0 = background, cleaned.
    layers : tuple of LayerSummary
        The object layers that own at least one pixel, in ascending id.
    camera_motion : (float, float)
        Mean motion t−1 → t of the background (forward), px/frame.
    latency_frames : int
        How many frames after its own decoding the frame was labelled.
    stage_ms : mapping of str to float
        Wall time by stage, ms.
    status : FrameStatus
    picture_index : int, optional
        Frame that the labels were found in, if that is not this one.
    camera : (3, 3) float64, optional
        Homography that takes homogeneous pixels of this frame to where they were in the last picture if they
        belong to the background; the identity if this frame shows no picture. None where that is unknown: in
        the first picture of a scene, and in one that tells too little.
    normaliser, fallback
        Internal: what the layers need in the next frame. ``normaliser`` is (rows, columns) uint8: for each
        cell of the layers' posteriors (:mod:`mlbs_actors.cells`), −log Z in units of ``COST_STEP`` nats, Z
        the sum of the unnormalised posteriors over the layers; 255 away from all objects, where the
        background's posterior is 1 whatever its cost. ``fallback`` is int8 of the same shape: log of the
        density that a layer without samples is assumed to have, in units of ``fusion.RATIO_STEP`` nats
        (:mod:`mlbs_actors.appearance.fusion`); 0 away from all objects.
    """

    frame_index: int
    labels: np.ndarray[tuple[Any, ...], np.dtype[np.uint16]] = field(repr=False)
    normaliser: Array = field(repr=False)
    fallback: Array = field(repr=False)
    layers: tuple[LayerSummary, ...]
    camera_motion: tuple[float, float]
    latency_frames: int
    stage_ms: Mapping[str, float] = field(default_factory=dict, repr=False)
    status: FrameStatus = "ok"
    picture_index: int | None = None
    camera: np.ndarray[tuple[Any, ...], np.dtype[np.float64]] | None = field(default=None, repr=False)

    @property
    def evaluated_frame(self) -> int:
        """Frame that the labels were found in."""
        return self.frame_index if self.picture_index is None else self.picture_index

    def boxes(self) -> Boxes:
        """Return the bounding boxes of the objects, with their ids."""
        ids = np.array([one.layer for one in self.layers], np.int64)
        left, top, width, height = (
            np.array([one.region.box for one in self.layers], np.int32).reshape(-1, 4).T
        )
        return Boxes(ids, np.stack([left, top, left + width, top + height], axis=1))

    def mask(self, layer: int) -> np.ndarray[tuple[Any, ...], np.dtype[np.bool_]]:
        """Return which pixels are an object's, (H, W) bool; none if it is not in this frame."""
        return np.asarray(self.labels == layer)

    def to_supervision(self) -> Detections:
        """Convert the objects to detections of the package supervision, for its annotators and tools.

        Returns
        -------
        supervision.Detections
            In ascending layer id: ``xyxy`` (n, 4) px, ``mask`` (n, H, W) bool, ``confidence`` (n,) the score,
            ``tracker_id`` (n,) the layer ids, ``class_id`` (n,) 0, for all that moves is of one class, and
            ``data["velocity"]`` (n, 2) px/frame.

        Raises
        ------
        MlbsError
            If the package is not installed.
        """
        try:
            import supervision
        except ImportError:
            raise MlbsError(
                "to_supervision needs the package supervision; pip install supervision."
            ) from None
        ids, xyxy = self.boxes()
        return supervision.Detections(
            xyxy=xyxy.astype(np.float32),
            mask=self.labels == ids[:, None, None],
            confidence=np.array([layer.score for layer in self.layers], np.float32),
            class_id=np.zeros(len(ids), np.int64),
            tracker_id=ids,
            data={"velocity": np.array([layer.velocity for layer in self.layers], np.float32).reshape(-1, 2)},
        )
