"""One layer: motion field, prediction, likelihood, posterior, update — the "processing block" (§5, §6).

:meth:`Layer.step` is called once a frame: it finishes frame t−1 with the published labels, then predicts and
evaluates frame t. The layer works on the region of its object (:mod:`mlbs_actors.layer.object_regions`). The
background's is the frame: it moves and learns all of it, but is evaluated only where an object can be.
Elsewhere its cost is the offset of all costs, its colours say nothing and have no samples.

The negative logarithm of a pixel's unnormalised posterior is a weighted sum of five terms (weights in
:class:`~mlbs_actors.config.PosteriorConfig`, nats), cut to 0 … 15.9:

* appearance: the kernel density of the pixel's colour, sent apart from the others, because what a layer does
  not know is judged by what the others know (:mod:`mlbs_actors.appearance.fusion`).
* motion, −log(ε + (1 − ε) exp(−½ d²)): d² the squared distance of the dense flow from the layer's motion
  field in units of the field's marginal variance plus the flow's own; 0 where the flow is unreliable or
  where the camera's motion explains the image too.
* photometric, for an object: by how much its own motion explains the image better than the camera's
  (:mod:`mlbs_actors.layer.photometric`). It says nothing where the image is smooth.
* away, for an object: 0 near its own trajectories and in the gaps between them, rising to 1 further off.
* prior, −log of the last posterior warped by the layer's own motion, of which the published map is half:
  neutral (0.5 by default) in a new-born layer and where the source is outside the layer's old region, at
  least 0.1 for an object and 0.5 for the background.

Outside its region an object costs 15.9 nats. A layer learns only where its label is sure
(:mod:`mlbs_actors.layer.learning`).

Differs from the paper: the motion, photometric and away terms are not in it; the prior has a floor, so that
it can be overruled, and a layer is weighed by its own confidence, pixel by pixel (the authors' program makes
*all* layers uniform where one has few samples, and never uses its prior); no layer but the background is
evaluated on the whole frame, and it only where it has a rival. A layer that wakes after a sleep
keeps its id, not its samples: only its place is known, not the path of its pixels.
"""

from __future__ import annotations

import numpy as np

from mlbs_actors.appearance.cells import spread_over_cells
from mlbs_actors.appearance.colour_model import median_colours
from mlbs_actors.config import Config
from mlbs_actors.errors import LayerError
from mlbs_actors.layer.background_frame import BackgroundView, background_field
from mlbs_actors.layer.layer_state import LayerState
from mlbs_actors.layer.object_frame import ObjectView
from mlbs_actors.layer.object_regions import median_of_motions
from mlbs_actors.messages import (
    Array,
    FrameEvidence,
    LayerAppearance,
    LayerEvidence,
    LayerKind,
    LayerPosterior,
    Segmentation,
)
from mlbs_actors.motion_field.field import MotionField, MotionParameters, motion_field

__all__ = ["OUTSIDE_COST", "Layer"]

#: What an object costs outside its region, units of ``COST_STEP``.
OUTSIDE_COST = 255


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

    Attributes
    ----------
    view : BackgroundView or ObjectView or None
        How it has seen the last frame.
    """

    def __init__(self, config: Config, layer: int, kind: LayerKind, state: LayerState | None = None) -> None:
        self.config = config
        self.layer = layer
        self.kind = kind
        self.state = state or LayerState.beginning(config.appearance.samples)
        self.view: BackgroundView | ObjectView | None = None

    def step(self, evidence: FrameEvidence, frame: Array, previous: Segmentation | None) -> LayerPosterior:
        """Finish frame t−1, then predict and evaluate frame t.

        Parameters
        ----------
        evidence : FrameEvidence
            Of frame t.
        frame : (H, W, 3) uint8
        previous : Segmentation or None
            Published result of t−1; None for the first frame. Of another epoch it does not count.

        Returns
        -------
        LayerPosterior

        Raises
        ------
        LayerError
            If the layer has no part in the frame, or another frame is its next one.
        """
        own, state = evidence.tracks_of(self.layer), self.state
        if own.last_frame != state.last_frame:
            raise LayerError(
                f"Layer {self.layer} stands at frame {state.last_frame} but was given evidence that goes on "
                f"from frame {own.last_frame}; restart the stream from its last snapshot."
            )
        if evidence.frame_index == evidence.epoch:
            previous = None
        view, shape = self.view, evidence.shape
        if view is None or view.shape != shape:
            background = self.kind == "background"
            view = (
                BackgroundView(self.config, shape)
                if background
                else ObjectView(self.config, self.layer, shape)
            )
            self.view = view
        self.state, confidence, stage_ms = view.next(state, evidence, frame, previous)
        return self.posterior(confidence, stage_ms)

    def posterior(self, confidence: float, stage_ms: dict[str, float]) -> LayerPosterior:
        """What the segmenter is told of the frame evaluated last."""
        state = self.state
        return LayerPosterior(
            layer=self.layer,
            frame_index=state.last_frame,
            kind=self.kind,
            region=state.region,
            cell=state.cell,
            cost=state.cost,
            log_ratio=state.log_ratio,
            samples=state.samples,
            outside_cost=OUTSIDE_COST,
            confidence=confidence,
            velocity=state.velocity,
            stage_ms=stage_ms,
        )

    def appearance(self) -> LayerAppearance:
        """What is remembered at the frame evaluated last; nothing is changed."""
        state = self.state
        shape = (state.home.height, state.home.width)
        colours = spread_over_cells(median_colours(state.model), state.cell, shape)
        known = spread_over_cells(state.model.count > 0, state.cell, shape)
        return LayerAppearance(self.layer, state.last_frame, state.home, colours, known)

    def motion_field(self, evidence: LayerEvidence, frame_evidence: FrameEvidence) -> MotionField:
        """How the layer moves on its home, as the step inferred it; nothing is changed.

        Parameters
        ----------
        evidence : LayerEvidence
            Of the frame that :meth:`step` has just taken.
        frame_evidence : FrameEvidence

        Returns
        -------
        MotionField
        """
        parameters, home = MotionParameters.configured(self.config), self.state.home
        if self.kind == "background":
            return background_field(evidence, frame_evidence, parameters)
        # Where no trajectory tells, it is the median of all, or as before.
        motions = evidence.motions
        prior: Array = np.array(median_of_motions(motions)) if len(motions) else -self.state.velocity
        shape, corner = (home.height, home.width), (home.x, home.y)
        return motion_field(evidence.positions, motions, shape, prior, parameters, corner)
