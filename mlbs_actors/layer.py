"""One layer: motion field, prediction, likelihood, posterior, update — the "processing block" (§5, §6).

:meth:`Layer.step` is called once a frame: it finishes frame t−1 with the published labels, then predicts and
evaluates frame t. The layer works on the region of its object (:mod:`mlbs_actors.object_regions`). The
background's is the frame: it moves and learns all of it, but is evaluated only where an object can be.
Elsewhere its cost is the offset of all costs, its colours say nothing and have no samples.

The negative logarithm of a pixel's unnormalised posterior is a weighted sum of five terms (weights in
:class:`~mlbs_actors.config.PosteriorConfig`, nats), cut to 0 … 15.9:

* appearance: the kernel density of the pixel's colour, sent apart from the others, because what a layer does
  not know is judged by what the others know (:mod:`mlbs_actors.fusion`).
* motion, −log(ε + (1 − ε) exp(−½ d²)): d² the squared distance of the dense flow from the layer's motion
  field in units of the field's marginal variance plus the flow's own; 0 where the flow is unreliable or
  where the camera's motion explains the image too.
* photometric, for an object: by how much its own motion explains the image better than the camera's
  (:mod:`mlbs_actors.photometric`). It says nothing where the image is smooth.
* away, for an object: 0 near its own trajectories and in the gaps between them, rising to 1 further off.
* prior, −log of the last posterior warped by the layer's own motion, of which the published map is half:
  neutral (0.5 by default) in a new-born layer and where the source is outside the layer's old region, at
  least 0.1 for an object and 0.5 for the background.

Outside its region an object costs 15.9 nats. A layer learns only where its label is sure
(:mod:`mlbs_actors.learning`).

Differs from the paper: the motion, photometric and away terms are not in it; the prior has a floor, so that
it can be overruled, and a layer is weighed by its own confidence, pixel by pixel (the authors' program makes
*all* layers uniform where one has few samples, and never uses its prior); no layer but the background is
evaluated on the whole frame, and it only where it has a rival. A layer that wakes after a sleep
keeps its id, not its samples: only its place is known, not the path of its pixels.
"""

from __future__ import annotations

from dataclasses import dataclass
from time import perf_counter

import cv2
import numpy as np

from mlbs_actors.appearance import AppearanceModel, empty_model, median_colours, update
from mlbs_actors.cells import cells_won, in_cells, spread_over_cells
from mlbs_actors.config import Config
from mlbs_actors.errors import LayerError
from mlbs_actors.fusion import LIKELIHOOD, appearance_tables
from mlbs_actors.gabp import MotionField, MotionParameters, motion_field
from mlbs_actors.layer_cost import finished_posterior
from mlbs_actors.layer_view import LastFrame, LayerView
from mlbs_actors.messages import (
    COST_STEP,
    Array,
    FrameEvidence,
    LayerAppearance,
    LayerEvidence,
    LayerKind,
    LayerPosterior,
    Region,
    Segmentation,
)
from mlbs_actors.node_grid import node_positions
from mlbs_actors.object_frame import finished_object
from mlbs_actors.object_regions import box_of, contested, median_motion, object_region
from mlbs_actors.region_groups import slices_in

__all__ = ["Layer", "LayerState"]


@dataclass(slots=True)
class LayerState:
    """Everything that steers the layer's next frame.

    Attributes
    ----------
    last_frame : int
        Frame evaluated last, −1 before the first.
    home : Region
        Where it remembers colours: the frame for the background, else ``region``.
    region : Region
        Where it was evaluated.
    cell : int
        Side of the cells of which all these arrays are made, px.
    model : AppearanceModel
        Samples at ``last_frame``, without that frame's own colours, cell by cell of ``home``.
    cost : (rows, columns) uint8
        Unnormalised posterior of ``last_frame`` without the colours, as sent to the segmenter.
    log_ratio : (rows, columns) int8
    samples : (rows, columns) uint8
        What the colours said, as sent to the segmenter.
    image : (home's rows, home's columns, 3) uint8
        Mean colours of that frame, to learn from once its labels are known.
    velocity : (2,) float32
        Median forward motion of the layer's trajectories, px/frame.
    trusted : bool
        Cells of ``home`` in which the layer may learn that frame.
    """

    last_frame: int
    home: Region
    region: Region
    cell: int
    model: AppearanceModel
    cost: Array
    log_ratio: Array
    samples: Array
    image: Array
    velocity: Array
    trusted: Array


class Layer:
    """One layer of one stream.

    Parameters
    ----------
    config : Config
    layer : int
        Its id.
    kind : {"background", "object", "other"}
    state : LayerState, optional
        To go on from a snapshot; new-born by default.
    """

    def __init__(self, config: Config, layer: int, kind: LayerKind, state: LayerState | None = None) -> None:
        self.config = config
        self.layer = layer
        self.kind = kind
        nowhere = Region(0, 0, 0, 0)
        self.state = state or LayerState(
            last_frame=-1,
            home=nowhere,
            region=nowhere,
            cell=1,
            model=empty_model(nowhere, config.appearance.samples),
            cost=np.zeros((0, 0), np.uint8),
            log_ratio=np.zeros((0, 0), np.int8),
            samples=np.zeros((0, 0), np.uint8),
            image=np.zeros((0, 0, 3), np.uint8),
            velocity=np.zeros(2, np.float32),
            trusted=np.zeros((0, 0), bool),
        )
        self._motion = MotionParameters(
            spacing_px=config.motion.grid_px,
            variance_spacing_px=config.motion.variance_grid_px,
            smoothness_std_px=config.motion.smoothness_std_px,
            point_std_px=config.motion.point_std_px,
            prior_std_px=config.motion.prior_std_px,
            robust_px=config.motion.robust_px,
        )
        self._view: LayerView | None = None

    def step(
        self,
        evidence: LayerEvidence,
        frame_evidence: FrameEvidence,
        frame: Array,
        previous: Segmentation | None,
    ) -> LayerPosterior:
        """Finish frame t−1, then predict and evaluate frame t.

        Parameters
        ----------
        evidence : LayerEvidence
            This layer's trajectories at t.
        frame_evidence : FrameEvidence
            Of the same frame: camera and dense flow.
        frame : (H, W, 3) uint8
        previous : Segmentation or None
            Published result of t−1; None for the first frame. Of another epoch it does not count.

        Returns
        -------
        LayerPosterior

        Raises
        ------
        LayerError
            If the evidence is another layer's, or not the next one for this layer.
        """
        state = self.state
        if evidence.layer != self.layer or evidence.last_frame != state.last_frame:
            raise LayerError(
                f"Layer {self.layer} stands at frame {state.last_frame} but was given evidence of layer "
                f"{evidence.layer} that goes on from frame {evidence.last_frame}; "
                "restart the stream from its last snapshot."
            )
        start = perf_counter()
        if frame_evidence.frame_index == frame_evidence.epoch:
            previous = None
        posterior = self._finish(previous)
        finished = perf_counter()
        view = self._view
        if view is None or view.shape != frame_evidence.shape:
            view = self._view = LayerView(self.config, self.kind, frame_evidence.shape)
        side, weights = view.side, self.config.posterior
        margins = (weights.region_margin_px, weights.covered_margin_px)
        last = LastFrame(state.region, state.model, state.image, posterior)
        if self.kind == "background":
            home = Region(0, 0, frame.shape[1], frame.shape[0])
            region, needed = contested(frame_evidence, previous, margins, side)
            field = self.motion_field(evidence, frame_evidence, home)
            moved = perf_counter()
            seen = view.of_background(frame, evidence, frame_evidence, last, region, needed, field)
        else:
            home = region = object_region(evidence, previous, frame_evidence.shape, margins, side)
            field = self.motion_field(evidence, frame_evidence, home)
            moved = perf_counter()
            seen = view.of_object(frame, evidence, frame_evidence, last, region, field)
        evaluated = perf_counter()

        velocity = state.velocity
        if len(evidence.motions):
            velocity = -np.array(median_motion(evidence.motions), np.float32)
        self.state = LayerState(
            last_frame=frame_evidence.frame_index,
            home=home,
            region=region,
            cell=side,
            model=seen.model,
            cost=seen.cost,
            log_ratio=seen.log_ratio,
            samples=seen.samples,
            image=seen.image,
            velocity=velocity,
            trusted=seen.trusted,
        )
        return LayerPosterior(
            layer=self.layer,
            frame_index=frame_evidence.frame_index,
            kind=self.kind,
            region=region,
            cell=side,
            cost=seen.cost,
            log_ratio=seen.log_ratio,
            samples=seen.samples,
            outside_cost=255,
            confidence=seen.confidence,
            velocity=velocity,
            stage_ms={
                "update": 1e3 * (finished - start),
                "gabp": 1e3 * (moved - finished),
                "posterior": 1e3 * (evaluated - moved),
            },
        )

    def appearance(self) -> LayerAppearance:
        """What is remembered at the frame evaluated last; nothing is changed."""
        state = self.state
        shape = (state.home.height, state.home.width)
        colours = spread_over_cells(median_colours(state.model), state.cell, shape)
        known = spread_over_cells(state.model.count > 0, state.cell, shape)
        return LayerAppearance(self.layer, state.last_frame, state.home, colours, known)

    def motion_field(
        self, evidence: LayerEvidence, frame_evidence: FrameEvidence, region: Region
    ) -> MotionField:
        """Infer how the layer moves on a region; nothing is changed.

        Where no trajectory tells, it is the camera's motion, an object's the median of its trajectories.

        Parameters
        ----------
        evidence : LayerEvidence
            Of the frame that :meth:`step` takes or has just taken; both give the same field.
        frame_evidence : FrameEvidence
        region : Region

        Returns
        -------
        MotionField
        """
        shape = (region.height, region.width)
        prior: Array = np.zeros(2)
        if self.kind == "background" and region.area:
            nodes = node_positions(shape, self._motion.spacing_px).astype(np.float64)
            prior = cv2.perspectiveTransform(nodes, frame_evidence.camera) - nodes
        elif len(evidence.motions):
            prior = np.array(median_motion(evidence.motions))
        elif region.area:
            prior = -self.state.velocity
        corner = (region.x, region.y)
        return motion_field(evidence.positions, evidence.motions, shape, prior, self._motion, corner)

    def _finish(self, previous: Segmentation | None) -> Array:
        """Learn frame t−1; return this layer's normalised posterior of it, empty if it had no part in it."""
        state = self.state
        if previous is None or previous.frame_index != state.last_frame:
            return np.zeros((0, 0), np.float32)
        if self.kind != "background":
            return np.asarray(
                finished_object(
                    previous.labels,
                    previous.normaliser,
                    previous.fallback,
                    np.uint16(self.layer),
                    box_of(state.region),
                    state.cell,
                    state.model.arrays,
                    state.image,
                    state.trusted,
                    state.cost,
                    state.log_ratio,
                    state.samples,
                    *appearance_tables(self.config.appearance.half_confidence_samples),
                    np.float32(self.config.posterior.appearance / COST_STEP),
                    LIKELIHOOD,
                )
            )
        won, learnt = cells_won(previous.labels, self.layer, state.home, state.cell, state.trusted)
        update(state.model, state.image, learnt)
        cells, home = in_cells(state.region, state.cell), in_cells(state.home, state.cell)
        own = np.ascontiguousarray(won[slices_in(cells, home)])
        return finished_posterior(
            self.config, state.cost, state.log_ratio, state.samples, previous, cells, own
        )
