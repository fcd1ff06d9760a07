"""The internals of a stream at each labelled frame: trajectories, motion fields, posteriors.

Nothing here affects a label: it is read from the parts after the frame, or recomputed from their state.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mlbs_actors.appearance.fusion import LIKELIHOOD, with_appearance
from mlbs_actors.cells import in_cells, spread_over_cells
from mlbs_actors.config import Config
from mlbs_actors.layer.layer import Layer
from mlbs_actors.messages import Array, FrameEvidence, LayerKind, LayerPosterior, Region, Segmentation
from mlbs_actors.motion_field.field import MotionField

__all__ = ["FrameInspection", "LayerInspection", "inspect_frame"]


@dataclass(frozen=True, slots=True)
class LayerInspection:
    """One layer at one frame.

    Attributes
    ----------
    layer : int
    kind : {"background", "object", "other"}
    positions : (n, 2) float32
        Where its trajectories are in this frame, px.
    motions : (n, 2) float32
        Their backward motions, px: ``positions + motions`` is where they were one frame earlier.
    home : Region
        Where it has a motion field: the frame for the background, else ``region``.
    motion_field : MotionField
        On ``home``.
    region : Region
        Where it was evaluated.
    posterior : (region.height, region.width) float32
        How likely a pixel was this layer's before the graph cut, in [0, 1]; constant in a cell. Over the
        layers that were evaluated at a pixel they sum to 1, up to the quantisation of the costs; outside all
        objects' regions the background's is 1.
    """

    layer: int
    kind: LayerKind
    positions: Array
    motions: Array
    home: Region
    motion_field: MotionField
    region: Region
    posterior: Array


@dataclass(frozen=True, slots=True)
class FrameInspection:
    """One frame.

    Attributes
    ----------
    frame_index : int
        As in :class:`~mlbs_actors.messages.Segmentation`.
    shape : (H, W)
        px.
    camera : (3, 3) float64
        Homography that takes homogeneous pixels of this frame to where they were one frame earlier if they
        belong to the background.
    layers : tuple of LayerInspection
        In ascending id, the background first.
    """

    frame_index: int
    shape: tuple[int, int]
    camera: Array
    layers: tuple[LayerInspection, ...]


def inspect_frame(
    config: Config,
    evidence: FrameEvidence,
    layers: Mapping[int, Layer],
    posteriors: Sequence[LayerPosterior],
    segmentation: Segmentation,
) -> FrameInspection:
    """Collect the internals of a stream's parts.

    Parameters
    ----------
    evidence : FrameEvidence
        Of the frame that was labelled last.
    layers : mapping of int to Layer
        Its live layers by id, right after that frame.
    posteriors : sequence of LayerPosterior
        What they returned, in the order of ``evidence.layers``.
    segmentation : Segmentation
        Its result.
    """
    inspected = []
    for one, posterior in zip(evidence.layers, posteriors, strict=True):
        layer = layers[one.layer]
        home = layer.state.home
        assert layer.field is not None  # it has just done that frame
        inspected.append(
            LayerInspection(
                layer=one.layer,
                kind=one.kind,
                positions=one.positions,
                motions=one.motions,
                home=home,
                motion_field=layer.field,
                region=posterior.region,
                posterior=_normalised(config, posterior, segmentation),
            )
        )
    return FrameInspection(evidence.frame_index, evidence.shape, evidence.camera, tuple(inspected))


def _normalised(config: Config, one: LayerPosterior, segmentation: Segmentation) -> Array:
    cells = in_cells(one.region, one.cell)
    fused = with_appearance(
        one.cost,
        one.log_ratio,
        one.samples,
        np.ascontiguousarray(segmentation.fallback[cells.slices]),
        config.posterior.appearance,
        config.appearance.half_confidence_samples,
    )
    normaliser = segmentation.normaliser[cells.slices]
    above = np.where(fused > normaliser, fused - normaliser, np.uint8(0))
    shape = (one.region.height, one.region.width)
    return np.asarray(LIKELIHOOD[spread_over_cells(above, one.cell, shape)])
