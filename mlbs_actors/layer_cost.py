"""The kernels of a layer's posterior: its cost without the colours, and its share of a finished frame (§6).

Each is one pass over the cells that are needed, with the flow read from its own grid where it is heard.
:mod:`mlbs_actors.layer` says what the terms are. Motion and prior are functions of one number each and read
from tables, 0.003 nats from exact before they are weighed.
"""

from __future__ import annotations

import functools

import numpy as np

from mlbs_actors.compilation import compiled
from mlbs_actors.config import Config, length_scale
from mlbs_actors.fusion import LIKELIHOOD, RATIO_STEP, with_appearance
from mlbs_actors.half_precision import single_precision
from mlbs_actors.messages import (
    COST_STEP,
    UNEXPLAINED_STEP,
    Array,
    FrameEvidence,
    LayerKind,
    Region,
    Segmentation,
)

__all__ = ["finished_posterior", "layer_cost", "quantised_colours", "uncontested_cost"]

#: log of the uniform density over 8-bit colours, nats per unit RGB volume.
LOG_UNIFORM = -3.0 * float(np.log(256.0))

#: Steps of d² in the motion term's table, which ends at d² = 32.
_DISTANCE_STEPS = 128
#: Steps of the prior's table.
_PRIOR_STEPS = 4096


def uncontested_cost(config: Config) -> int:
    """Cost of the background where no object can be: the offset alone, in units of ``COST_STEP``."""
    return min(round(config.posterior.offset / COST_STEP), 255)


def layer_cost(
    config: Config,
    kind: LayerKind,
    evidence: FrameEvidence,
    cells: Region,
    side: int,
    needed: Array,
    motion: Array,
    variance: Array,
    prior: tuple[Array, Array],
    own_terms: Array,
) -> Array:
    """Weighted sum of the layer's terms.

    Parameters
    ----------
    config : Config
    kind : {"background", "object", "other"}
    evidence : FrameEvidence
        Camera and dense flow of the frame.
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
        The last posterior as :func:`~mlbs_actors.warp.warp_map` returns it.
    own_terms : (h, w) float32
        Sum of the terms that an object has besides, nats.

    Returns
    -------
    (h, w) uint8
        Units of ``COST_STEP``; :func:`uncontested_cost` where it was not needed.
    """
    weights, background = config.posterior, kind == "background"
    cost = np.full(needed.shape, uncontested_cost(config), np.uint8)
    heard, disagreement, surprise = _tables(
        config.layers.unexplained_noise,
        weights.motion,
        weights.motion_floor if background else weights.object_motion_floor,
        weights.prior,
        # Background that was hidden has been there all the same: for it the floor is the neutral value.
        weights.neutral_prior if background else weights.prior_floor,
    )
    flow_variance = (config.motion.flow_std_px * length_scale(*evidence.shape)) ** 2
    (height, width), grid = evidence.shape, evidence.flow.shape
    rows, top, bottom, down = _taps(cells.y, cells.height, height / side, grid[0])
    columns, left, right, along = _taps(cells.x, cells.width, width / side, grid[1])
    _layer_cost(
        needed,
        motion,
        np.float32(side),
        variance,
        single_precision(evidence.flow[rows, columns]),
        np.ascontiguousarray(evidence.flow_reliable[rows, columns]),
        np.ascontiguousarray(evidence.unexplained[rows, columns]),
        top,
        bottom,
        down,
        left,
        right,
        along,
        heard,
        *prior,
        own_terms,
        np.float32(flow_variance),
        np.float32(weights.neutral_prior),
        disagreement,
        surprise,
        np.float32(weights.offset),
        cost,
    )
    return cost


@functools.lru_cache(maxsize=16)
def _tables(
    unexplained_noise: float, motion: float, motion_floor: float, prior: float, prior_floor: float
) -> tuple[Array, Array, Array]:
    """Weight of the motion term by how little the camera explains, the term by d², and the prior's term."""
    heard = np.clip(2.0 * UNEXPLAINED_STEP / unexplained_noise * np.arange(256) - 1.0, 0.0, 1.0)
    distances = np.arange(32 * _DISTANCE_STEPS + 1) / _DISTANCE_STEPS
    disagreement = -np.log(motion_floor + (1.0 - motion_floor) * np.exp(-0.5 * distances))
    surprise = -np.log(np.maximum(np.arange(_PRIOR_STEPS + 1) / _PRIOR_STEPS, prior_floor))
    return (
        heard.astype(np.float32) * np.float32(motion),
        disagreement.astype(np.float32),
        (prior * surprise).astype(np.float32),
    )


def _taps(first: int, count: int, length: float, grid: int) -> tuple[slice, Array, Array, Array]:
    """Some cells of an axis on a grid of the same axis: the part that they lie in, between which two of its
    places each cell's centre lies, and its share in the second. The whole axis is ``length`` cells long."""
    low, high, share = _places(first, count, grid / length, grid)
    if count == 0:
        return slice(0, 0), low, high, share
    part = slice(int(low[0]), int(high[-1]) + 1)
    return part, low - part.start, high - part.start, share


@compiled()
def _places(first: int, count: int, ratio: float, grid: int) -> tuple[Array, Array, Array]:
    low, high = np.empty(count, np.int64), np.empty(count, np.int64)
    share = np.empty(count, np.float32)
    for i in range(count):
        place = min(max((first + i + 0.5) * ratio - 0.5, 0.0), grid - 1.0)
        low[i] = int(place)
        high[i] = min(low[i] + 1, grid - 1)
        share[i] = place - low[i]
    return low, high, share


@compiled()
def _layer_cost(
    needed: Array, motion: Array, side: np.float32, variance: Array, flow: Array, reliable: Array,
    unexplained: Array, top: Array, bottom: Array, down: Array, left: Array, right: Array, along: Array,
    heard: Array, prior: Array, share: Array, own_terms: Array,
    flow_variance: np.float32, neutral: np.float32, disagreement: Array, surprise: Array, offset: np.float32,
    cost: Array,
) -> None:  # fmt: skip
    one, half, step = np.float32(1), np.float32(0.5), np.float32(COST_STEP)
    width, columns = needed.shape[1], unexplained.shape[1]
    # Places in flat arrays, without a sign: it would be looked at before each is read.
    asked, terms, known, shares = (
        needed.reshape(-1),
        own_terms.reshape(-1),
        prior.reshape(-1),
        share.reshape(-1),
    )
    moves, variances, costs = motion.reshape(-1), variance.reshape(-1), cost.reshape(-1)
    errors, trust, flows = unexplained.reshape(-1), reliable.reshape(-1), flow.reshape(-1)
    for y in range(needed.shape[0]):
        above, below, lower = top[y] * columns, bottom[y] * columns, down[y]
        for x in range(width):
            cell = np.uint64(y * width + x)
            if not asked[cell]:
                continue
            nats = offset + terms[cell]
            a, b = np.uint64(above + left[x]), np.uint64(above + right[x])
            c, d = np.uint64(below + left[x]), np.uint64(below + right[x])
            largest = np.uint64(max(errors[a], errors[b], errors[c], errors[d]))
            if heard[largest] > 0:
                w00, w01 = (one - lower) * (one - along[x]), (one - lower) * along[x]
                w10, w11 = lower * (one - along[x]), lower * along[x]
                error = (
                    w00 * np.float32(errors[a]) + w01 * np.float32(errors[b])
                    + w10 * np.float32(errors[c]) + w11 * np.float32(errors[d])
                )  # fmt: skip
                weight = heard[np.uint64(np.int64(error + half))]
                weight *= w00 * trust[a] + w01 * trust[b] + w10 * trust[c] + w11 * trust[d]
                if weight > 0:
                    two, one_more = np.uint64(2), np.uint64(1)
                    a, b, c, d, move = two * a, two * b, two * c, two * d, two * cell
                    flow_x = w00 * flows[a] + w01 * flows[b]
                    flow_x += w10 * flows[c] + w11 * flows[d]
                    flow_y = w00 * flows[a + one_more] + w01 * flows[b + one_more]
                    flow_y += w10 * flows[c + one_more] + w11 * flows[d + one_more]
                    miss_x, miss_y = flow_x - side * moves[move], flow_y - side * moves[move + one_more]
                    distance = (miss_x * miss_x + miss_y * miss_y) / (variances[cell] + flow_variance)
                    place = min(distance * np.float32(_DISTANCE_STEPS), np.float32(disagreement.size - 1))
                    nats += weight * disagreement[np.uint64(np.int64(place + half))]
            believed = min(known[cell] + (one - shares[cell]) * neutral, one)
            nats += surprise[np.uint64(np.int64(believed * np.float32(_PRIOR_STEPS) + half))]
            quanta = min(max(np.rint(nats / step), np.float32(0)), np.float32(255))
            costs[cell] = np.uint8(np.int32(quanta))


def quantised_colours(log_density: Array, count: Array, needed: Array, largest: float) -> tuple[Array, Array]:
    """What the colours say of the cells that are needed, as it is sent.

    Parameters
    ----------
    log_density : (h, w) float32
        Nats per unit RGB volume; NaN where nothing is known.
    count : (h, w) uint8
        Samples behind it.
    needed : (h, w) bool
    largest : float
        Most that a ratio can be, nats.

    Returns
    -------
    log_ratio : (h, w) int8
        log of the density over the uniform one, in units of ``RATIO_STEP``; 0 where nothing is known.
    samples : (h, w) uint8
        0 where it is not needed.
    """
    log_ratio, samples = np.zeros(needed.shape, np.int8), np.zeros(needed.shape, np.uint8)
    _quantise_colours(log_density, count, needed, np.float32(largest), log_ratio, samples)
    return log_ratio, samples


@compiled()
def _quantise_colours(
    log_density: Array, count: Array, needed: Array, largest: np.float32, log_ratio: Array, samples: Array
) -> None:
    for y in range(needed.shape[0]):
        for x in range(needed.shape[1]):
            if needed[y, x] and count[y, x] > 0:
                ratio = min(log_density[y, x] - np.float32(LOG_UNIFORM), largest)
                quanta = np.rint(ratio / np.float32(RATIO_STEP))
                log_ratio[y, x] = np.int8(min(max(quanta, np.float32(-128)), np.float32(127)))
                samples[y, x] = count[y, x]


def finished_posterior(
    config: Config,
    cost: Array,
    log_ratio: Array,
    samples: Array,
    published: Segmentation,
    cells: Region,
    won: Array,
) -> Array:
    """A layer's normalised posterior of a finished frame, of which the published map is half.

    Parameters
    ----------
    config : Config
    cost, samples : (h, w) uint8
    log_ratio : (h, w) int8
        As the layer sent them to the segmenter.
    published : Segmentation
        Result of that frame.
    cells : Region
        The layer's region, in units of cells.
    won : (h, w) uint8
        Its share of each cell in the published map, 255 = all: the better half of the knowledge, having seen
        the outlines.

    Returns
    -------
    (h, w) float32
        In [0, 1].
    """
    fused = with_appearance(
        cost,
        log_ratio,
        samples,
        np.ascontiguousarray(published.fallback[cells.slices]),
        config.posterior.appearance,
        config.appearance.half_confidence_samples,
    )
    posterior = np.empty(cost.shape, np.float32)
    normaliser = np.ascontiguousarray(published.normaliser[cells.slices])
    _finished_posterior(fused, normaliser, won, LIKELIHOOD, posterior)
    return posterior


@compiled()
def _finished_posterior(
    fused: Array, normaliser: Array, won: Array, likelihood: Array, posterior: Array
) -> None:
    half, share = np.float32(0.5), np.float32(0.5 / 255)
    for y in range(fused.shape[0]):
        for x in range(fused.shape[1]):
            above = int(max(np.int64(fused[y, x]) - np.int64(normaliser[y, x]), np.int64(0)))
            posterior[y, x] = half * likelihood[above] + share * np.float32(won[y, x])
