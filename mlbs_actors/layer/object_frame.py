"""One frame of an object in one compiled function: what it learns of the last one, and how it sees the new.

It calls, one after the other, the kernels that :mod:`mlbs_actors.layer.background_frame` calls by way of the
functions around them. An object is small, and its process wakes for a millisecond a frame: those functions
would take longer than its kernels do. For the same reason some that are called once a frame are put in
place (``forceinline``): a call hands over all numbers of all arrays, by code that is in no cache. What the
terms are, and how they differ from the paper's, is said in :mod:`mlbs_actors.layer.layer`.
"""

from __future__ import annotations

from time import perf_counter
from typing import Any

import numpy as np

from mlbs_actors.appearance.cells import cell_side, count_won, in_cells, mean_colours
from mlbs_actors.appearance.colour_density import AppearanceParameters, log_densities, mean_trust
from mlbs_actors.appearance.colour_model import AppearanceModel, learn_colours, moved_stacks
from mlbs_actors.appearance.warp import interpolate_map
from mlbs_actors.config import Config
from mlbs_actors.kernels.jit import compiled
from mlbs_actors.layer.layer_state import LayerFrame, LayerState
from mlbs_actors.layer.learning import near_trajectories, unexplained_cells
from mlbs_actors.layer.object_parameters import (
    ObjectParameters,
    ObjectTables,
    object_parameters,
    object_tables,
)
from mlbs_actors.layer.object_regions import box_of, median_of_motions, region_of_object, told_of
from mlbs_actors.layer.photometric import photometric_advantage
from mlbs_actors.layer.posterior_terms import finish_posterior, quantise_colours, sum_terms
from mlbs_actors.messages import Array, FrameEvidence, Region, Segmentation, received
from mlbs_actors.motion_field.field import (
    FieldNumbers,
    MotionParameters,
    check_solved,
    field_numbers,
    solved_field,
)
from mlbs_actors.motion_field.node_grid import nodes_of_cells, to_pixels

__all__ = ["ObjectView", "object_frame"]

#: Left, top, width and height.
Box = tuple[int, int, int, int]
#: Samples, count, newest, spread and residual of an appearance model.
Model = tuple[Array, Array, Array, Array, Array]


class ObjectView:
    """How an object sees frames of one size.

    Parameters
    ----------
    config : Config
    layer : int
        Its id.
    shape : (H, W)
        px.

    Attributes
    ----------
    shape : (H, W)
    side : int
        Of its cells, px.
    tolerance : float
        What is demanded of its motion field, see :func:`~mlbs_actors.motion_field.field.check_solved`.
    constants : tuple
        Parameters, numbers and tables of :func:`object_frame`.
    """

    def __init__(self, config: Config, layer: int, shape: tuple[int, int]) -> None:
        self.shape = shape
        self._layer = layer
        self.side = cell_side(shape, config.appearance.cell_px)
        density = AppearanceParameters.configured(config, "object", self.side)
        motion = MotionParameters.configured(config)
        self.tolerance = motion.tolerance
        # Plain tuples: Numba would ask for the type of any other one anew in each call.
        self.constants = (
            tuple(object_parameters(config, density, shape)),
            tuple(field_numbers(motion)),
            tuple(object_tables(config, density)),
        )

    def next(
        self, state: LayerState, evidence: FrameEvidence, frame: Array, previous: Segmentation | None
    ) -> LayerFrame:
        """See :meth:`~mlbs_actors.layer.layer.Layer.step`; the state's model learns in place."""
        start, layer, side = perf_counter(), self._layer, self.side
        own = evidence.tracks_of(layer)
        learns = previous is not None and previous.frame_index == state.last_frame
        shown = previous or _NOTHING
        box, model, last, trust, residual = object_frame(
            *self.constants,
            (np.uint16(layer), side, own.start, own.end, learns),
            (
                frame,
                evidence.positions,
                evidence.motions,
                evidence.camera,
                evidence.flow,
                evidence.flow_reliable,
                evidence.unexplained,
                unexplained_cells(evidence, side),
            ),
            (shown.labels, shown.normaliser, shown.fallback),
            told_of(layer, previous),
            *self.kept(state),
        )
        check_solved(residual, self.tolerance)
        following = self.state(evidence.frame_index, box, model, last)
        return LayerFrame(following, trust, {"posterior": 1e3 * (perf_counter() - start)})

    def kept(self, state: LayerState) -> tuple[Box, Model, tuple[Array, ...]]:
        """What :func:`object_frame` is told of the last frame: its region, the model, and what was seen."""
        last = (state.image, state.trusted, state.cost, state.log_ratio, state.samples, state.velocity)
        return box_of(state.region), state.model.arrays, last

    def state(self, frame_index: int, box: Box, model: Model, last: tuple[Array, ...]) -> LayerState:
        """The state after a frame of which that is kept."""
        image, trusted, cost, log_ratio, samples, velocity = last
        region = Region(*box)
        return LayerState(
            last_frame=frame_index,
            home=region,
            region=region,
            cell=self.side,
            model=AppearanceModel(in_cells(region, self.side), *model),
            cost=cost,
            log_ratio=log_ratio,
            samples=samples,
            image=image,
            velocity=velocity,
            trusted=trusted,
        )


#: What was published of no frame.
_NOTHING = received(
    Segmentation(
        frame_index=-1,
        labels=np.zeros((0, 0), np.uint16),
        normaliser=np.zeros((0, 0), np.uint8),
        fallback=np.zeros((0, 0), np.int8),
        layers=(),
        camera_motion=(0.0, 0.0),
        latency_frames=0,
    )
)


@compiled
def object_frame(
    parameters: tuple[float, ...], numbers: tuple[Any, ...], tables: tuple[Array, ...],
    own: tuple[np.uint16, int, int, int, bool], seen: tuple[Array, ...], shown: tuple[Array, Array, Array],
    told: Array, last_region: Box, model: Model, last: tuple[Array, ...],
) -> tuple[Box, Model, tuple[Array, ...], float, float]:  # fmt: skip
    """Finish an object's last frame, then predict and evaluate it in a new one.

    Parameters
    ----------
    parameters, numbers, tables : tuple
        :class:`~mlbs_actors.layer.object_parameters.ObjectParameters`,
        :class:`~mlbs_actors.motion_field.field.FieldNumbers` and
        :class:`~mlbs_actors.layer.object_parameters.ObjectTables`, as plain tuples.
    own : (layer, side, start, end, learns)
        Its id; side of a cell, px; which of all trajectories are its; and whether it had a part in the last
        frame.
    seen : frame, positions, motions, camera, flow, reliable, unexplained, unexplained cells
        (H, W, 3) uint8; what :class:`~mlbs_actors.messages.FrameEvidence` has; and
        :func:`~mlbs_actors.layer.learning.unexplained_cells`.
    shown : labels, normaliser, fallback
        Of the last frame's :class:`~mlbs_actors.messages.Segmentation`.
    told : (7,) float64
        :func:`~mlbs_actors.layer.object_regions.told_of` it.
    last_region : (x, y, width, height)
        Where it was evaluated, px.
    model : samples, count, newest, spread and residual
        Of its :class:`~mlbs_actors.appearance.colour_model.AppearanceModel`; the last frame is learnt in
        place.
    last : image, trusted, cost, log ratio, samples, velocity
        Of its :class:`~mlbs_actors.layer.layer_state.LayerState`.

    Returns
    -------
    region : (x, y, width, height)
        Where it is evaluated now, px.
    model, last
        As its next state has them.
    confidence : float
        Mean trust in the model.
    residual : float
        For :func:`~mlbs_actors.motion_field.field.check_solved`.
    """
    by, (layer, side, start, end, learns) = ObjectParameters(*parameters), own
    posterior = np.empty((0, 0), np.float32)
    if learns:
        posterior = _finished(by, tables, layer, side, shown, last_region, model, last)

    frame, positions, motions, _, _, _, _, _ = seen
    last_image, _, _, _, _, last_velocity = last
    height, width, _ = frame.shape
    points, moved, velocity = positions[start:end], motions[start:end], last_velocity.copy()
    region = region_of_object(
        told, points, moved, (by.margin, by.covered_margin), by.scale, side, height, width
    )
    x, y, wide, high = region
    # Where no trajectory tells, the field is the median of all.
    prior = np.empty((1, 1, 2))
    if end > start:
        prior[0, 0, 0], prior[0, 0, 1] = median_of_motions(moved)
        velocity[0], velocity[1] = np.float32(-prior[0, 0, 0]), np.float32(-prior[0, 0, 1])
    else:
        prior[0, 0, 0], prior[0, 0, 1] = -velocity[0], -velocity[1]
    mean, variance, _, _, residual = solved_field(points, moved, prior, (x, y), (high, wide), numbers)
    field = FieldNumbers(*numbers)
    nodes, spacing = nodes_of_cells(mean, field.spacing, side, high, wide)
    flat = variance.reshape(variance.shape[0], variance.shape[1], 1)
    variance_nodes, variance_spacing = nodes_of_cells(flat, field.variance_spacing, side, high, wide)
    rows, columns = -(-high // side), -(-wide // side)
    motion = to_pixels(nodes, spacing, rows, columns) * np.float32(1.0 / side)
    spread_variance = to_pixels(variance_nodes, variance_spacing, rows, columns).reshape(rows, columns)
    found = _evaluated(
        by, tables, own, seen, region, last_region, last_image, posterior, model, motion, spread_variance
    )
    following, image, trusted, cost, log_ratio, samples, trust = found
    return region, following, (image, trusted, cost, log_ratio, samples, velocity), trust, residual


@compiled
def _finished(
    by: ObjectParameters, tables: tuple[Array, ...], layer: np.uint16, side: int,
    shown: tuple[Array, Array, Array], region: Box, model: Model,
    last: tuple[Array, ...],
) -> Array:  # fmt: skip
    """Learn a published frame; the object's normalised posterior of it, (h, w) float32."""
    of, (x, y, width, height), (labels, normaliser, fallback) = ObjectTables(*tables), region, shown
    image, trusted, cost, log_ratio, samples, _ = last
    won, learnt = np.empty(trusted.shape, np.uint8), np.empty(trusted.shape, np.bool_)
    count_won(labels, layer, x, y, width, height, side, trusted, won, learnt)
    stacks, count, newest, spread, residual = model
    learn_colours(stacks, count, newest, spread, residual, image, learnt)
    posterior = np.empty(cost.shape, np.float32)
    finish_posterior(
        cost, log_ratio.view(np.uint8), samples, fallback.view(np.uint8), normaliser, x // side, y // side,
        won, of.known, of.ratio_of, np.float32(by.appearance), of.likelihood, posterior,
    )  # fmt: skip
    return posterior


@compiled
def _evaluated(
    by: ObjectParameters, tables: tuple[Array, ...], own: tuple[np.uint16, int, int, int, bool],
    seen: tuple[Array, ...], region: Box, last_region: Box, last_image: Array, posterior: Array,
    model: Model, motion: Array, variance: Array,
) -> tuple[Model, Array, Array, Array, Array, Array, float]:  # fmt: skip
    """Predict and evaluate an object, whose motion is known for each cell, cells, and its variance, px².

    The last image and the last posterior, which may be empty, are of the last region's cells.
    """
    of, (_, side, start, end, _) = ObjectTables(*tables), own
    frame, positions, _, camera, flow, reliable, unexplained, unexplained_cells = seen
    x, y, width, height = region
    left, top, shape = x // side, y // side, variance.shape
    last_left, last_top = last_region[0] // side, last_region[1] // side
    shift_x, shift_y, needed = left - last_left, top - last_top, np.ones(shape, np.bool_)
    image = mean_colours(frame, x, y, height, width, side)

    stacks, count, newest, spread, residual = model
    moved = moved_stacks(stacks, count, newest, spread, residual, shift_x, shift_y, motion)
    log_density = np.full(shape, np.float32(np.nan))
    log_densities(
        moved[0], moved[1], moved[3], moved[4], image, needed, np.float32(by.bandwidth_floor),
        np.float32(by.registration), of.exponent, of.norm, log_density,
    )  # fmt: skip
    log_ratio, samples = np.zeros(shape, np.int8), np.zeros(shape, np.uint8)
    quantise_colours(log_density, moved[1], needed, np.float32(by.appearance_cap), log_ratio, samples)

    prior, share = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    interpolate_map(posterior, motion, shift_x, shift_y, needed, prior, share)
    trusted, away = np.empty(shape, np.bool_), np.empty(shape, np.float32)
    near_trajectories(
        positions, start, end, side, left, top, unexplained_cells, by.unexplained,
        np.float32(by.close), np.float32(by.learn), np.float32(by.near), np.float32(by.fade),
        trusted, away,
    )  # fmt: skip
    advantage = photometric_advantage(
        last_image, image, motion, camera, float(side), (left, top), (last_left, last_top),
        prior >= np.float32(0.5), np.float32(by.photometric_cap),
    )  # fmt: skip
    cost = np.full(shape, np.uint8(by.uncontested))
    sum_terms(
        needed, motion, np.float32(side), variance, flow, reliable, unexplained, left, top,
        frame.shape[1] / side, frame.shape[0] / side, of.heard, prior, share, away, advantage,
        np.float32(by.distance), np.float32(by.photometric), np.float32(by.flow_variance),
        np.float32(by.neutral_prior), of.disagreement, of.surprise, np.float32(by.offset), cost,
    )  # fmt: skip
    return moved, image, trusted, cost, log_ratio, samples, mean_trust(moved[1], of.trust)
