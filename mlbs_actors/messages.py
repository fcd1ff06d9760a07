"""Messages between the parts of one stream: typed, array-valued, the same in one process and over Ray.

The way of a frame::

    frame ─► Coordinator.step ─► FrameEvidence ─► Layer.step (one a layer) ─► LayerPosterior
                   ▲                                   ▲                          │
                   │ segmentations up to t−2           │ segmentation of t−1      ▼
                   └───────────────────────────────────┴──── Segmentation ◄─ Segmenter.step

Conventions: images are (H, W, 3) uint8 BGR; a pixel is (x right, y down); frame indices count from 0; a
*motion* is backward: the displacement of a point of frame t to where it was in frame t−1, in px. A layer's id
is never reused; id 0 is the background.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypeVar

import numpy as np

from mlbs_actors.errors import LayerError, MlbsError
from mlbs_actors.pickling import pickled_by_values

if TYPE_CHECKING:
    from supervision import Detections

__all__ = [
    "BACKGROUND",
    "NO_PICTURE",
    "Array",
    "Boxes",
    "FrameEvidence",
    "FrameStatus",
    "LayerAppearance",
    "LayerEvidence",
    "LayerKind",
    "LayerPosterior",
    "LayerSummary",
    "LayerTracks",
    "Region",
    "Segmentation",
    "readonly",
]

# Not npt.NDArray: since NumPy 2.5 that alias hides its class, and states are checked by class.
Array = np.ndarray[tuple[Any, ...], np.dtype[Any]]
LayerKind = Literal["background", "object", "other"]
#: Whether an object has moved against the camera lately.
ObjectState = Literal["moving", "resting"]

#: What a frame with a label map shows: the scene, the first picture of another one (``"cut"``), or too little
#: to tell the camera's motion (``"untracked"``): layers go on there, but none begins. The
#: others are no picture of it: they are of one brightness, repeat the last picture, are lit up for a moment,
#: or do not fit between the pictures before and after. They carry the labels of the last picture, and nothing
#: is learnt from them.
FrameStatus = Literal["ok", "cut", "untracked", "blank", "repeated", "flash", "damaged"]

#: Those from which nothing is learnt.
NO_PICTURE: frozenset[FrameStatus] = frozenset(("blank", "repeated", "flash", "damaged"))

#: Id of the background layer.
BACKGROUND = 0


@pickled_by_values
@dataclass(frozen=True, slots=True)
class Region:
    """A half-open rectangle of pixels: columns x … x+width−1, rows y … y+height−1."""

    x: int
    y: int
    width: int
    height: int

    @property
    def slices(self) -> tuple[slice, slice]:
        """Row and column slices that cut this region out of a full-frame array."""
        return slice(self.y, self.y + self.height), slice(self.x, self.x + self.width)

    @property
    def box(self) -> tuple[int, int, int, int]:
        """Left, top, width and height, for compiled functions."""
        return self.x, self.y, self.width, self.height

    @property
    def area(self) -> int:
        """Number of pixels."""
        return self.width * self.height


@dataclass(frozen=True, slots=True)
class LayerEvidence:
    """The trajectories of one layer at one frame (coordinator → layer).

    Attributes
    ----------
    layer : int
        Layer id.
    kind : {"background", "object", "other"}
    last_frame : int
        Frame at which this layer was last evaluated, −1 for a new-born layer. The layer refuses
        evidence whose ``last_frame`` is not its own.
    positions : (n, 2) float32
        Sub-pixel positions at frame t, px.
    motions : (n, 2) float32
        Backward motions t → t−1, px.
    """

    layer: int
    kind: LayerKind
    last_frame: int
    positions: Array
    motions: Array


class LayerTracks(NamedTuple):
    """Which of a frame's trajectories are a layer's: those from ``start`` to ``end``.

    ``layer``, ``kind`` and ``last_frame`` are those of :class:`LayerEvidence`.
    """

    layer: int
    kind: LayerKind
    last_frame: int
    start: int
    end: int


@pickled_by_values
@dataclass(frozen=True, slots=True)
class FrameEvidence:
    """The coordinator's results for one frame (coordinator → layers, segmenter).

    Attributes
    ----------
    frame_index : int
    shape : (H, W)
        Size of the frame, px.
    camera : (3, 3) float64
        Homography that takes homogeneous pixels of frame t to where they were in frame t−1 if they
        belong to the background.
    flow : (h, w, 2) float32
        Dense backward flow t → t−1 of the frame's cells (:mod:`mlbs_actors.cells`), px. Zeros for frame 0.
    flow_reliable : (h, w) bool
        Where forward and backward flow agree.
    unexplained : (h, w) uint8
        How badly the camera's own motion explains the image, in units of ``UNEXPLAINED_STEP`` times the
        frame's noise; 0 for frame 0.
    colours : (h, w, 3) uint8
        Mean colours of the frame's cells, BGR.
    tracks : tuple of LayerTracks
        The live layers in ascending id; the background (id 0) is always first.
    positions, motions : (n, 2) float32
        Those of all layers' trajectories (:class:`LayerEvidence`), layer after layer.
    retired : tuple of int
        Layers whose models end before this frame: those that were live in the last frame and are not in this
        one (asleep or ended), and at the start of an epoch all, the background's too. Their processes are
        free; a layer that wakes starts with a new model under its old id.
    latency_frames : int
        How many frames later than its own decoding this frame's evidence was complete.
    stage_ms : mapping of str to float
        Wall time of the coordinator's stages, ms.
    epoch : int
        First picture of this scene and size: nothing that came before it counts.
    status : FrameStatus
        Without a picture the frame has neither flow nor tracks.
    light : (3, 256) uint8
        What each value of blue, green and red has become since the last picture; (0, 256) if the light is
        the same (:mod:`mlbs_actors.footage.light`).
    fixed : (h, w) bool
        Cells that are fixed in the picture, not in the scene (:mod:`mlbs_actors.footage.fixed`); (0, 0) if
        there are none.
    resting : tuple of int
        Layers that have not moved against the camera for a while.
    apart : tuple of (int, int)
        Pairs of layers, the lower one first, that are two things however closely they touch.
    """

    frame_index: int
    shape: tuple[int, int]
    camera: Array
    flow: Array
    flow_reliable: Array
    unexplained: Array
    colours: Array
    tracks: tuple[LayerTracks, ...]
    positions: Array
    motions: Array
    retired: tuple[int, ...]
    latency_frames: int
    stage_ms: Mapping[str, float] = field(default_factory=dict)
    epoch: int = 0
    status: FrameStatus = "ok"
    light: Array = field(default_factory=lambda: np.zeros((0, 256), np.uint8))
    fixed: Array = field(default_factory=lambda: np.zeros((0, 0), bool))
    resting: tuple[int, ...] = ()
    apart: tuple[tuple[int, int], ...] = ()

    @property
    def layers(self) -> tuple[LayerEvidence, ...]:
        """Evidence of each of the live layers."""
        return tuple(map(self._evidence, self.tracks))

    def of(self, layer: int) -> LayerEvidence:
        """Return the evidence of one live layer; raises as :meth:`tracks_of` does."""
        return self._evidence(self.tracks_of(layer))

    def tracks_of(self, layer: int) -> LayerTracks:
        """Return which trajectories are one live layer's; raises LayerError if it is not live."""
        for one in self.tracks:
            if one.layer == layer:
                return one
        raise LayerError(
            f"Frame {self.frame_index} has no evidence of layer {layer}; "
            "restart the stream from its last snapshot."
        )

    def _evidence(self, tracks: LayerTracks) -> LayerEvidence:
        layer, kind, last_frame, start, end = tracks
        return LayerEvidence(layer, kind, last_frame, self.positions[start:end], self.motions[start:end])


@pickled_by_values
@dataclass(frozen=True, slots=True)
class LayerPosterior:
    """One layer's unnormalised posterior of one frame, quantised and cropped (layer → segmenter).

    Attributes
    ----------
    layer, frame_index : int
    kind : {"background", "object", "other"}
    region : Region
        Where the layer was evaluated; outside it the cost is ``outside_cost``.
    cell : int
        Side of the cells of the maps, px; the region begins and ends between them.
    cost : (⌈region.height / cell⌉, ⌈region.width / cell⌉) uint8
        −log(likelihood × prior) without the colours, in units of ``COST_STEP`` nats.
    log_ratio : int8, of the same shape
        log of the colours' density over the uniform one, in units of ``fusion.RATIO_STEP`` nats; 0 without
        samples.
    samples : uint8, of the same shape
        Colour samples behind it.
    outside_cost : int
        In units of ``COST_STEP``, too.
    confidence : float
        Mean certainty of the layer's own model over its region, in [0, 1].
    velocity : (2,) float32
        Mean motion t−1 → t of the layer's support (forward), px/frame.
    stage_ms : mapping of str to float
        Wall time of the layer's stages, ms.
    """

    layer: int
    frame_index: int
    kind: LayerKind
    region: Region
    cell: int
    cost: Array
    log_ratio: Array
    samples: Array
    outside_cost: int
    confidence: float
    velocity: Array
    stage_ms: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class LayerAppearance:
    """Colours that a layer remembers, at the frame it was evaluated last (layer → sink).

    Attributes
    ----------
    layer, frame_index : int
    region : Region
    colours : (region.height, region.width, 3) uint8
        BGR; medians of the remembered colours, without that frame's own.
    known : (region.height, region.width) bool
        Where there are samples.
    """

    layer: int
    frame_index: int
    region: Region
    colours: Array
    known: Array


#: Quantum of ``FrameEvidence.unexplained``, × the frame's noise.
UNEXPLAINED_STEP = 1.0 / 8.0

#: Quantum of ``LayerPosterior.cost`` and ``Segmentation.normaliser``, nats.
COST_STEP = 1.0 / 16.0


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

    ids: Array
    xyxy: Array


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
    labels: Array = field(repr=False)
    normaliser: Array = field(repr=False)
    fallback: Array = field(repr=False)
    layers: tuple[LayerSummary, ...]
    camera_motion: tuple[float, float]
    latency_frames: int
    stage_ms: Mapping[str, float] = field(default_factory=dict, repr=False)
    status: FrameStatus = "ok"
    picture_index: int | None = None
    camera: Array | None = field(default=None, repr=False)

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

    def mask(self, layer: int) -> Array:
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


Message = TypeVar("Message", FrameEvidence, LayerPosterior, Segmentation)


def readonly(message: Message) -> Message:
    """Return a message with read-only arrays.

    Arrays that arrive from another process are read-only. Within one process they are made so, too, as Numba
    compiles kernels separately for writable and read-only arrays.
    """
    views: dict[str, Any] = {}
    for one in fields(message):
        value = getattr(message, one.name)
        if isinstance(value, np.ndarray):
            views[one.name] = value.view()
            views[one.name].setflags(write=False)
    return replace(message, **views)
