"""One layer: motion field, prediction, likelihood, posterior, update — the "processing block" (§5, §6).

:meth:`Layer.step` is called once a frame: it finishes frame t−1 with the published labels, then predicts and
evaluates frame t. The layer works on the region of its object (:mod:`mlbs_actors.layer.object_regions`). The
background's is the frame: it moves and learns all of it, but is evaluated only where an object can be.
Elsewhere its cost is the offset of all costs, and its colours have no samples.

The negative logarithm of a pixel's unnormalised posterior is a weighted sum of five terms (weights in
:class:`~mlbs_actors.config.PosteriorConfig`, nats), cut to 0 … 15.9:

* appearance: the kernel density of the pixel's colour, sent apart from the others, because colours that a
  layer does not know are judged by the layers that do (:mod:`mlbs_actors.appearance.fusion`).
* motion, −log(ε + (1 − ε) exp(−½ d²)): d² the squared distance of the dense flow from the layer's motion
  field in units of the field's marginal variance plus the flow's own; 0 where the flow is unreliable or
  where the camera's motion explains the image too.
* photometric, for an object: by how much its own motion explains the image better than the camera's
  (:mod:`mlbs_actors.layer.photometric`); 0 where the image is smooth.
* away, for an object: 0 near its own trajectories and in the gaps between them, rising to 1 further off.
* prior, −log of the last posterior (see :func:`~mlbs_actors.layer.posterior_terms.finished_posterior`) warped
  by the layer's own motion: neutral (0.5 by default) in a new-born layer and where the source is outside the
  layer's old region, at least 0.1 for an object and 0.5 for the background.

Outside its region an object costs 15.9 nats. A layer learns only where its label is sure
(:mod:`mlbs_actors.layer.learning`).

Differs from the paper: the motion, photometric and away terms are not in it; the prior has a floor, so that
it can be overruled, and a layer is weighted by its own confidence, pixel by pixel (the authors' program makes
*all* layers uniform where one has few samples, and never uses its prior); no layer but the background is
evaluated on the whole frame, and the background only where it has a rival. A layer that wakes keeps its id,
not its samples: only its place is known, not the path of its pixels.
"""

from __future__ import annotations

from dataclasses import replace
from time import perf_counter
from typing import NamedTuple

import cv2
import numpy as np

from mlbs_actors.appearance.colour_density import AppearanceParameters, mean_confidence, warp_and_evaluate
from mlbs_actors.appearance.colour_model import empty_model, median_colours, relight, update
from mlbs_actors.appearance.own_appearance import Appearance, asked
from mlbs_actors.appearance.warp import warp_map
from mlbs_actors.cells import cell_side, cells_won, in_cells, spread_over_cells
from mlbs_actors.config import Config
from mlbs_actors.errors import LayerError
from mlbs_actors.footage.light import relit
from mlbs_actors.geometry.boxes import slices_in
from mlbs_actors.layer.layer_state import LayerState
from mlbs_actors.layer.learning import object_support, trusted_background
from mlbs_actors.layer.object_regions import contested, median_of_motions, object_region
from mlbs_actors.layer.photometric import PhotometricRules, photometric_advantage
from mlbs_actors.layer.posterior_terms import (
    Prediction,
    finished_posterior,
    posterior_cost,
    quantised_colours,
)
from mlbs_actors.messages import (
    Array,
    FrameEvidence,
    LayerAppearance,
    LayerEvidence,
    LayerKind,
    LayerPosterior,
    Region,
    Segmentation,
)
from mlbs_actors.motion_field.field import MotionField, MotionParameters, motion_field
from mlbs_actors.motion_field.node_grid import node_positions

__all__ = ["OUTSIDE_COST", "Layer"]

#: Cost of an object outside its region, units of ``COST_STEP``.
OUTSIDE_COST = 255


class _Places(NamedTuple):
    """Where a layer works in a frame.

    Attributes
    ----------
    side : int
        Of a cell, px.
    home : Region
        Where it has motion and samples: the frame for the background, else ``region``.
    region : Region
        Where it is evaluated.
    needed : (h, w) bool
        Cells of the region to evaluate.
    """

    side: int
    home: Region
    region: Region
    needed: Array


class Layer:
    """One layer of one stream.

    Parameters
    ----------
    layer : int
        Its id.
    kind : {"background", "object", "other"}
    state : LayerState, optional
        To continue from a snapshot; new-born by default.
    own : Appearance, optional
        The caller's model of its colours, in place of the samples in the state, of which there are none then.

    Attributes
    ----------
    own : Appearance or None
    field : MotionField or None
        Its motion in the last frame.
    """

    def __init__(
        self,
        config: Config,
        layer: int,
        kind: LayerKind,
        state: LayerState | None = None,
        own: Appearance | None = None,
    ) -> None:
        self.config = config
        self.own = own
        self.layer = layer
        self.kind = kind
        self.state = state or LayerState.beginning(config.appearance.samples)
        self.field: MotionField | None = None

    def step(self, evidence: FrameEvidence, previous: Segmentation | None) -> LayerPosterior:
        """Finish frame t−1, then predict and evaluate frame t.

        Parameters
        ----------
        evidence : FrameEvidence
            Of frame t.
        previous : Segmentation or None
            Published result of t−1; None for the first frame. One of another epoch is ignored.

        Returns
        -------
        LayerPosterior

        Raises
        ------
        LayerError
            If the layer is not live in the frame, or another frame is its next one.
        """
        own = evidence.of(self.layer)
        if own.last_frame != self.state.last_frame:
            raise LayerError(
                f"Layer {self.layer} stands at frame {self.state.last_frame} but was given evidence that "
                f"goes on from frame {own.last_frame}; restart the stream from its last snapshot."
            )
        if evidence.frame_index == evidence.epoch:
            previous = None
        started = perf_counter()
        last_posterior = self._learn(previous)
        self.state = _relit(self.state, evidence.light)
        learnt = perf_counter()
        places = self._places(own, evidence, previous)
        self.field = self._motion_field(own, evidence, places.home)
        moved = perf_counter()
        self.state = self._predict_and_evaluate(own, evidence, places, self.field, last_posterior)
        stage_ms = {
            "update": 1e3 * (learnt - started),
            "gabp": 1e3 * (moved - learnt),
            "posterior": 1e3 * (perf_counter() - moved),
        }
        return self._posterior(stage_ms)

    def appearance(self) -> LayerAppearance:
        """Return the remembered colours at the frame evaluated last, without changing anything."""
        state = self.state
        shape = (state.home.height, state.home.width)
        colours = spread_over_cells(median_colours(state.model), state.cell, shape)
        known = spread_over_cells(state.model.count > 0, state.cell, shape)
        return LayerAppearance(self.layer, state.last_frame, state.home, colours, known)

    @property
    def _is_background(self) -> bool:
        return self.kind == "background"

    def _learn(self, previous: Segmentation | None) -> Array:
        """Learn the colours that the layer won in frame t−1.

        Returns
        -------
        (h, w) float32
            The layer's normalised posterior of that frame on its region, in [0, 1]; empty if the layer was
            not live in it.
        """
        state = self.state
        if previous is None or previous.evaluated_frame != state.last_frame:
            return np.zeros((0, 0), np.float32)
        won, learnt = cells_won(previous.labels, self.layer, state.home, state.cell, state.trusted)
        cells, home = in_cells(state.region, state.cell), in_cells(state.home, state.cell)
        if self.own is None:
            update(state.model, state.image, learnt)
        else:
            self.own.update(state.image, learnt, home)
        own = np.ascontiguousarray(won[slices_in(cells, home)])
        return finished_posterior(
            self.config, (state.cost, state.log_ratio, state.samples), previous, cells, own
        )

    def _places(self, own: LayerEvidence, evidence: FrameEvidence, previous: Segmentation | None) -> _Places:
        weights, side = self.config.posterior, self._side(evidence.shape)
        margins = (weights.region_margin_px, weights.covered_margin_px, weights.covered_px)
        if self._is_background:
            region, needed = contested(evidence, previous, margins, side)
            height, width = evidence.shape
            return _Places(side, Region(0, 0, width, height), region, needed)
        region = object_region(own, evidence.shape, previous, margins, side)
        cells = in_cells(region, side)
        return _Places(side, region, region, np.ones((cells.height, cells.width), np.bool_))

    def _motion_field(self, own: LayerEvidence, evidence: FrameEvidence, home: Region) -> MotionField:
        """Infer how the layer moves; without trajectories the background moves as the camera does, and
        an object by the median of its trajectories, or as before."""
        parameters = MotionParameters.configured(self.config, evidence.shape, self._side(evidence.shape))
        shape, corner = (home.height, home.width), (home.x, home.y)
        if self._is_background:
            nodes = node_positions(shape, parameters.spacing_px).astype(np.float64)
            prior: Array = cv2.perspectiveTransform(nodes, evidence.camera) - nodes
        else:
            prior = _median_motion(own, -self.state.velocity)
        return motion_field(own.positions, own.motions, shape, prior, parameters, corner)

    def _predict_and_evaluate(
        self,
        own: LayerEvidence,
        evidence: FrameEvidence,
        places: _Places,
        field: MotionField,
        last_posterior: Array,
    ) -> LayerState:
        config, state = self.config, self.state
        side, home, region, needed = places
        cells, home_cells = in_cells(region, side), in_cells(home, side)
        part = slices_in(cells, home_cells)
        motions = field.dense(side) * np.float32(1.0 / side)  # in cells
        motion = np.ascontiguousarray(motions[part])
        image = evidence.colours[home_cells.slices].copy()

        carried, carried_in_region = motions, motion
        if not config.appearance.warp:
            carried, carried_in_region = np.zeros_like(motions), np.zeros_like(motion)
        # The appearance moves along and is compared with the frame's colours;
        if self.own is None:
            opened = np.zeros(image.shape[:2], np.bool_)
            opened[part] = needed
            density = AppearanceParameters.configured(config, self.kind, side)
            model, log_density = warp_and_evaluate(state.model, home_cells, carried, image, density, opened)
            log_density = np.ascontiguousarray(log_density[part])
            known = np.ascontiguousarray(model.count[part])
        else:
            model = empty_model(home_cells, 1)
            log_density, known = asked(
                self.own, image[part], cells, carried_in_region, config.appearance.samples
            )
        log_ratio, samples = quantised_colours(log_density, known, needed, config.posterior.appearance_cap)
        # so does the last posterior, which is the prior.
        before = in_cells(state.region, state.cell)
        prior = warp_map(last_posterior, before, cells, carried_in_region, needed)

        if self._is_background:
            trusted = trusted_background(config, own, evidence, side)
            away = advantage = np.zeros(needed.shape, np.float32)
        else:
            trusted, away = object_support(config, evidence, evidence.tracks_of(self.layer), cells, side)
            advantage = photometric_advantage(
                state.image,
                image,
                motion,
                evidence.camera,
                side,
                ((cells.x, cells.y), (before.x, before.y)),
                prior[0] >= np.float32(0.5),
                PhotometricRules.configured(config.posterior),
            )
        if evidence.fixed.size:
            trusted &= ~evidence.fixed[home_cells.slices]
        variance = np.ascontiguousarray(field.dense_variance(side)[part])
        prediction = Prediction(cells, side, needed, motion, variance, prior, away, advantage)
        cost = posterior_cost(config, self.kind, evidence, prediction)
        if evidence.fixed.size and not self._is_background:
            cost[evidence.fixed[cells.slices]] = OUTSIDE_COST
        return LayerState(
            last_frame=evidence.frame_index,
            home=home,
            region=region,
            cell=side,
            model=model,
            cost=cost,
            log_ratio=log_ratio,
            samples=samples,
            image=image,
            velocity=-_median_motion(own, -state.velocity).astype(np.float32),
            trusted=trusted,
        )

    def _side(self, shape: tuple[int, int]) -> int:
        return cell_side(shape, self.config.grid.cell_px)

    def _posterior(self, stage_ms: dict[str, float]) -> LayerPosterior:
        state = self.state
        density = AppearanceParameters.configured(self.config, self.kind, state.cell)
        samples = state.model.count if self.own is None else state.samples
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
            confidence=mean_confidence(samples, density),
            velocity=state.velocity,
            stage_ms=stage_ms,
        )


def _relit(state: LayerState, light: Array) -> LayerState:
    """Give what a layer remembers the light of the new frame."""
    if not light.size:
        return state
    relight(state.model, light)
    return replace(state, image=relit(state.image, light))


def _median_motion(own: LayerEvidence, otherwise: Array) -> Array:
    """Return the median of a layer's backward motions, (2,) px; a default where it has no trajectories."""
    return np.array(median_of_motions(own.motions)) if len(own.motions) else otherwise
