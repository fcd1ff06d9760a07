"""How a layer sees a new frame: its colours, costs and trust there, and its model moved to it (§6).

:mod:`mlbs_actors.layer` says what the terms are, and how they differ from the paper's.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mlbs_actors.appearance import AppearanceModel
from mlbs_actors.cells import cell_side, in_cells, mean_of_cells
from mlbs_actors.config import Config
from mlbs_actors.gabp import MotionField
from mlbs_actors.kde import AppearanceParameters, warp_and_evaluate
from mlbs_actors.layer_cost import layer_cost, quantised_colours
from mlbs_actors.learning import trusted_background, unexplained_cells
from mlbs_actors.messages import Array, FrameEvidence, LayerEvidence, LayerKind, Region
from mlbs_actors.object_frame import evaluated_object, mean_trust, object_parameters, object_tables
from mlbs_actors.object_regions import box_of
from mlbs_actors.warp import warp_map

__all__ = ["LastFrame", "LayerView", "SeenFrame"]


class LastFrame(NamedTuple):
    """What a layer knows of the frame before.

    Attributes
    ----------
    region : Region
        Where it was evaluated, px.
    model : AppearanceModel
    image : (h, w, 3) uint8
        Mean colours of its cells.
    posterior : (h, w) float32
        Of that region's cells, normalised; empty if it had no part in that frame.
    """

    region: Region
    model: AppearanceModel
    image: Array
    posterior: Array


class SeenFrame(NamedTuple):
    """What a layer makes of a frame, as :class:`~mlbs_actors.layer.LayerState` has it.

    Attributes
    ----------
    model : AppearanceModel
    image : (h, w, 3) uint8
    trusted : (h, w) bool
    cost : (rows, columns) uint8
    log_ratio : (rows, columns) int8
    samples : (rows, columns) uint8
    confidence : float
        Mean trust in the model.
    """

    model: AppearanceModel
    image: Array
    trusted: Array
    cost: Array
    log_ratio: Array
    samples: Array
    confidence: float


class LayerView:
    """How a layer sees frames of one size.

    Parameters
    ----------
    config : Config
    kind : {"background", "object", "other"}
    shape : (H, W)
        px.

    Attributes
    ----------
    side : int
        Of a cell, px.
    """

    def __init__(self, config: Config, kind: LayerKind, shape: tuple[int, int]) -> None:
        colours = config.appearance
        background = kind == "background"
        registration = colours.background_registration_px if background else colours.registration_px
        self.shape = shape
        self.side = cell_side(shape, colours.cell_px)
        self._config = config
        self._density = AppearanceParameters(
            bandwidth_floor=colours.bandwidth_floor,
            registration=registration / self.side,
            half_confidence_samples=colours.half_confidence_samples,
        )
        # Plain tuples: Numba would ask for the type of any other one anew in each call.
        self._parameters = tuple(object_parameters(config, self._density, shape))
        tables = object_tables(config, self._density)
        self._tables = tuple(tables)
        self._trust = tables.trust

    def of_object(
        self,
        frame: Array,
        evidence: LayerEvidence,
        frame_evidence: FrameEvidence,
        last: LastFrame,
        region: Region,
        field: MotionField,
    ) -> SeenFrame:
        """Evaluate an object in its region, on which it has a motion field."""
        side = self.side
        model, image, trusted, cost, log_ratio, samples, confidence = evaluated_object(
            self._parameters,
            self._tables,
            frame,
            box_of(region),
            side,
            box_of(last.region),
            last.image,
            last.posterior,
            last.model.arrays,
            *field.mean_nodes(side),
            *field.variance_nodes(side),
            frame_evidence.positions,
            frame_evidence.part(evidence.layer),
            frame_evidence.camera,
            frame_evidence.flow.view(np.uint16),
            frame_evidence.flow_reliable,
            frame_evidence.unexplained,
            unexplained_cells(frame_evidence, side),
        )
        moved = AppearanceModel(in_cells(region, side), *model)
        return SeenFrame(moved, image, trusted, cost, log_ratio, samples, confidence)

    def of_background(
        self,
        frame: Array,
        evidence: LayerEvidence,
        frame_evidence: FrameEvidence,
        last: LastFrame,
        region: Region,
        needed: Array,
        field: MotionField,
    ) -> SeenFrame:
        """Evaluate the background in those cells of a region that are needed.

        Its motion field is the frame's, for its model moves everywhere.
        """
        side, cells = self.side, in_cells(region, self.side)
        part = cells.slices
        motions = field.of_cells(side)
        motions *= np.float32(1.0 / side)  # in cells
        motion = np.ascontiguousarray(motions[part])
        variance = np.ascontiguousarray(field.variance_of_cells(side)[part])
        image = mean_of_cells(frame, side)
        opened = np.zeros(image.shape[:2], np.bool_)
        opened[part] = needed
        whole = Region(0, 0, image.shape[1], image.shape[0])
        model, log_density = warp_and_evaluate(last.model, whole, motions, image, self._density, opened)
        log_ratio, samples = quantised_colours(
            np.ascontiguousarray(log_density[part]),
            np.ascontiguousarray(model.count[part]),
            needed,
            self._config.posterior.appearance_cap,
        )
        prior = warp_map(last.posterior, in_cells(last.region, side), cells, motion, needed)
        trusted = trusted_background(self._config, evidence, frame_evidence, side)
        none: Array = np.zeros(needed.shape, np.float32)
        cost = layer_cost(
            self._config,
            "background",
            frame_evidence,
            cells,
            side,
            needed,
            motion,
            variance,
            prior,
            none,
            none,
        )
        confidence = float(mean_trust(model.count, self._trust))
        return SeenFrame(model, image, trusted, cost, log_ratio, samples, confidence)
