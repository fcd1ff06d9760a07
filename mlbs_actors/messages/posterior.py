"""What a layer answers: its posterior of a frame for the segmenter, its colours for the sink."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from mlbs_actors.messages.terms import Array, LayerKind, Region
from mlbs_actors.pickling import pickled_by_values

__all__ = ["COST_STEP", "LayerAppearance", "LayerPosterior"]

#: Quantum of ``LayerPosterior.cost`` and ``Segmentation.normaliser``, nats.
COST_STEP = 1.0 / 16.0


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
