"""The density estimate against the formula written out, and what a layer needs of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mlbs_actors.appearance.colour_density import (
    AppearanceParameters,
    confidence,
    log_likelihood,
    warp_and_evaluate,
)
from mlbs_actors.appearance.colour_model import SPREAD_STEP, AppearanceModel, empty_model, update, warp_model
from mlbs_actors.appearance.fusion import RATIO_STEP
from mlbs_actors.layer.posterior_terms import LOG_UNIFORM
from mlbs_actors.messages import Array, Region

#: Less is sent as this: the least of an int8, in steps.
LEAST_THAT_COUNTS = LOG_UNIFORM - 128 * RATIO_STEP
REGION = Region(0, 0, 12, 9)
PARAMETERS = AppearanceParameters()


def model_with_gaps(seed: int, region: Region = REGION, capacity: int = 7) -> AppearanceModel:
    """Every number of samples from 0 to all, smooth colours, uneven spread and residual."""
    rng = np.random.default_rng(seed)
    shape = (region.height, region.width)
    return AppearanceModel(
        region,
        (100 + rng.integers(0, 40, (*shape, 3, capacity))).astype(np.uint8),
        rng.integers(0, capacity + 1, shape).astype(np.uint8),
        np.zeros(shape, np.uint8),
        rng.integers(0, 120, shape).astype(np.uint8),
        rng.uniform(-0.5, 0.5, (*shape, 2)).astype(np.float32),
    )


def smooth_image(seed: int, region: Region = REGION) -> Array:
    rng = np.random.default_rng(seed)
    return (100 + rng.integers(0, 40, (region.height, region.width, 3))).astype(np.uint8)


def plain_density(model: AppearanceModel, y: int, x: int, colour: Array, floor: float) -> float:
    """1/n Σ_f Π_ch N(c_ch; c_f,ch, σ²)."""
    sigma = max(float(model.spread[y, x]) * SPREAD_STEP, floor)
    samples = model.samples[y, x, :, : model.count[y, x]].astype(np.float64).T
    kernels = np.exp(-((colour - samples) ** 2) / (2 * sigma**2)) / (sigma * np.sqrt(2 * np.pi))
    return float(kernels.prod(axis=1).mean())


def plain_colour(image: Array, y: float, x: float) -> Array:
    y, x = min(max(y, 0), image.shape[0] - 1), min(max(x, 0), image.shape[1] - 1)
    colour = np.zeros(3)
    for row in range(image.shape[0]):
        for column in range(image.shape[1]):
            share = max(0.0, 1 - abs(row - y)) * max(0.0, 1 - abs(column - x))
            colour += share * image[row, column]
    return colour


@pytest.mark.parametrize("capacity", [7, 16, 20, 32])
@pytest.mark.parametrize("region", [REGION, Region(0, 0, 37, 5)])
def test_the_density_is_that_of_the_formula(region: Region, capacity: int) -> None:
    model, image = model_with_gaps(0, region, capacity), smooth_image(1, region)
    result = log_likelihood(model, image, PARAMETERS)
    for y in range(region.height):
        for x in range(region.width):
            if model.count[y, x] == 0:
                assert np.isnan(result[y, x])
                continue
            colour = plain_colour(image, y + model.residual[y, x, 1], x + model.residual[y, x, 0])
            expected = np.log(plain_density(model, y, x, colour, PARAMETERS.bandwidth_floor))
            if expected > LEAST_THAT_COUNTS:
                assert abs(result[y, x] - expected) < 1e-3
            else:
                assert result[y, x] < LEAST_THAT_COUNTS + 1e-3


def test_an_impossible_colour_is_as_unlikely_as_can_count_and_finite() -> None:
    model = empty_model(REGION)
    update(model, np.zeros((9, 12, 3), np.uint8), np.ones((9, 12), bool))
    result = log_likelihood(model, np.full((9, 12, 3), 255, np.uint8), PARAMETERS)
    assert np.isfinite(result).all()
    assert (result < LEAST_THAT_COUNTS).all()


def test_the_number_of_samples_is_no_prior() -> None:
    image = smooth_image(2)
    few, many = empty_model(REGION), empty_model(REGION)
    update(few, image, np.ones((9, 12), bool))
    for _ in range(20):
        update(many, image, np.ones((9, 12), bool))
    np.testing.assert_allclose(
        log_likelihood(few, image, PARAMETERS), log_likelihood(many, image, PARAMETERS), atol=1e-5
    )


def test_only_needed_pixels_are_evaluated_and_get_the_same_values() -> None:
    model, image = model_with_gaps(3), smooth_image(4)
    needed = np.random.default_rng(5).random((9, 12)) < 0.3
    everywhere = log_likelihood(model, image, PARAMETERS)
    partly = log_likelihood(model, image, PARAMETERS, needed)
    np.testing.assert_array_equal(partly, np.where(needed, everywhere, np.nan))


def test_moving_and_evaluating_at_once_is_moving_everywhere_and_then_evaluating_where_needed() -> None:
    model, image = model_with_gaps(6), smooth_image(7)
    motion = np.random.default_rng(8).normal(0, 1, (9, 12, 2)).astype(np.float32)
    needed = np.random.default_rng(9).random((9, 12)) < 0.5
    moved, result = warp_and_evaluate(model, REGION, motion, image, PARAMETERS, needed)
    expected = warp_model(model, REGION, motion)
    np.testing.assert_array_equal(moved.samples, expected.samples)
    np.testing.assert_array_equal(result, log_likelihood(expected, image, PARAMETERS, needed))


def texture(x: Array, y: Array) -> Array:
    """Static texture with a period of about 12 px, at any sub-pixel position."""
    waves = [120 + 60 * np.sin(x / 2 + phase) * np.cos(y / 2.3 - phase) for phase in (0.0, 1.0, 2.0)]
    image: Array = np.rint(np.dstack(waves)).astype(np.uint8)
    return image


def test_a_static_texture_keeps_its_likelihood_under_fifty_frames_of_slow_pan() -> None:
    region = Region(0, 0, 80, 24)
    everywhere = np.ones((24, 80), bool)
    y, x = np.mgrid[:24, :80].astype(np.float64)
    motion = np.full((24, 80, 2), (0.3, 0.0), np.float32)
    model = empty_model(region)
    update(model, texture(x, y), everywhere)
    best = float(np.median(log_likelihood(model, texture(x, y), PARAMETERS)))
    typical = []
    for frame in range(1, 51):  # nothing is learnt any more: only the carrying can go wrong
        model, result = warp_and_evaluate(model, region, motion, texture(x + 0.3 * frame, y), PARAMETERS)
        typical.append(float(np.nanmedian(result)))
    assert min(typical) > best - 0.3
    assert np.mean(typical[40:]) > np.mean(typical[:10]) - 0.1


def plain_slope(image: Array, y: int, x: int) -> float:
    """Squared steepest slope of any channel, per direction, of the mirrored image, grey levels²/px²."""
    padded = np.pad(image.astype(np.float64), ((1, 1), (1, 1), (0, 0)), mode="reflect")
    window = padded[y : y + 3, x : x + 3]
    weights = np.array([1.0, 2.0, 1.0]) / 8
    across = np.tensordot(weights, window[:, 2] - window[:, 0], 1)
    down = np.tensordot(weights, window[2] - window[0], 1)
    return float(np.abs(across).max() ** 2 + np.abs(down).max() ** 2)


@pytest.mark.parametrize("registration", [0.6, 1.0])
def test_where_the_image_is_steep_a_registration_error_widens_the_bandwidth(registration: float) -> None:
    parameters = replace(PARAMETERS, registration=registration)
    model, image = model_with_gaps(6), smooth_image(7)
    image[:, 6:] //= 2  # an edge
    still = np.zeros((9, 12, 2), np.float32)
    moved, result = warp_and_evaluate(model, REGION, still, image, parameters)
    expected = warp_model(model, REGION, still)
    np.testing.assert_array_equal(moved.spread, expected.spread)  # the model itself keeps its own
    floors = np.zeros((9, 12))
    for y in range(9):
        for x in range(12):
            floor = np.sqrt(parameters.bandwidth_floor**2 + registration**2 * plain_slope(image, y, x))
            floors[y, x] = round(floor / SPREAD_STEP)
    assert floors.max() > 1.5 * floors.min()
    spread = np.maximum(expected.spread, np.clip(floors, 0, 255).astype(np.uint8))
    np.testing.assert_array_equal(result, log_likelihood(replace(expected, spread=spread), image, PARAMETERS))


def test_on_smooth_ground_a_registration_error_changes_nothing() -> None:
    model, image = model_with_gaps(6), np.full((9, 12, 3), 120, np.uint8)
    still = np.zeros((9, 12, 2), np.float32)
    _, exact = warp_and_evaluate(model, REGION, still, image, PARAMETERS)
    _, inexact = warp_and_evaluate(model, REGION, still, image, replace(PARAMETERS, registration=1.0))
    np.testing.assert_array_equal(exact, inexact)


def test_an_outline_that_is_a_pixel_out_of_place_contradicts_less_where_that_is_expected() -> None:
    y, x = np.mgrid[:24, :80].astype(np.float64)
    region, everywhere = Region(0, 0, 80, 24), np.ones((24, 80), bool)
    model = empty_model(region)
    for _ in range(5):
        update(model, texture(x, y), everywhere)
    still = np.zeros((24, 80, 2), np.float32)
    medians = []
    for registration in (0.0, 0.5, 1.0):
        parameters = replace(PARAMETERS, registration=registration)
        _, result = warp_and_evaluate(model, region, still, texture(x + 1.0, y), parameters)
        medians.append(float(np.median(result)))
    assert medians[0] < LOG_UNIFORM < min(medians[1:])


def test_confidence_grows_with_the_samples_and_is_nothing_without() -> None:
    trust = confidence(np.arange(21, dtype=np.uint8), PARAMETERS)
    assert trust[0] == 0
    assert trust[2] == 0.5
    assert (np.diff(trust) > 0).all()
    assert trust[-1] < 1
