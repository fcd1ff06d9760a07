"""One frame of the background: what it learns of the last one, and how it sees the new.

It moves and remembers the whole frame, but is evaluated only where an object can be. What the terms are, and
how they differ from the paper's, is said in :mod:`mlbs_actors.layer.layer`.
"""

from __future__ import annotations

from time import perf_counter

import cv2
import numpy as np

from mlbs_actors.appearance.cells import cell_side, cells_won, in_cells, mean_of_cells
from mlbs_actors.appearance.colour_density import (
    AppearanceParameters,
    confidence,
    mean_trust,
    warp_and_evaluate,
)
from mlbs_actors.appearance.colour_model import update
from mlbs_actors.appearance.warp import warp_map
from mlbs_actors.config import Config
from mlbs_actors.layer.layer_state import LayerFrame, LayerState
from mlbs_actors.layer.learning import trusted_background
from mlbs_actors.layer.object_regions import contested, median_of_motions
from mlbs_actors.layer.posterior_terms import finished_posterior, layer_cost, quantised_colours
from mlbs_actors.messages import BACKGROUND, Array, FrameEvidence, LayerEvidence, Region, Segmentation
from mlbs_actors.motion_field.field import MotionField, MotionParameters, motion_field
from mlbs_actors.motion_field.node_grid import node_positions
from mlbs_actors.segmentation.region_groups import slices_in

__all__ = ["BackgroundView", "background_field"]


class BackgroundView:
    """How the background sees frames of one size.

    Parameters
    ----------
    config : Config
    shape : (H, W)
        px.

    Attributes
    ----------
    shape : (H, W)
    """

    def __init__(self, config: Config, shape: tuple[int, int]) -> None:
        self.shape = shape
        self._config = config
        self._side = cell_side(shape, config.appearance.cell_px)
        self._density = AppearanceParameters.configured(config, "background", self._side)
        self._motion = MotionParameters.configured(config)
        self._trust = confidence(np.arange(256), self._density)

    def next(
        self, state: LayerState, evidence: FrameEvidence, frame: Array, previous: Segmentation | None
    ) -> LayerFrame:
        """See :meth:`~mlbs_actors.layer.layer.Layer.step`; the state's model learns in place."""
        start, own = perf_counter(), evidence.of(BACKGROUND)
        posterior = _finished(self._config, state, previous)
        finished = perf_counter()
        field = background_field(own, evidence, self._motion)
        moved = perf_counter()
        following, trust = self._evaluated(state, posterior, own, evidence, frame, previous, field)
        evaluated = perf_counter()
        stage_ms = {
            "update": 1e3 * (finished - start),
            "gabp": 1e3 * (moved - finished),
            "posterior": 1e3 * (evaluated - moved),
        }
        return LayerFrame(following, trust, stage_ms)

    def _evaluated(
        self,
        state: LayerState,
        posterior: Array,
        own: LayerEvidence,
        evidence: FrameEvidence,
        frame: Array,
        previous: Segmentation | None,
        field: MotionField,
    ) -> tuple[LayerState, float]:
        """The next state, and the mean trust in its model."""
        config, side = self._config, self._side
        margins = (config.posterior.region_margin_px, config.posterior.covered_margin_px)
        region, needed = contested(evidence, previous, margins, side)
        cells = in_cells(region, side)
        part = cells.slices
        motions = field.of_cells(side)
        motions *= np.float32(1.0 / side)  # in cells
        motion = np.ascontiguousarray(motions[part])
        variance = np.ascontiguousarray(field.variance_of_cells(side)[part])
        image = mean_of_cells(frame, side)
        opened = np.zeros(image.shape[:2], np.bool_)
        opened[part] = needed
        whole = Region(0, 0, image.shape[1], image.shape[0])
        model, log_density = warp_and_evaluate(state.model, whole, motions, image, self._density, opened)
        log_ratio, samples = quantised_colours(
            np.ascontiguousarray(log_density[part]),
            np.ascontiguousarray(model.count[part]),
            needed,
            config.posterior.appearance_cap,
        )
        prior = warp_map(posterior, in_cells(state.region, state.cell), cells, motion, needed)
        none: Array = np.zeros(needed.shape, np.float32)
        cost = layer_cost(
            config, "background", evidence, cells, side, needed, motion, variance, prior, none, none
        )
        following = LayerState(
            last_frame=evidence.frame_index,
            home=Region(0, 0, frame.shape[1], frame.shape[0]),
            region=region,
            cell=side,
            model=model,
            cost=cost,
            log_ratio=log_ratio,
            samples=samples,
            image=image,
            velocity=_velocity(own, state.velocity),
            trusted=trusted_background(config, own, evidence, side),
        )
        return following, float(mean_trust(model.count, self._trust))


def background_field(
    own: LayerEvidence, evidence: FrameEvidence, parameters: MotionParameters
) -> MotionField:
    """Infer how the background moves; where no trajectory tells, that is the camera's motion.

    Parameters
    ----------
    own : LayerEvidence
        Its trajectories.
    evidence : FrameEvidence
    parameters : MotionParameters

    Returns
    -------
    MotionField
        Of the frame.
    """
    nodes = node_positions(evidence.shape, parameters.spacing_px).astype(np.float64)
    prior = cv2.perspectiveTransform(nodes, evidence.camera) - nodes
    return motion_field(own.positions, own.motions, evidence.shape, prior, parameters)


def _velocity(own: LayerEvidence, last: Array) -> Array:
    return -np.array(median_of_motions(own.motions), np.float32) if len(own.motions) else last


def _finished(config: Config, state: LayerState, previous: Segmentation | None) -> Array:
    """Learn frame t−1; the background's normalised posterior of it, empty if it had no part in it."""
    if previous is None or previous.frame_index != state.last_frame:
        return np.zeros((0, 0), np.float32)
    won, learnt = cells_won(previous.labels, BACKGROUND, state.home, state.cell, state.trusted)
    update(state.model, state.image, learnt)
    cells, home = in_cells(state.region, state.cell), in_cells(state.home, state.cell)
    own = np.ascontiguousarray(won[slices_in(cells, home)])
    return finished_posterior(config, state.cost, state.log_ratio, state.samples, previous, cells, own)
