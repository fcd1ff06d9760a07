"""Kernels of a layer's posterior: its cost without the colours, and its posterior of a finished frame (§6).

Each is one pass over the cells to evaluate. :mod:`mlbs_actors.layer.layer` defines the terms. Motion and
prior are functions of one number each and read from tables, within 0.003 nats before they are weighted.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mlbs_actors.appearance.fusion import LIKELIHOOD, RATIO_STEP, add_appearance, appearance_tables
from mlbs_actors.config import Config, length_scale
from mlbs_actors.kernels.jit import compiled
from mlbs_actors.messages import (
    COST_STEP,
    UNEXPLAINED_STEP,
    Array,
    FrameEvidence,
    LayerKind,
    Region,
    Segmentation,
)

__all__ = [
    "Prediction",
    "finished_posterior",
    "posterior_cost",
    "quantised_colours",
    "uncontested_cost",
]

#: log of the uniform density over 8-bit colours, nats per unit RGB volume.
LOG_UNIFORM = -3.0 * float(np.log(256.0))

#: Steps of d² in the motion term's table, which ends at d² = 32.
_DISTANCE_STEPS = 128
#: Steps of the prior's table.
_PRIOR_STEPS = 4096


def uncontested_cost(config: Config) -> int:
    """Return the background's cost where no object can be: the offset alone, in units of ``COST_STEP``."""
    return min(round(config.posterior.offset / COST_STEP), 255)


@dataclass(frozen=True, slots=True)
class Prediction:
    """A layer's prediction of a frame, and all cues besides the colours.

    Attributes
    ----------
    cells : Region
        The layer's region, in units of cells.
    side : int
        Of a cell, px.
    needed : (h, w) bool
        Cells to evaluate.
    motion : (h, w, 2) float32
        Mean of the motion field, cells.
    variance : (h, w) float32
        Its variance, px².
    prior : two (h, w) float32
        The last posterior as :func:`~mlbs_actors.appearance.warp.warp_map` returns it.
    away, advantage : (h, w) float32
        For an object: how far from its trajectories each cell is, in [0, 1], and by how much its motion
        explains the image better than the camera's, × noise. 0 for the background.
    """

    cells: Region
    side: int
    needed: Array
    motion: Array
    variance: Array
    prior: tuple[Array, Array]
    away: Array
    advantage: Array


def posterior_cost(config: Config, kind: LayerKind, evidence: FrameEvidence, prediction: Prediction) -> Array:
    """Sum a layer's weighted terms without the colours.

    Parameters
    ----------
    kind : {"background", "object", "other"}
    evidence : FrameEvidence
        Camera and dense flow of the frame.
    prediction : Prediction

    Returns
    -------
    (h, w) uint8
        Units of ``COST_STEP``; the offset alone where not needed.
    """
    weights, scale = config.posterior, length_scale(*evidence.shape)
    numbers = _Weights(
        side=np.float32(prediction.side),
        distance=np.float32(weights.distance),
        photometric=np.float32(weights.photometric),
        flow_variance=np.float32((config.motion.flow_std_px * scale) ** 2),
        neutral_prior=np.float32(weights.neutral_prior),
        offset=np.float32(weights.offset),
        uncontested=np.uint8(uncontested_cost(config)),
    )
    cost: Array = _summed_terms(
        prediction.needed,
        (prediction.motion, prediction.variance),
        (evidence.flow, evidence.flow_reliable, evidence.unexplained),
        (prediction.cells.x, prediction.cells.y),
        prediction.prior,
        (prediction.away, prediction.advantage),
        _cost_tables(config, kind),
        numbers,
    )
    return cost


class _Weights(NamedTuple):
    """Parameters of :func:`posterior_cost`, lengths in px, as float32."""

    side: np.float32
    distance: np.float32
    photometric: np.float32
    flow_variance: np.float32
    neutral_prior: np.float32
    offset: np.float32
    uncontested: np.uint8


def _cost_tables(config: Config, kind: LayerKind) -> tuple[Array, Array, Array]:
    """Tabulate the motion term's weight by the camera's error, that term by d², and the prior's term."""
    weights, background = config.posterior, kind == "background"
    return _tables(
        config.layers.unexplained_noise,
        weights.motion,
        weights.motion_floor if background else weights.object_motion_floor,
        weights.prior,
        # Background that was hidden was there all the same: for it the floor is the neutral value.
        weights.neutral_prior if background else weights.prior_floor,
    )


@functools.lru_cache(maxsize=16)
def _tables(
    unexplained_noise: float, motion: float, motion_floor: float, prior: float, prior_floor: float
) -> tuple[Array, Array, Array]:
    reliance = np.clip(2.0 * UNEXPLAINED_STEP / unexplained_noise * np.arange(256) - 1.0, 0.0, 1.0)
    distances = np.arange(32 * _DISTANCE_STEPS + 1) / _DISTANCE_STEPS
    disagreement = -np.log(motion_floor + (1.0 - motion_floor) * np.exp(-0.5 * distances))
    surprise = -np.log(np.maximum(np.arange(_PRIOR_STEPS + 1) / _PRIOR_STEPS, prior_floor))
    return (
        reliance.astype(np.float32) * np.float32(motion),
        disagreement.astype(np.float32),
        (prior * surprise).astype(np.float32),
    )


@compiled
def _summed_terms(
    needed: Array, field: tuple[Array, Array], seen: tuple[Array, Array, Array], corner: tuple[int, int],
    prior: tuple[Array, Array], cues: tuple[Array, Array], tables: tuple[Array, Array, Array],
    weights: _Weights,
) -> Array:  # fmt: skip
    """Sum the terms of :func:`posterior_cost`; the maps in ``seen`` are those of the whole frame."""
    (motion, variance), (flow, reliable, unexplained), (left, top) = field, seen, corner
    (prior_value, share), (away, advantage), (reliance, disagreement, surprise) = prior, cues, tables
    cost = np.full(needed.shape, weights.uncontested)
    one, half, step = np.float32(1), np.float32(0.5), np.float32(COST_STEP)
    height, width = needed.shape
    for y in range(height):
        flows, trust = flow[top + y, left : left + width], reliable[top + y, left : left + width]
        errors = unexplained[top + y, left : left + width]
        for x in range(width):
            if not needed[y, x]:
                continue
            nats = weights.offset + (weights.distance * away[y, x] - weights.photometric * advantage[y, x])
            if trust[x]:
                miss_x = flows[x, 0] - weights.side * motion[y, x, 0]
                miss_y = flows[x, 1] - weights.side * motion[y, x, 1]
                distance = (miss_x * miss_x + miss_y * miss_y) / (variance[y, x] + weights.flow_variance)
                place = min(distance * np.float32(_DISTANCE_STEPS), np.float32(disagreement.size - 1))
                nats += reliance[errors[x]] * disagreement[int(place + half)]
            believed = min(prior_value[y, x] + (one - share[y, x]) * weights.neutral_prior, one)
            nats += surprise[int(believed * np.float32(_PRIOR_STEPS) + half)]
            quanta = min(max(np.rint(nats / step), np.float32(0)), np.float32(255))
            cost[y, x] = np.uint8(np.int32(quanta))
    return cost


def quantised_colours(log_density: Array, count: Array, needed: Array, largest: float) -> tuple[Array, Array]:
    """Quantise the colours' part of the posterior for sending.

    Parameters
    ----------
    log_density : (h, w) float32
        Nats per unit RGB volume; NaN where nothing is known.
    count : (h, w) uint8
        Samples behind it.
    needed : (h, w) bool
    largest : float
        Bound of the ratio, nats.

    Returns
    -------
    log_ratio : (h, w) int8
        log of the density over the uniform one, in units of ``RATIO_STEP``; 0 where there are no samples.
    samples : (h, w) uint8
        0 where not needed.
    """
    log_ratio, samples = np.zeros(needed.shape, np.int8), np.zeros(needed.shape, np.uint8)
    _quantise_colours(log_density, count, needed, np.float32(largest), log_ratio, samples)
    return log_ratio, samples


@compiled
def _quantise_colours(
    log_density: Array, count: Array, needed: Array, largest: np.float32, log_ratio: Array, samples: Array
) -> None:
    """Fill zeros as :func:`quantised_colours`."""
    for y in range(needed.shape[0]):
        for x in range(needed.shape[1]):
            if needed[y, x] and count[y, x] > 0:
                ratio = min(log_density[y, x] - np.float32(LOG_UNIFORM), largest)
                quanta = np.rint(ratio / np.float32(RATIO_STEP))
                log_ratio[y, x] = np.int8(min(max(quanta, np.float32(-128)), np.float32(127)))
                samples[y, x] = count[y, x]


def finished_posterior(
    config: Config,
    sent: tuple[Array, Array, Array],
    published: Segmentation,
    cells: Region,
    won: Array,
) -> Array:
    """Return a layer's posterior of a finished frame: the mean of its normalised one and the published map.

    Parameters
    ----------
    sent : cost (h, w) uint8, log_ratio (h, w) int8, samples (h, w) uint8
        As the layer sent them to the segmenter.
    published : Segmentation
        Result of that frame.
    cells : Region
        The layer's region, in units of cells.
    won : (h, w) uint8
        Its share of each cell in the published map, 255 = all; that map is the better estimate, as it has
        seen the outlines.

    Returns
    -------
    (h, w) float32
        In [0, 1].
    """
    cost, log_ratio, samples = sent
    posterior: Array = _finished_posterior(
        (cost, log_ratio.view(np.uint8), samples),
        (published.fallback.view(np.uint8), published.normaliser),
        (cells.x, cells.y),
        won,
        (*appearance_tables(config.appearance.half_confidence_samples), LIKELIHOOD),
        np.float32(config.posterior.appearance / COST_STEP),
    )
    return posterior


@compiled
def _finished_posterior(
    sent: tuple[Array, Array, Array], published: tuple[Array, Array], corner: tuple[int, int], won: Array,
    tables: tuple[Array, Array, Array], strength: np.float32,
) -> Array:  # fmt: skip
    """Evaluate :func:`finished_posterior`; log r and log f come as unsigned bytes."""
    (cost, log_ratio, samples), (fallback, normaliser), (left, top) = sent, published, corner
    trust, ratio_of, likelihood = tables
    posterior = np.empty(cost.shape, np.float32)
    height, width = cost.shape
    half, share, fused = np.float32(0.5), np.float32(0.5 / 255), np.empty(cost.shape, np.uint8)
    rows, columns = slice(top, top + height), slice(left, left + width)
    add_appearance(cost, log_ratio, samples, fallback[rows, columns], trust, ratio_of, strength, fused)
    for y in range(height):
        for x in range(width):
            above = int(max(np.int64(fused[y, x]) - np.int64(normaliser[top + y, left + x]), np.int64(0)))
            posterior[y, x] = half * likelihood[above] + share * np.float32(won[y, x])
    return posterior
