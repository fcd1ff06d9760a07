"""Fusion of the layers' colour densities: unknown is neither likely nor unlikely (§6.2).

A layer reports its density p of a pixel's colour as r = p/u, u the uniform density over colours, with the
number of samples behind it. With κ the confidence in that many samples, it counts as

    r' = κ r + (1 − κ) f,        f = max(1, Σ_k κ_k r_k / Σ_k κ_k).

A layer without samples is taken to explain a colour as well as the layers that have some, but never worse
than chance: if an object matches ground that the background has not seen yet, neither wins by colour, and the
contrast term decides; if it does not match, the background wins.

Differs from the paper, which has no rule for unknown pixels, and from the authors' program, in which all
layers become uniform where one has few samples.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mlbs_actors.appearance.colour_density import AppearanceParameters, confidence
from mlbs_actors.kernels.fast_log import row_log
from mlbs_actors.kernels.jit import compiled
from mlbs_actors.messages import COST_STEP, Array, LayerPosterior, Region

__all__ = [
    "RATIO_STEP",
    "FusedCosts",
    "add_appearance",
    "appearance_tables",
    "fused_costs",
    "with_appearance",
]

#: Quantum of log r, nats.
RATIO_STEP = 1.0 / 16.0


def with_appearance(
    cost: Array, log_ratio: Array, samples: Array, fallback: Array, weight: float, half_confidence: float
) -> Array:
    """Add −weight · log r' to a layer's other costs.

    Parameters
    ----------
    cost : (h, w) uint8
        Units of ``COST_STEP``.
    log_ratio, fallback : (h, w) int8
        log r and log f, units of ``RATIO_STEP``.
    samples : (h, w) uint8
    weight : float
    half_confidence : float
        Samples at which κ is one half.

    Returns
    -------
    (h, w) uint8
    """
    fused = np.empty(cost.shape, np.uint8)
    add_appearance(
        cost,
        log_ratio.view(np.uint8),
        samples,
        fallback.view(np.uint8),
        *appearance_tables(half_confidence),
        np.float32(weight / COST_STEP),
        fused,
    )
    return fused


@dataclass(frozen=True, slots=True)
class FusedCosts:
    """Costs of all layers in one box of cells.

    Attributes
    ----------
    cost : (K, h, w) uint8
        Every layer's whole cost, units of ``COST_STEP``; the layer's ``outside_cost`` outside its region.
    normaliser : (h, w) uint8
        −log Σ_k exp(−cost_k) over the layers whose regions hold the cell, units of ``COST_STEP``.
    fallback : (h, w) int8
        log f, units of ``RATIO_STEP``.
    places : (K, 4) int64
        Intersection of every layer's region with the box: first row, row past the last, first column, column
        past the last.
    """

    cost: Array
    normaliser: Array
    fallback: Array
    places: Array


def fused_costs(
    posteriors: Sequence[LayerPosterior], box: Region, weight: float, half_confidence: float
) -> FusedCosts:
    """Compare the layers in one box; a layer counts inside its region only.

    Parameters
    ----------
    posteriors : sequence of LayerPosterior
        In ascending layer id; the background's region contains the box.
    box : Region
        Where they are compared, in units of cells.
    weight, half_confidence : float
        As for :func:`with_appearance`.

    Returns
    -------
    FusedCosts
    """
    shape = (box.height, box.width)
    tables, strength = appearance_tables(half_confidence), np.float32(weight / COST_STEP)
    sent = [(one.cost, one.log_ratio.view(np.uint8), one.samples) for one in posteriors]
    corners = [(box.y - one.region.y // one.cell, box.x - one.region.x // one.cell) for one in posteriors]
    places = np.array(
        [
            _common_place(corner, one.samples.shape, shape)
            for corner, one in zip(corners, posteriors, strict=True)
        ]
    )
    known, matched = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    for place, corner, (_, ratio, samples) in zip(places, corners, sent, strict=True):
        _add_known(known, matched, place, corner, ratio, samples, tables)
    fallback = _fallback(known, matched)
    cost = np.empty((len(posteriors), *shape), np.uint8)
    total = np.zeros(shape, np.float32)
    for own, place, corner, layer, one in zip(cost, places, corners, sent, posteriors, strict=True):
        own[:] = one.outside_cost
        _fuse(own, total, place, corner, layer, fallback.view(np.uint8), (*tables, LIKELIHOOD), strength)
    return FusedCosts(cost, _normaliser(total), fallback, places)


@functools.lru_cache(maxsize=16)
def appearance_tables(half_confidence: float) -> tuple[Array, Array]:
    """Tabulate κ for 0 … 255 samples, and r for all values of log r, by their bits as an unsigned byte."""
    trust = confidence(
        np.arange(256, dtype=np.uint8), AppearanceParameters(half_confidence_samples=half_confidence)
    )
    ratio = np.arange(256, dtype=np.uint8).view(np.int8).astype(np.float32) * np.float32(RATIO_STEP)
    return trust, np.exp(ratio)


def _common_place(corner: tuple[int, int], own: tuple[int, ...], box: tuple[int, int]) -> list[int]:
    """Return the rows and columns in which a layer's region and a box intersect; ``corner`` is the box's,
    relative to the region's, cells."""
    place = []
    for offset, own_length, length in zip(corner, own, box, strict=True):
        first = max(-offset, 0)
        place += [first, max(min(own_length - offset, length), first)]
    return place


@compiled
def _add_known(
    known: Array, matched: Array, place: Array, corner: tuple[int, int], log_ratio: Array, samples: Array,
    tables: tuple[Array, Array],
) -> None:  # fmt: skip
    """Add κ and κ r of a layer where it intersects the box; log r comes as unsigned bytes."""
    (down, right), (trust, ratio_of) = corner, tables
    for y in range(place[0], place[1]):
        counts, ratios, knowing, matching = samples[y + down], log_ratio[y + down], known[y], matched[y]
        for x in range(place[2], place[3]):
            at, place_of_own = np.uint64(x), np.uint64(x + right)
            own = trust[counts[place_of_own]]
            knowing[at] += own
            matching[at] += own * ratio_of[ratios[place_of_own]]


@compiled
def _fallback(known: Array, matched: Array) -> Array:
    height, width = known.shape
    fallback = np.empty((height, width), np.int8)
    mean, logs = np.empty(width, np.float32), np.empty(width, np.float32)
    one, quanta = np.float32(1), np.float32(1.0 / RATIO_STEP)
    for y in range(height):
        for x in range(width):
            mean[x] = matched[y, x] / known[y, x] if matched[y, x] > known[y, x] else one
        row_log(mean, logs)
        for x in range(width):
            fallback[y, x] = np.int8(np.int32(min(np.rint(logs[x] * quanta), np.float32(127))))
    return fallback


@compiled
def add_appearance(
    cost: Array,
    log_ratio: Array,
    samples: Array,
    fallback: Array,
    trust: Array,
    ratio_of: Array,
    strength: np.float32,
    fused: Array,
) -> None:
    """Compute cost − strength · log r'; log r and log f come as unsigned bytes."""
    height, width = cost.shape
    ratio, logs = np.empty(width, np.float32), np.empty(width, np.float32)
    one, least, most = np.float32(1), np.float32(0), np.float32(255)
    for y in range(height):
        counts, ratios, fallbacks = samples[y], log_ratio[y], fallback[y]
        for x in range(width):
            at = np.uint64(x)
            own = trust[counts[at]]
            ratio[at] = own * ratio_of[ratios[at]] + (one - own) * ratio_of[fallbacks[at]]
        row_log(ratio, logs)
        for x in range(width):
            value = np.rint(np.float32(cost[y, x]) - strength * logs[x])
            fused[y, x] = np.uint8(np.int32(min(max(value, least), most)))


@compiled
def _fuse(
    fused: Array, total: Array, place: Array, corner: tuple[int, int], sent: tuple[Array, Array, Array],
    fallback: Array, tables: tuple[Array, Array, Array], strength: np.float32,
) -> None:  # fmt: skip
    """Write one layer's whole cost where it intersects the box, and add its likelihood to the total."""
    (down, right), (cost, log_ratio, samples), (trust, ratio_of, likelihood) = corner, sent, tables
    rows, columns = slice(place[0], place[1]), slice(place[2], place[3])
    own_rows = slice(place[0] + down, place[1] + down)
    own_columns = slice(place[2] + right, place[3] + right)
    part, sums = fused[rows, columns], total[rows, columns]
    add_appearance(
        cost[own_rows, own_columns],
        log_ratio[own_rows, own_columns],
        samples[own_rows, own_columns],
        fallback[rows, columns],
        trust,
        ratio_of,
        strength,
        part,
    )
    for y in range(part.shape[0]):
        for x in range(part.shape[1]):
            sums[y, x] += likelihood[part[y, x]]


@compiled
def _normaliser(total: Array) -> Array:
    height, width = total.shape
    normaliser, logs = np.empty((height, width), np.uint8), np.empty(width, np.float32)
    quanta, least, most = np.float32(-1.0 / COST_STEP), np.float32(0), np.float32(255)
    for y in range(height):
        row_log(total[y], logs)
        for x in range(width):
            value = np.rint(quanta * logs[x])
            normaliser[y, x] = np.uint8(np.int32(min(max(value, least), most)))
    return normaliser


#: exp(−cost) of all 256 costs.
LIKELIHOOD = np.exp(np.arange(256, dtype=np.float32) * np.float32(-COST_STEP))
