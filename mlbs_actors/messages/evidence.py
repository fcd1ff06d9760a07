"""What the coordinator finds in a frame, for the layers and the segmenter."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from mlbs_actors.errors import LayerError
from mlbs_actors.messages.terms import Array, FrameStatus, LayerKind
from mlbs_actors.pickling import pickled_by_values

__all__ = ["UNEXPLAINED_STEP", "FrameEvidence", "LayerEvidence", "LayerTracks"]

#: Quantum of ``FrameEvidence.unexplained``, × the frame's noise.
UNEXPLAINED_STEP = 1.0 / 8.0


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
