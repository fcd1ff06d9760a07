"""The kernels of a layer's posterior against array operations that say the same."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from layer_fakes import SHAPE, frame_of, published

from mlbs_actors.appearance.fusion import RATIO_STEP, with_appearance
from mlbs_actors.config import Config, length_scale
from mlbs_actors.layer.posterior_terms import (
    LOG_UNIFORM,
    Prediction,
    finished_posterior,
    posterior_cost,
    quantised_colours,
    uncontested_cost,
)
from mlbs_actors.messages import (
    COST_STEP,
    UNEXPLAINED_STEP,
    Array,
    FrameEvidence,
    LayerKind,
    Region,
    readonly,
)

REGION = Region(31, 20, 90, 70)
SIZE = (REGION.height, REGION.width)
CONFIG = Config.model_validate({"posterior": {"motion": 0.8, "prior": 0.7, "offset": 3.0}})


def evidence_of(seed: int) -> FrameEvidence:
    """Flow, reliability and explanation that differ from place to place."""
    rng = np.random.default_rng(seed)
    made = replace(
        frame_of([]),
        flow=rng.normal(0, 2, (*SHAPE, 2)).astype(np.float32),
        flow_reliable=rng.random(SHAPE) < 0.6,
        unexplained=rng.integers(0, 100, SHAPE).astype(np.uint8),
    )
    return readonly(made)


def nats_by_arrays(
    kind: LayerKind,
    evidence: FrameEvidence,
    side: int,
    motion: Array,
    variance: Array,
    prior: tuple[Array, Array],
    away: Array,
    advantage: Array,
) -> Array:
    weights, background = CONFIG.posterior, kind == "background"
    spread = variance + (CONFIG.motion.flow_std_px * length_scale(*SHAPE)) ** 2
    distance = np.square(evidence.flow[REGION.slices] - side * motion).sum(axis=2) / spread
    floor = weights.motion_floor if background else weights.object_motion_floor
    agreement = floor + (1 - floor) * np.exp(-0.5 * distance)
    noise = evidence.unexplained[REGION.slices] * UNEXPLAINED_STEP / CONFIG.layers.unexplained_noise
    heard = evidence.flow_reliable[REGION.slices] * np.clip(2 * noise - 1, 0, 1)
    believed = prior[0] + (1 - prior[1]) * weights.neutral_prior
    believed = np.maximum(believed, weights.neutral_prior if background else weights.prior_floor)
    terms = -weights.motion * heard * np.log(agreement) - weights.prior * np.log(believed)
    return np.asarray(weights.offset + terms + weights.distance * away - weights.photometric * advantage)


@pytest.mark.parametrize("side", [1, 3])
@pytest.mark.parametrize("kind", ["background", "object"])
def test_the_cost_is_the_weighted_sum_of_the_terms_where_it_is_needed(kind: LayerKind, side: int) -> None:
    rng, evidence = np.random.default_rng(0), evidence_of(1)
    motion = rng.normal(0, 2, (*SIZE, 2)).astype(np.float32)
    variance = rng.uniform(0.01, 3, SIZE).astype(np.float32)
    share = rng.choice([0.0, 0.4, 1.0], SIZE).astype(np.float32)
    prior = (share * rng.random(SIZE)).astype(np.float32), share
    away, advantage = rng.normal(0, 3, (2, *SIZE)).astype(np.float32)
    needed = rng.random(SIZE) < 0.7
    prediction = Prediction(REGION, side, needed, motion, variance, prior, away, advantage)
    found = posterior_cost(CONFIG, kind, evidence, prediction)
    expected = nats_by_arrays(kind, evidence, side, motion, variance, prior, away, advantage) / COST_STEP
    assert (found[~needed] == uncontested_cost(CONFIG)).all()
    assert np.abs(found - np.clip(expected, 0, 255))[needed].max() < 0.5 + 0.05  # of the tables
    assert np.ptp(found[needed]) > 50


def test_a_cost_is_held_inside_its_byte() -> None:
    zeros, still = np.zeros(SIZE, np.float32), np.zeros((*SIZE, 2), np.float32)
    advantage = np.where(np.arange(SIZE[1]) < 40, 1e4, -1e4) * np.ones(SIZE)
    everywhere = np.ones(SIZE, bool)
    prediction = Prediction(
        REGION, 1, everywhere, still, zeros, (zeros, zeros), zeros, advantage.astype(np.float32)
    )
    found = posterior_cost(CONFIG, "object", evidence_of(2), prediction)
    assert (found[:, :40] == 0).all()
    assert (found[:, 40:] == 255).all()


def test_where_no_object_can_be_the_background_costs_the_offset() -> None:
    assert uncontested_cost(CONFIG) * COST_STEP == 3.0


def test_the_colours_are_quantised_as_the_fusion_reads_them() -> None:
    rng = np.random.default_rng(3)
    count = rng.integers(0, 4, SIZE).astype(np.uint8)
    density = np.where(count > 0, rng.uniform(-45, -5, SIZE), np.nan).astype(np.float32)
    needed = rng.random(SIZE) < 0.7
    log_ratio, samples = quantised_colours(density, count, needed, 3.0)
    ratio = np.minimum(np.nan_to_num(density, nan=LOG_UNIFORM) - np.float32(LOG_UNIFORM), 3.0)
    expected = np.clip(np.rint(ratio / RATIO_STEP), -128, 127).astype(np.int8)
    np.testing.assert_array_equal(log_ratio, np.where(needed, expected, 0))
    np.testing.assert_array_equal(samples, np.where(needed, count, 0))
    assert log_ratio.min() == -128
    assert log_ratio.max() == 48


def test_the_finished_posterior_is_normalised_and_half_of_it_is_the_published_map() -> None:
    rng = np.random.default_rng(4)
    cost, samples = (rng.integers(0, most, SIZE).astype(np.uint8) for most in (256, 5))
    log_ratio = np.where(samples > 0, rng.integers(-128, 128, SIZE), 0).astype(np.int8)
    won = rng.integers(0, 256, SIZE).astype(np.uint8)
    result = replace(
        published(0, np.zeros(SHAPE, int)),
        normaliser=rng.integers(0, 256, SHAPE).astype(np.uint8),
        fallback=rng.integers(0, 128, SHAPE).astype(np.int8),
    )
    found = finished_posterior(CONFIG, (cost, log_ratio, samples), readonly(result), REGION, won)
    fallback = np.ascontiguousarray(result.fallback[REGION.slices])
    weight, half = CONFIG.posterior.appearance, CONFIG.appearance.half_confidence_samples
    fused = with_appearance(cost, log_ratio, samples, fallback, weight, half)
    above = np.maximum(fused.astype(float) - result.normaliser[REGION.slices], 0) * COST_STEP
    expected = 0.5 * np.exp(-above) + 0.5 * won / 255
    # A cost on the edge of two quanta may fall to either.
    assert np.mean(np.abs(found - expected) > 1e-6) < 1e-3
    assert np.abs(found - expected).max() < 0.5 * COST_STEP
