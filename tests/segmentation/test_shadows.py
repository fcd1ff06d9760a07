"""Shadows: darker ground of the same hue is told from all that is none."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from joined_evidence import joined_evidence

from mlbs_actors.cells import mean_of_cells
from mlbs_actors.config import SegmentationConfig
from mlbs_actors.messages import BACKGROUND, Array, FrameEvidence, LayerEvidence, Region, readonly
from mlbs_actors.segmentation.shadows import (
    Darkening,
    _blur_weights,
    _smoothed,
    darkening,
    ground_colour,
    ground_likelihoods,
)

SHAPE = (240, 320)
ROAD = np.array([120.0, 125.0, 130.0])
CAR, PATCH = np.s_[80:120, 120:180], np.s_[122:150, 115:185]
#: Well inside the patch.
INNER = np.s_[127:145, 122:178]
NO_LABELS = np.zeros((0, 0), np.uint16)
CONFIG = SegmentationConfig()


def road(texture: float = 2.0, seed: int = 0) -> Array:
    noise = np.random.default_rng(seed).normal(0.0, texture, (*SHAPE, 3))
    return ROAD + noise


def picture(patch: Array | float, ground: Array | None = None) -> Array:
    """A red car on a grey road, and beneath it a patch that is the road times a factor."""
    image = road() if ground is None else ground.copy()
    image[PATCH] *= patch
    image[CAR] = (30.0, 30.0, 190.0)
    return np.asarray(np.clip(np.rint(image), 0, 255), np.uint8)


def evidence(image: Array, layer: int = 1, positions: Array | None = None, side: int = 1) -> FrameEvidence:
    """Trajectories all over the car, and the means of cells of ``side`` px."""
    x, y = np.meshgrid(np.arange(124, 178, 6), np.arange(84, 118, 6))
    at = np.stack([x.ravel(), y.ravel()], axis=1).astype(np.float32) if positions is None else positions
    everywhere = np.array([[10.0, 10.0], [300.0, 200.0], [140.0, 135.0]], np.float32)
    layers = [LayerEvidence(BACKGROUND, "background", 0, everywhere, np.zeros_like(everywhere))]
    if layer != BACKGROUND:
        layers.append(LayerEvidence(layer, "object", 0, at, np.zeros_like(at)))
    colours = mean_of_cells(image, side)
    cells = colours.shape[:2]
    made = joined_evidence(
        layers,
        frame_index=1,
        shape=image.shape[:2],
        camera=np.eye(3),
        flow=np.zeros((*cells, 2), np.float32),
        flow_reliable=np.zeros(cells, bool),
        unexplained=np.zeros(cells, np.uint8),
        colours=colours,
        retired=(),
        latency_frames=0,
    )
    return readonly(made)


def labels() -> Array:
    """Last frame's map: the car and, wrongly, its shadow."""
    previous = np.zeros(SHAPE, np.uint16)
    previous[CAR] = previous[PATCH] = 1
    return previous


def darkened(given: FrameEvidence, previous: Array = NO_LABELS) -> Darkening:
    """On the whole frame, of cells of one pixel."""
    ground = ground_colour(given, 1, previous, CONFIG)
    assert ground is not None
    return darkening(given.colours, ground, Region(0, 0, given.shape[1], given.shape[0]), 1.0)


def likelihood(image: Array, previous: Array = NO_LABELS) -> Array:
    return ground_likelihoods(darkened(evidence(image), previous), CONFIG)[0]


@pytest.mark.parametrize("factor", [0.7, 0.5, 0.3])
def test_darker_road_is_a_shadow_and_the_road_around_it_is_none(factor: float) -> None:
    found = likelihood(picture(factor), labels())
    assert found.shape == SHAPE
    assert found.dtype == np.float32
    assert found.min() >= 0.0
    assert found.max() <= 1.0
    assert found[INNER].mean() > 0.9
    away = np.ones(SHAPE, bool)
    away[70:160, 105:195] = False
    assert found[away].mean() < 0.01


def test_a_dark_patch_of_another_hue_is_no_shadow() -> None:
    found = likelihood(picture(np.array([0.35, 0.6, 0.85])), labels())
    assert found[INNER].max() < 0.1


def test_a_brighter_patch_is_no_shadow() -> None:
    assert likelihood(picture(1.4), labels())[INNER].max() == 0.0


def test_a_patch_as_bright_as_the_road_is_no_shadow() -> None:
    assert likelihood(picture(1.0), labels())[INNER].mean() < 0.05


def test_what_is_black_is_no_shadow() -> None:
    assert likelihood(picture(0.02), labels())[INNER].max() == 0.0


def test_the_car_is_no_shadow() -> None:
    assert likelihood(picture(0.5), labels())[85:115, 125:175].max() < 0.1


def test_on_strongly_textured_ground_nothing_is_said() -> None:
    coarse = np.random.default_rng(1).choice([0.25, 1.0, 1.8], (SHAPE[0] // 8, SHAPE[1] // 8))
    texture = cv2.resize(coarse, SHAPE[::-1], interpolation=cv2.INTER_NEAREST)
    found = likelihood(picture(0.5, road() * texture[..., None]), labels())
    assert found[INNER].mean() < 0.05


def test_without_an_object_there_is_nothing_that_could_cast_one() -> None:
    image = picture(0.5)
    none = np.zeros((0, 2), np.float32)
    for previous in (NO_LABELS, np.zeros(SHAPE, np.uint16)):
        assert ground_colour(evidence(image, BACKGROUND), 1, previous, CONFIG) is None
        assert ground_colour(evidence(image, 1, none), 1, previous, CONFIG) is None
    assert ground_colour(evidence(image, 1, none), 1, labels(), CONFIG) is not None


def test_what_is_given_is_only_read() -> None:
    image, previous = picture(0.5), labels()
    image.flags.writeable = previous.flags.writeable = False
    assert likelihood(image, previous).any()


def test_a_frame_without_any_ground_has_no_shadow() -> None:
    x, y = np.meshgrid(np.arange(0, SHAPE[1], 8), np.arange(0, SHAPE[0], 8))
    everywhere = np.stack([x.ravel(), y.ravel()], axis=1).astype(np.float32)
    for found in ground_likelihoods(darkened(evidence(picture(0.5), 1, everywhere)), CONFIG):
        assert not found.any()


def test_the_ground_of_a_mirrored_frame_is_mirrored() -> None:
    image, found = picture(0.5, road() * np.linspace(0.5, 1.5, SHAPE[1])[:, None]), labels()
    one = darkened(evidence(image, BACKGROUND), found)
    other = darkened(evidence(image[:, ::-1], BACKGROUND), found[:, ::-1])
    np.testing.assert_allclose(other.mean[:, ::-1], one.mean, atol=0.05)


# Boxes


@pytest.mark.parametrize("box", [Region(100, 60, 101, 111), Region(0, 0, 50, 40), Region(291, 203, 29, 37)])
def test_a_box_is_darkened_as_the_whole_frame_is(box: Region) -> None:
    image = picture(0.5)
    ground = ground_colour(evidence(image), 1, labels(), CONFIG)
    assert ground is not None
    whole, part = darkened(evidence(image), labels()), darkening(image, ground, box, 1.0)
    for name in ("mean", "spread", "brightness", "variance"):
        np.testing.assert_array_equal(getattr(part, name), getattr(whole, name)[box.slices])
    own, those = (ground_likelihoods(one, CONFIG) for one in (part, whole))
    for found, expected in zip(own, those, strict=True):
        np.testing.assert_array_equal(found, expected[box.slices])


def test_darkening_is_the_log_of_the_colour_over_that_of_the_enlarged_ground() -> None:
    image = picture(0.5)
    ground = ground_colour(evidence(image), 1, labels(), CONFIG)
    assert ground is not None
    dark = darkened(evidence(image), labels())
    enlarged = cv2.resize(ground, SHAPE[::-1])
    smooth = cv2.GaussianBlur(image, (0, 0), 1.0).astype(np.float32) + 1.0
    channels = np.log(smooth) - enlarged[..., :3]
    np.testing.assert_allclose(dark.mean, channels.mean(axis=2), atol=1e-5)
    np.testing.assert_allclose(dark.spread, np.ptp(channels, axis=2), atol=1e-5)
    np.testing.assert_allclose(dark.brightness, smooth.mean(axis=2), rtol=1e-6)
    np.testing.assert_allclose(dark.variance, enlarged[..., 3], rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("blur", [0.25, 0.5, 1.0])
@pytest.mark.parametrize("shape", [(1, 1), (2, 3), (1, 20), (20, 1), (30, 41)])
def test_a_box_is_smoothed_as_opencv_smooths_the_whole_picture(blur: float, shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(shape[1])
    image = rng.integers(0, 256, (*shape, 3)).astype(np.uint8)
    whole = cv2.GaussianBlur(image, (0, 0), blur)
    for _ in range(10):
        x, y = int(rng.integers(shape[1])), int(rng.integers(shape[0]))
        box = Region(x, y, int(rng.integers(1, shape[1] - x + 1)), int(rng.integers(1, shape[0] - y + 1)))
        np.testing.assert_array_equal(_smoothed(image, _blur_weights(blur), box.box), whole[box.slices])
