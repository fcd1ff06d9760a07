"""What the layers' colours say together, against plain loops."""

from __future__ import annotations

from math import exp, log

import numpy as np
import pytest

from mlbs_actors.appearance.fusion import RATIO_STEP, fused_costs, with_appearance
from mlbs_actors.messages import BACKGROUND, COST_STEP, Array, LayerPosterior, Region, readonly

SHAPE = (18, 24)
WHOLE = Region(0, 0, SHAPE[1], SHAPE[0])
WEIGHT, HALF = 0.5, 2.0
UNKNOWN, MATCHED, CONTRADICTED = (0, 0), (20, 40), (20, -60)


def posterior(layer: int, region: Region, cost: Array, log_ratio: Array, samples: Array) -> LayerPosterior:
    made = LayerPosterior(
        layer=layer,
        frame_index=0,
        kind="object" if layer else "background",
        region=region,
        cell=1,
        cost=cost,
        log_ratio=log_ratio,
        samples=samples,
        outside_cost=255,
        confidence=0.5,
        velocity=np.zeros(2, np.float32),
    )
    return readonly(made)


def random_posteriors(seed: int) -> list[LayerPosterior]:
    """Three layers; many pixels without samples, some unknown to all."""
    rng = np.random.default_rng(seed)
    made = []
    for layer, region in ((0, WHOLE), (3, Region(2, 4, 15, 9)), (8, Region(10, 1, 14, 16))):
        shape = (region.height, region.width)
        samples = rng.integers(0, 21, shape) * (rng.random(shape) < 0.6)
        ratio = np.where(samples > 0, rng.integers(-128, 49, shape), 0)
        made.append(
            posterior(
                layer,
                region,
                rng.integers(0, 256, shape).astype(np.uint8),
                ratio.astype(np.int8),
                samples.astype(np.uint8),
            )
        )
    return made


def uniform(layer: int, knowledge: tuple[int, int], cost: int = 64) -> LayerPosterior:
    """The same (samples, log ratio in quanta) everywhere."""
    samples, ratio = knowledge
    return posterior(
        layer,
        WHOLE,
        np.full(SHAPE, cost, np.uint8),
        np.full(SHAPE, ratio, np.int8),
        np.full(SHAPE, samples, np.uint8),
    )


def costs(*knowledge: tuple[int, int]) -> list[int]:
    """Fused cost of each layer, all else being equal."""
    cost = fused_costs([uniform(k, own) for k, own in enumerate(knowledge)], WHOLE, WEIGHT, HALF).cost
    assert all(np.ptp(one) == 0 for one in cost)
    return [int(one[0, 0]) for one in cost]


def place(one: LayerPosterior, y: int, x: int) -> tuple[int, int] | None:
    row, column = y - one.region.y, x - one.region.x
    inside = 0 <= row < one.region.height and 0 <= column < one.region.width
    return (row, column) if inside else None


def plain(posteriors: list[LayerPosterior], y: int, x: int, fallback: float) -> list[float]:
    """Fused costs of one pixel, from the log of its fallback, nats."""
    found = []
    for one in posteriors:
        at = place(one, y, x)
        if at is None:
            found.append(float(one.outside_cost))
            continue
        trust = int(one.samples[at]) / (int(one.samples[at]) + HALF)
        ratio = trust * exp(int(one.log_ratio[at]) * RATIO_STEP) + (1 - trust) * exp(fallback)
        found.append(min(max(int(one.cost[at]) - WEIGHT * log(ratio) / COST_STEP, 0.0), 255.0))
    return found


@pytest.mark.parametrize("seed", range(3))
def test_the_fallback_is_the_trusted_mean_of_what_is_known_but_never_below_chance(seed: int) -> None:
    posteriors = random_posteriors(seed)
    fallback = fused_costs(posteriors, WHOLE, WEIGHT, HALF).fallback
    assert fallback.dtype == np.int8
    chance = 0
    for y in range(SHAPE[0]):
        for x in range(SHAPE[1]):
            known = matched = 0.0
            for one in posteriors:
                at = place(one, y, x)
                if at is not None:
                    trust = int(one.samples[at]) / (int(one.samples[at]) + HALF)
                    known += trust
                    matched += trust * exp(int(one.log_ratio[at]) * RATIO_STEP)
            expected = log(max(1.0, matched / known)) if known else 0.0
            chance += expected == 0.0
            assert abs(int(fallback[y, x]) - expected / RATIO_STEP) <= 0.5 + 1e-3
    assert 0 < chance < SHAPE[0] * SHAPE[1]


@pytest.mark.parametrize("seed", range(3))
def test_the_fused_costs_are_those_of_plain_loops(seed: int) -> None:
    posteriors = random_posteriors(seed)
    fused = fused_costs(posteriors, WHOLE, WEIGHT, HALF)
    cost, fallback = fused.cost, fused.fallback
    assert cost.shape == (len(posteriors), *SHAPE)
    assert cost.dtype == np.uint8
    for y in range(SHAPE[0]):
        for x in range(SHAPE[1]):
            expected = plain(posteriors, y, x, int(fallback[y, x]) * RATIO_STEP)
            np.testing.assert_allclose(cost[:, y, x], expected, atol=0.5 + 1e-3)


@pytest.mark.parametrize("seed", range(3))
def test_the_normaliser_is_that_of_plain_loops(seed: int) -> None:
    posteriors = random_posteriors(seed)
    fused = fused_costs(posteriors, WHOLE, WEIGHT, HALF)
    assert fused.normaliser.dtype == np.uint8
    for y in range(SHAPE[0]):
        for x in range(SHAPE[1]):
            having_a_say = [k for k, one in enumerate(posteriors) if place(one, y, x) is not None]
            total = sum(exp(-COST_STEP * int(fused.cost[k, y, x])) for k in having_a_say)
            expected = min(max(-log(total) / COST_STEP, 0.0), 255.0)
            assert abs(float(fused.normaliser[y, x]) - expected) <= 0.5 + 1e-3


@pytest.mark.parametrize("box", [Region(0, 0, 12, 9), Region(5, 3, 14, 12), Region(20, 10, 4, 8)])
def test_a_box_is_fused_as_the_whole_frame_is(box: Region) -> None:
    posteriors = random_posteriors(1)
    whole, part = fused_costs(posteriors, WHOLE, WEIGHT, HALF), fused_costs(posteriors, box, WEIGHT, HALF)
    np.testing.assert_array_equal(part.cost, whole.cost[(slice(None), *box.slices)])
    np.testing.assert_array_equal(part.normaliser, whole.normaliser[box.slices])
    np.testing.assert_array_equal(part.fallback, whole.fallback[box.slices])


@pytest.mark.parametrize("seed", range(3))
def test_a_layer_finds_its_fused_cost_again_from_the_fallback(seed: int) -> None:
    posteriors = random_posteriors(seed)
    fused = fused_costs(posteriors, WHOLE, WEIGHT, HALF)
    for one, cost in zip(posteriors, fused.cost, strict=True):
        others = np.ascontiguousarray(fused.fallback[one.region.slices])
        own = with_appearance(one.cost, one.log_ratio, one.samples, others, WEIGHT, HALF)
        np.testing.assert_array_equal(own, cost[one.region.slices])


def test_where_one_layer_matches_what_the_other_does_not_know_it_is_a_tie() -> None:
    assert len(set(costs(UNKNOWN, MATCHED))) == 1
    assert len(set(costs(MATCHED, UNKNOWN))) == 1
    assert costs(UNKNOWN, MATCHED)[0] < 64


def test_where_one_layer_is_contradicted_the_one_that_does_not_know_is_cheaper() -> None:
    unknown, contradicted = costs(UNKNOWN, CONTRADICTED)
    assert unknown == 64  # as likely as by chance, and no less
    assert contradicted > unknown + 10


def test_what_no_layer_knows_changes_nothing() -> None:
    assert costs(UNKNOWN, UNKNOWN) == [64, 64]


def test_of_two_that_know_the_one_that_matches_is_cheaper() -> None:
    matched, contradicted = costs(MATCHED, CONTRADICTED)
    assert matched < 64 < contradicted


def test_the_more_samples_contradict_a_colour_the_dearer_it_is() -> None:
    paid = [costs(UNKNOWN, (samples, -60))[1] for samples in (1, 2, 5, 10, 20)]
    assert paid == sorted(set(paid))


def test_outside_its_region_a_layer_keeps_its_outside_cost_and_tells_nothing() -> None:
    region = Region(4, 5, 6, 7)
    matched = posterior(
        2, region, np.full((7, 6), 64, np.uint8), np.full((7, 6), 40, np.int8), np.full((7, 6), 20, np.uint8)
    )
    fused = fused_costs([uniform(BACKGROUND, UNKNOWN), matched], WHOLE, WEIGHT, HALF)
    cost, fallback = fused.cost, fused.fallback
    inside = np.zeros(SHAPE, bool)
    inside[region.slices] = True
    assert (cost[1][~inside] == 255).all()
    assert (cost[0][~inside] == 64).all()
    np.testing.assert_array_equal(fallback > 0, inside)
    assert (fused.normaliser[~inside] == 64).all()
    assert (fused.normaliser[inside] < 64).all()


def test_with_a_fallback_of_chance_a_layer_is_judged_by_its_own_confidence() -> None:
    rng = np.random.default_rng(4)
    cost = rng.integers(60, 100, SHAPE).astype(np.uint8)
    ratio = rng.integers(-128, 49, SHAPE).astype(np.int8)
    samples = rng.integers(0, 21, SHAPE).astype(np.uint8)
    found = with_appearance(cost, ratio, samples, np.zeros(SHAPE, np.int8), WEIGHT, HALF)
    for y in range(SHAPE[0]):
        for x in range(SHAPE[1]):
            trust = int(samples[y, x]) / (int(samples[y, x]) + HALF)
            own = log((1 - trust) + trust * exp(int(ratio[y, x]) * RATIO_STEP))
            assert abs(int(found[y, x]) - (int(cost[y, x]) - WEIGHT * own / COST_STEP)) <= 0.5 + 1e-3


def test_costs_are_cut_and_do_not_wrap_around() -> None:
    for cost, ratio, expected in ((0, 127, 0), (255, -128, 255)):
        found = with_appearance(
            np.full(SHAPE, cost, np.uint8),
            np.full(SHAPE, ratio, np.int8),
            np.full(SHAPE, 255, np.uint8),
            np.zeros(SHAPE, np.int8),
            2.0,
            HALF,
        )
        assert (found == expected).all()
