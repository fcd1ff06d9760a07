"""What the layers' colours say when they are compared: unknown is neither likely nor unlikely (§6.2).

A layer tells its density p of a pixel's colour as r = p/u, u the uniform density over colours, and how many
samples stand behind it. With κ the confidence in that many samples, it counts as

    r' = κ r + (1 − κ) f,        f = max(1, Σ_k κ_k r_k / Σ_k κ_k).

What a layer does not know it is so taken to explain as well as those that do know, but never worse than by
chance: if an object matches ground that the background has not seen yet, neither wins by it, and the
outlines decide; if it does not match, the background wins.

Differs from the paper, which has no rule for unknown pixels, and from the authors' program, in which all
layers become uniform where one has few samples.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mlbs_actors.kde import AppearanceParameters, confidence
from mlbs_actors.messages import COST_STEP, Array, LayerPosterior

__all__ = ["RATIO_STEP", "fused_costs", "quantised_ratio", "with_appearance"]

#: Quantum of log r, nats.
RATIO_STEP = 1.0 / 16.0


def quantised_ratio(log_ratio: Array, largest: float) -> Array:
    """Log r in quanta, held between −8 and ``largest`` (at most 7.9) nats.

    Parameters
    ----------
    log_ratio : (h, w) float32
        Nats.
    largest : float

    Returns
    -------
    (h, w) int8
    """
    return np.asarray(np.clip(np.rint(np.minimum(log_ratio, largest) / RATIO_STEP), -128, 127), np.int8)


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
    trust = confidence(samples, AppearanceParameters(half_confidence_samples=half_confidence))
    ratio = trust * _EXP[log_ratio.view(np.uint8)] + (1.0 - trust) * _EXP[fallback.view(np.uint8)]
    return np.asarray(
        np.clip(np.rint(cost - np.float32(weight / COST_STEP) * np.log(ratio)), 0, 255), np.uint8
    )


def fused_costs(
    posteriors: Sequence[LayerPosterior], shape: tuple[int, int], weight: float, half_confidence: float
) -> tuple[Array, Array]:
    """Every layer's whole cost on the whole frame.

    Parameters
    ----------
    posteriors : sequence of LayerPosterior
        In ascending layer id.
    shape : (H, W)
    weight, half_confidence : float
        As for :func:`with_appearance`.

    Returns
    -------
    cost : (K, H, W) uint8
        Units of ``COST_STEP``.
    fallback : (H, W) int8
        log f, units of ``RATIO_STEP``.
    """
    appearance = AppearanceParameters(half_confidence_samples=half_confidence)
    known, matched = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    for one in posteriors:
        trust = confidence(one.samples, appearance)
        known[one.region.slices] += trust
        matched[one.region.slices] += trust * _EXP[one.log_ratio.view(np.uint8)]
    mean = np.divide(matched, known, out=np.ones(shape, np.float32), where=known > 0)
    fallback = quantised_ratio(np.log(np.maximum(mean, 1.0)), np.inf)
    cost = np.empty((len(posteriors), *shape), np.uint8)
    for position, one in enumerate(posteriors):
        cost[position] = one.outside_cost
        cost[position][one.region.slices] = with_appearance(
            one.cost, one.log_ratio, one.samples, fallback[one.region.slices], weight, half_confidence
        )
    return cost, fallback


#: exp of all 256 values of log r, by their bits as an unsigned byte.
_EXP = np.exp(np.arange(256, dtype=np.uint8).view(np.int8).astype(np.float32) * np.float32(RATIO_STEP))
