"""The regional colour model against plain loops."""

from __future__ import annotations

import itertools

import numpy as np

from mlbs_actors.colour_histogram import ColourHistogram
from mlbs_actors.messages import Array


def random_image(seed: int, low: int = 0, high: int = 256) -> Array:
    return np.random.default_rng(seed).integers(low, high, (12, 15, 3)).astype(np.uint8)


def test_two_frames_give_the_density_of_the_plain_loops() -> None:
    bins, forgetting, uniform = 4, 0.25, 0.1
    images = [random_image(0), random_image(1, 0, 128)]
    masks = [np.random.default_rng(2).random((12, 15)) < 0.5, np.ones((12, 15), bool)]
    model = ColourHistogram.empty(bins, forgetting, uniform)
    weights = np.zeros((bins,) * 3)
    for image, mask in zip(images, masks, strict=True):
        model = model.update(image, mask)
        weights *= 1 - forgetting
        for colour in image[mask]:
            weights[tuple(colour // 64)] += 1 / mask.sum()
    smooth = np.zeros_like(weights)
    for place in itertools.product(range(bins), repeat=3):
        for offset in itertools.product((-1, 0, 1), repeat=3):
            share = np.prod([0.5 if step == 0 else 0.25 for step in offset])
            near = tuple(min(max(p + step, 0), bins - 1) for p, step in zip(place, offset, strict=True))
            smooth[place] += share * weights[near]
    density = (1 - uniform) * smooth / weights.sum() / 64**3 + uniform / 256**3
    expected = np.log(density)[tuple(np.moveaxis(images[0] // 64, 2, 0))]
    np.testing.assert_allclose(model.log_likelihood(images[0]), expected, rtol=1e-5)


def test_the_density_over_all_colours_integrates_to_one() -> None:
    model = ColourHistogram.empty(16).update(random_image(3, 0, 60), np.ones((12, 15), bool))
    centres = np.arange(16) * 16 + 8
    every_bin = np.stack(np.meshgrid(centres, centres, centres), axis=-1).reshape(64, 64, 3).astype(np.uint8)
    assert np.isclose(
        np.exp(model.log_likelihood(every_bin).astype(np.float64)).sum() * 16**3, 1.0, rtol=1e-4
    )


def test_an_empty_model_finds_every_colour_equally_likely() -> None:
    np.testing.assert_allclose(
        ColourHistogram.empty().log_likelihood(random_image(4)), -3 * np.log(256.0), rtol=1e-6
    )


def test_an_empty_mask_teaches_nothing_and_forgets_nothing() -> None:
    model = ColourHistogram.empty().update(random_image(5), np.ones((12, 15), bool))
    same = model.update(random_image(6), np.zeros((12, 15), bool))
    np.testing.assert_array_equal(same.weights, model.weights)


def test_old_colours_fade_and_new_ones_take_over() -> None:
    dark, light = random_image(7, 0, 40), random_image(8, 200, 240)
    everywhere = np.ones((12, 15), bool)
    model = ColourHistogram.empty(forgetting=0.2).update(dark, everywhere)
    before = model.log_likelihood(dark).mean()
    for _ in range(30):
        model = model.update(light, everywhere)
    assert model.log_likelihood(dark).mean() < before - 3
    assert model.log_likelihood(light).mean() > model.log_likelihood(dark).mean() + 3
