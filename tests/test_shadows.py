"""Shadows: darker ground of the same hue is told from all that is none."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from mlbs_actors.cells import mean_of_cells
from mlbs_actors.messages import BACKGROUND, Array, FrameEvidence, LayerEvidence, Region
from mlbs_actors.shadows import (
    CONTACT_DARK,
    CONTACT_WIDTH,
    Darkening,
    contact_shadow,
    darkening,
    ground_colour,
    shadow_likelihood,
)

SHAPE = (240, 320)
#: Lengths are stated for 640×480.
SCALE = 0.5
ROAD = np.array([120.0, 125.0, 130.0])
CAR, PATCH = np.s_[80:120, 120:180], np.s_[122:150, 115:185]
#: Well inside the patch.
INNER = np.s_[127:145, 122:178]
NO_LABELS = np.zeros((0, 0), np.uint16)


def road(texture: float = 2.0, seed: int = 0) -> Array:
    noise = np.random.default_rng(seed).normal(0.0, texture, (*SHAPE, 3))
    return ROAD + noise


def picture(patch: Array | float, ground: Array | None = None) -> Array:
    """A red car on a grey road, and beneath it a patch that is the road times a factor."""
    image = road() if ground is None else ground.copy()
    image[PATCH] *= patch
    image[CAR] = (30.0, 30.0, 190.0)
    return np.asarray(np.clip(np.rint(image), 0, 255), np.uint8)


def evidence(layer: int = 1, positions: Array | None = None) -> FrameEvidence:
    """Trajectories all over the car."""
    x, y = np.meshgrid(np.arange(124, 178, 6), np.arange(84, 118, 6))
    at = np.stack([x.ravel(), y.ravel()], axis=1).astype(np.float32) if positions is None else positions
    everywhere = np.array([[10.0, 10.0], [300.0, 200.0], [140.0, 135.0]], np.float32)
    layers = [LayerEvidence(BACKGROUND, "background", 0, everywhere, np.zeros_like(everywhere))]
    if layer != BACKGROUND:
        layers.append(LayerEvidence(layer, "object", 0, at, np.zeros_like(at)))
    half = (SHAPE[0] // 2, SHAPE[1] // 2)
    return FrameEvidence(
        frame_index=1,
        shape=SHAPE,
        camera=np.eye(3),
        flow=np.zeros((*half, 2), np.float16),
        flow_reliable=np.zeros(half, bool),
        unexplained=np.zeros(half, np.uint8),
        layers=tuple(layers),
        retired=(),
        latency_frames=0,
    )


def labels() -> Array:
    """Last frame's map: the car and, wrongly, its shadow."""
    previous = np.zeros(SHAPE, np.uint16)
    previous[CAR] = previous[PATCH] = 1
    return previous


def darkened(
    image: Array, given: FrameEvidence, previous: Array = NO_LABELS, scale: float = SCALE
) -> Darkening:
    """On the whole frame."""
    ground = ground_colour(image, given, previous, scale)
    assert ground is not None
    return darkening(image, ground, Region(0, 0, image.shape[1], image.shape[0]), 1.0)


def likelihood(image: Array, previous: Array = NO_LABELS) -> Array:
    return shadow_likelihood(darkened(image, evidence(), previous))


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
        assert ground_colour(image, evidence(BACKGROUND), previous, SCALE) is None
        assert ground_colour(image, evidence(1, none), previous, SCALE) is None
    assert ground_colour(image, evidence(1, none), labels(), SCALE) is not None


def test_equal_input_gives_equal_bytes_and_is_only_read() -> None:
    image, previous = picture(0.5), labels()
    image.flags.writeable = previous.flags.writeable = False
    assert likelihood(image, previous).tobytes() == likelihood(image.copy(), previous.copy()).tobytes()


def test_a_frame_without_any_ground_has_no_shadow() -> None:
    x, y = np.meshgrid(np.arange(0, SHAPE[1], 8), np.arange(0, SHAPE[0], 8))
    everywhere = np.stack([x.ravel(), y.ravel()], axis=1).astype(np.float32)
    assert not shadow_likelihood(darkened(picture(0.5), evidence(1, everywhere))).any()


# The dark strip between an object and the ground

#: Below the red car, nearly black; with it the object is 50 px high.
STRIP = np.s_[120:130, 126:174]
RISE = 0.25
#: Nearer than this to an outline no place is smooth.
EDGE = 3


def strip_found(image: Array, found: Array) -> Array:
    return contact_shadow(found, image, darkened(image, evidence(), found), 1, SCALE, RISE)


def with_strip(strip: tuple[slice, slice] = STRIP, grey: int = 9) -> tuple[Array, Array]:
    """A picture, and a label map that gives the car a strip under it too."""
    image = picture(1.0)
    image[strip] = grey
    found = np.zeros(SHAPE, np.uint16)
    found[CAR] = found[strip] = 1
    return image, found


def test_a_dark_strip_under_an_object_is_not_the_object() -> None:
    strip = strip_found(*with_strip())
    assert strip.dtype == bool
    assert strip[STRIP].mean() > 0.85
    strip[STRIP] = False
    assert not strip.any()


def test_it_rises_no_higher_than_it_may() -> None:
    strip = strip_found(*with_strip(np.s_[90:130, 126:174]))
    assert strip[120:130, 130:170].all()
    assert not strip[: 130 - int(RISE * 50) - 1].any()


def test_a_dark_strip_above_a_bright_one_is_a_bumper() -> None:
    image, found = with_strip(np.s_[112:120, 122:178])
    found[120:126, 122:178], image[120:126, 122:178] = 1, 125
    assert not strip_found(image, found).any()


@pytest.mark.parametrize("left", [120, 143, 160])
def test_what_is_narrow_is_a_tyre(left: int) -> None:
    width = int(CONTACT_WIDTH * 50) - 1 + 2 * EDGE
    assert not strip_found(*with_strip(np.s_[112:130, left : left + width - 2 * EDGE])).any()
    assert strip_found(*with_strip(np.s_[112:130, 130 : 130 + width + 4])).any()


@pytest.mark.parametrize("grey", [75, 140])
def test_a_strip_that_is_not_dark_is_the_object(grey: int) -> None:
    assert not strip_found(*with_strip(grey=grey)).any()


def test_a_dark_strip_with_texture_is_the_object() -> None:
    image, found = with_strip()
    checks = np.indices(SHAPE).sum(axis=0)[STRIP] // 2 % 2
    image[STRIP] = np.where(checks[..., None], 1, 40)
    assert not strip_found(image, found).any()


def test_a_dark_strip_of_another_hue_is_the_object() -> None:
    image, found = with_strip()
    image[STRIP] = (6, 6, 100)
    assert not strip_found(image, found).any()


def test_the_lighter_rim_under_the_strip_goes_with_it() -> None:
    rim = np.s_[129:130, 130:170]
    image, found = with_strip()
    image[rim] = 100
    image, found = (one.repeat(2, axis=0).repeat(2, axis=1) for one in (image, found))
    dark = darkened(image, evidence(), found, 2 * SCALE)
    assert dark.mean[258:260, 264:336].min() > CONTACT_DARK
    assert contact_shadow(found, image, dark, 1, 2 * SCALE, RISE)[258:260, 264:336].all()


def test_nothing_is_taken_beyond_the_ground() -> None:
    image, found = with_strip()
    found[140:160, 130:170] = 1  # another piece of the same object, with ground between
    assert not strip_found(image, found)[140:].any()


@pytest.mark.parametrize("below", ["another object", "the frame's border"])
def test_what_does_not_stand_on_the_ground_has_no_contact_shadow(below: str) -> None:
    image, found = with_strip()
    assert strip_found(image, found).any()
    if below == "another object":
        found[130:160, 120:180] = 2
        assert not strip_found(image, found)[STRIP].any()
    else:
        dark = darkened(image, evidence(), found)
        cut = Darkening(dark.mean[:130], dark.spread[:130], dark.brightness[:130], dark.variance[:130])
        assert not contact_shadow(found[:130], image[:130], cut, 1, SCALE, RISE).any()


def test_the_ground_of_a_mirrored_frame_is_mirrored() -> None:
    image, found = picture(0.5, road() * np.linspace(0.5, 1.5, SHAPE[1])[:, None]), labels()
    one = darkened(image, evidence(BACKGROUND), found)
    other = darkened(image[:, ::-1], evidence(BACKGROUND), found[:, ::-1])
    np.testing.assert_allclose(other.mean[:, ::-1], one.mean, atol=0.05)


# Boxes


@pytest.mark.parametrize("box", [Region(100, 60, 101, 111), Region(0, 0, 50, 40), Region(291, 203, 29, 37)])
def test_a_box_is_darkened_as_the_whole_frame_is(box: Region) -> None:
    image = picture(0.5)
    ground = ground_colour(image, evidence(), labels(), SCALE)
    assert ground is not None
    whole, part = darkened(image, evidence(), labels()), darkening(image, ground, box, 1.0)
    for name in ("mean", "spread", "brightness", "variance"):
        np.testing.assert_array_equal(getattr(part, name), getattr(whole, name)[box.slices])
    np.testing.assert_array_equal(shadow_likelihood(part), shadow_likelihood(whole)[box.slices])


def test_darkening_is_the_log_of_the_colour_over_that_of_the_enlarged_ground() -> None:
    image = picture(0.5)
    ground = ground_colour(image, evidence(), labels(), SCALE)
    assert ground is not None
    dark = darkened(image, evidence(), labels())
    enlarged = cv2.resize(ground, SHAPE[::-1])
    smooth = cv2.GaussianBlur(image, (0, 0), 1.0).astype(np.float32) + 1.0
    channels = np.log(smooth) - enlarged[..., :3]
    np.testing.assert_allclose(dark.mean, channels.mean(axis=2), atol=1e-5)
    np.testing.assert_allclose(dark.spread, np.ptp(channels, axis=2), atol=1e-5)
    np.testing.assert_allclose(dark.brightness, smooth.mean(axis=2), rtol=1e-6)
    np.testing.assert_allclose(dark.variance, enlarged[..., 3], rtol=1e-5, atol=1e-6)


def test_a_contact_shadow_is_found_in_a_box_as_in_the_whole_frame() -> None:
    image, found = with_strip()
    ground = ground_colour(image, evidence(), found, SCALE)
    assert ground is not None
    box = Region(100, 60, 100, 100)
    part = np.ascontiguousarray(image[box.slices])
    strip = contact_shadow(found[box.slices], part, darkening(image, ground, box, 1.0), 1, SCALE, RISE)
    np.testing.assert_array_equal(strip, strip_found(image, found)[box.slices])


def test_a_contact_shadow_is_found_from_the_means_of_cells_too() -> None:
    image, found = (one.repeat(2, axis=0).repeat(2, axis=1) for one in with_strip())
    ground = ground_colour(image, evidence(), found, 2 * SCALE)
    assert ground is not None
    small = mean_of_cells(image, 2)
    dark = darkening(small, ground, Region(0, 0, small.shape[1], small.shape[0]), 0.5)
    strip = contact_shadow(found, image, dark, 2, 2 * SCALE, RISE)
    assert strip.any()
    by_pixels = contact_shadow(
        found, image, darkened(image, evidence(), found, 2 * SCALE), 1, 2 * SCALE, RISE
    )
    assert (strip != by_pixels).sum() <= 0.1 * by_pixels.sum()
