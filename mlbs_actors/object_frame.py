"""One frame of an object in two compiled functions: what it learns of the last one, and how it sees the new.

They call, one after the other, the kernels that :mod:`mlbs_actors.layer` calls for the background by way of
the functions around them. An object is small: those functions would take longer than its kernels do. How
they differ from the paper is said there.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mlbs_actors.appearance import learn_colours, moved_stacks
from mlbs_actors.cells import count_won, mean_colours
from mlbs_actors.compilation import compiled
from mlbs_actors.config import Config, length_scale
from mlbs_actors.kde import AppearanceParameters, confidence, density_tables, log_densities
from mlbs_actors.layer_cost import (
    cost_tables,
    finish_posterior,
    quantise_colours,
    sum_terms,
    uncontested_cost,
)
from mlbs_actors.learning import near_trajectories
from mlbs_actors.messages import UNEXPLAINED_STEP, Array
from mlbs_actors.node_grid import to_pixels
from mlbs_actors.photometric import photometric_advantage
from mlbs_actors.warp import interpolate_map

__all__ = [
    "ObjectParameters",
    "ObjectTables",
    "evaluated_object",
    "finished_object",
    "mean_trust",
    "object_parameters",
    "object_tables",
]

#: Left, top, width and height.
Box = tuple[int, int, int, int]


class ObjectParameters(NamedTuple):
    """Numbers that an object is evaluated with, those of the configuration where nothing else is said.

    Attributes
    ----------
    bandwidth_floor, registration : float
        Of :class:`~mlbs_actors.kde.AppearanceParameters`.
    appearance_cap, photometric_cap : float
    unexplained : float
        From where on the camera fails to explain a cell, in units of ``UNEXPLAINED_STEP``.
    close, learn, near, fade : float
        px of this frame.
    distance, photometric : float
    flow_variance : float
        px².
    neutral_prior, offset : float
    uncontested : float
        :func:`~mlbs_actors.layer_cost.uncontested_cost`.
    """

    bandwidth_floor: float
    registration: float
    appearance_cap: float
    photometric_cap: float
    unexplained: float
    close: float
    learn: float
    near: float
    fade: float
    distance: float
    photometric: float
    flow_variance: float
    neutral_prior: float
    offset: float
    uncontested: float


class ObjectTables(NamedTuple):
    """Functions of one number that an object is evaluated with, all (n,) float32.

    Attributes
    ----------
    exponent, norm : Array
        :func:`~mlbs_actors.kde.density_tables`.
    heard, disagreement, surprise : Array
        :func:`~mlbs_actors.layer_cost.cost_tables`.
    trust : Array
        By numbers of samples, :func:`~mlbs_actors.kde.confidence`.
    """

    exponent: Array
    norm: Array
    heard: Array
    disagreement: Array
    surprise: Array
    trust: Array


def object_parameters(
    config: Config, density: AppearanceParameters, shape: tuple[int, int]
) -> ObjectParameters:
    """Those of frames of a (H, W) shape, with a density that is stated for its cells."""
    weights, scale = config.posterior, length_scale(*shape)
    return ObjectParameters(
        bandwidth_floor=density.bandwidth_floor,
        registration=density.registration,
        appearance_cap=weights.appearance_cap,
        photometric_cap=weights.photometric_cap,
        unexplained=config.layers.unexplained_noise / UNEXPLAINED_STEP,
        close=weights.close_px * scale,
        learn=weights.learn_px * scale,
        near=weights.near_px * scale,
        fade=weights.fade_px * scale,
        distance=weights.distance,
        photometric=weights.photometric,
        flow_variance=(config.motion.flow_std_px * scale) ** 2,
        neutral_prior=weights.neutral_prior,
        offset=weights.offset,
        uncontested=uncontested_cost(config),
    )


def object_tables(config: Config, density: AppearanceParameters) -> ObjectTables:
    """Those of a configuration."""
    return ObjectTables(
        *density_tables(density),
        *cost_tables(config, "object"),
        trust=confidence(np.arange(256), density),
    )


@compiled()
def finished_object(
    labels: Array, normaliser: Array, fallback: Array, layer: np.uint16, region: Box, side: int,
    model: tuple[Array, Array, Array, Array, Array], image: Array, trusted: Array, cost: Array,
    log_ratio: Array, samples: Array, trust: Array, ratio_of: Array, strength: np.float32, likelihood: Array,
) -> Array:  # fmt: skip
    """Learn a published frame, and make the object's normalised posterior of it.

    Parameters
    ----------
    labels, normaliser, fallback : Array
        Of the frame's :class:`~mlbs_actors.messages.Segmentation`.
    layer : uint16
    region : (x, y, width, height)
        The object's, px.
    side : int
        Of a cell, px.
    model : samples, count, newest, spread and residual
        Of its :class:`~mlbs_actors.appearance.AppearanceModel`.
    image, trusted, cost, log_ratio, samples : Array
        Of its :class:`~mlbs_actors.layer.LayerState`.
    trust, ratio_of : Array
        :func:`~mlbs_actors.fusion.appearance_tables`.
    strength : float32
        Weight of the colours, units of ``COST_STEP``.
    likelihood : Array
        :data:`~mlbs_actors.fusion.LIKELIHOOD`.

    Returns
    -------
    (h, w) float32
    """
    x, y, width, height = region
    won, learnt = np.empty(trusted.shape, np.uint8), np.empty(trusted.shape, np.bool_)
    count_won(labels, layer, x, y, width, height, side, trusted, won, learnt)
    stacks, count, newest, spread, residual = model
    learn_colours(stacks, count, newest, spread, residual, image, learnt)
    posterior = np.empty(cost.shape, np.float32)
    finish_posterior(
        cost, log_ratio.view(np.uint8), samples, fallback.view(np.uint8), normaliser, x // side, y // side,
        won, trust, ratio_of, strength, likelihood, posterior,
    )  # fmt: skip
    return posterior


@compiled()
def evaluated_object(
    parameters: tuple[float, ...], tables: tuple[Array, ...], frame: Array, region: Box, side: int,
    last_region: Box, last_image: Array, posterior: Array, model: tuple[Array, Array, Array, Array, Array],
    mean: Array, spacing: int, variance: Array, variance_spacing: int, positions: Array, own: tuple[int, int],
    camera: Array, flow: Array, reliable: Array, unexplained: Array, unexplained_cells: Array,
) -> tuple[tuple[Array, Array, Array, Array, Array], Array, Array, Array, Array, Array, float]:  # fmt: skip
    """Predict and evaluate an object in a new frame.

    Parameters
    ----------
    parameters, tables : tuple
        :class:`ObjectParameters` and :class:`ObjectTables`, as plain tuples: the type of others is asked anew
        in every call.
    frame : (H, W, 3) uint8
    region, last_region : (x, y, width, height)
        The object's in this frame and in the last one, px.
    side : int
        Of a cell, px.
    last_image : (last h, last w, 3) uint8
    posterior : (last h, last w) float32
        Normalised, of the last frame; empty if there is none.
    model : samples, count, newest, spread and residual
        Of its :class:`~mlbs_actors.appearance.AppearanceModel`.
    mean, spacing, variance, variance_spacing
        :meth:`~mlbs_actors.gabp.MotionField.mean_nodes` and ``variance_nodes``.
    positions : (n, 2) float32
        Of all layers' trajectories; the object's are those from ``own[0]`` to ``own[1]``.
    camera, flow, reliable, unexplained : Array
        Of the :class:`~mlbs_actors.messages.FrameEvidence`, the flow by its bits as uint16.
    unexplained_cells : (rows, columns) uint8
        :func:`~mlbs_actors.learning.unexplained_cells`.

    Returns
    -------
    model : samples, count, newest, spread and residual
    image : (h, w, 3) uint8
    trusted : (h, w) bool
    cost : (h, w) uint8
    log_ratio : (h, w) int8
    samples : (h, w) uint8
        As :class:`~mlbs_actors.layer.LayerState` has them.
    confidence : float
    """
    those = ObjectParameters(*parameters)
    by = ObjectTables(*tables)
    x, y, width, height = region
    left, top, shape = x // side, y // side, (-(-height // side), -(-width // side))
    last_left, last_top = last_region[0] // side, last_region[1] // side
    shift_x, shift_y, needed = left - last_left, top - last_top, np.ones(shape, np.bool_)
    motion, in_cells = to_pixels(mean, spacing, shape[0], shape[1]), np.float32(1.0 / side)
    motion *= in_cells
    spread_variance = to_pixels(variance, variance_spacing, shape[0], shape[1]).reshape(shape)
    image = mean_colours(frame, x, y, height, width, side)

    stacks, count, newest, spread, residual = model
    moved = moved_stacks(stacks, count, newest, spread, residual, shift_x, shift_y, motion)
    log_density = np.full(shape, np.float32(np.nan))
    log_densities(
        moved[0], moved[1], moved[3], moved[4], image, needed, np.float32(those.bandwidth_floor),
        np.float32(those.registration), by.exponent, by.norm, log_density,
    )  # fmt: skip
    log_ratio, samples = np.zeros(shape, np.int8), np.zeros(shape, np.uint8)
    quantise_colours(log_density, moved[1], needed, np.float32(those.appearance_cap), log_ratio, samples)

    prior, share = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    interpolate_map(posterior, motion, shift_x, shift_y, needed, prior, share)
    trusted, away = np.empty(shape, np.bool_), np.empty(shape, np.float32)
    near_trajectories(
        positions, own[0], own[1], side, left, top, unexplained_cells, those.unexplained,
        np.float32(those.close), np.float32(those.learn), np.float32(those.near), np.float32(those.fade),
        trusted, away,
    )  # fmt: skip
    advantage = photometric_advantage(
        last_image, image, motion, camera, float(side), (left, top), (last_left, last_top),
        prior >= np.float32(0.5), np.float32(those.photometric_cap),
    )  # fmt: skip
    cost = np.full(shape, np.uint8(those.uncontested))
    sum_terms(
        needed, motion, np.float32(side), spread_variance, flow, reliable, unexplained, left, top,
        frame.shape[1] / side, frame.shape[0] / side, by.heard, prior, share, away, advantage,
        np.float32(those.distance), np.float32(those.photometric), np.float32(those.flow_variance),
        np.float32(those.neutral_prior), by.disagreement, by.surprise, np.float32(those.offset), cost,
    )  # fmt: skip
    return moved, image, trusted, cost, log_ratio, samples, mean_trust(moved[1], by.trust)


@compiled()
def mean_trust(count: Array, trust: Array) -> float:
    """Mean of a table's values at some numbers of samples, 0 of none."""
    total = 0.0
    for y in range(count.shape[0]):
        for x in range(count.shape[1]):
            total += trust[count[y, x]]
    return total / max(count.size, 1)
