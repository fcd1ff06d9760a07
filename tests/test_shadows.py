"""Shadows: darker ground of the same hue is told from all that is none."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from mlbs_actors.messages import BACKGROUND, Array, FrameEvidence, LayerEvidence
from mlbs_actors.shadows import Darkening, contact_shadow, darkening, shadow_likelihood

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


def likelihood(image: Array, previous: Array = NO_LABELS) -> Array:
    dark = darkening(image, evidence(), previous, SCALE)
    assert dark is not None
    return shadow_likelihood(dark)


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


def test_without_an_objects_trajectories_there_is_nothing_that_could_cast_one() -> None:
    image = picture(0.5)
    assert darkening(image, evidence(BACKGROUND), labels(), SCALE) is None
    none = np.zeros((0, 2), np.float32)
    assert darkening(image, evidence(1, none), labels(), SCALE) is None


def test_equal_input_gives_equal_bytes_and_is_only_read() -> None:
    image, previous = picture(0.5), labels()
    image.flags.writeable = previous.flags.writeable = False
    assert likelihood(image, previous).tobytes() == likelihood(image.copy(), previous.copy()).tobytes()


def test_a_frame_without_any_ground_has_no_shadow() -> None:
    x, y = np.meshgrid(np.arange(0, SHAPE[1], 8), np.arange(0, SHAPE[0], 8))
    everywhere = np.stack([x.ravel(), y.ravel()], axis=1).astype(np.float32)
    dark = darkening(picture(0.5), evidence(1, everywhere), NO_LABELS, SCALE)
    assert dark is not None
    assert not shadow_likelihood(dark).any()


# The dark strip between an object and the ground

#: Below the red car, nearly black.
STRIP = np.s_[120:130, 126:174]


def with_strip(strip: tuple[slice, slice] = STRIP) -> tuple[Array, Array, Darkening]:
    """Label map, picture and its darkening: the map gives the car the strip too."""
    image = picture(1.0)
    image[strip] = 9
    found = np.zeros(SHAPE, np.uint16)
    found[CAR] = found[strip] = 1
    dark = darkening(image, evidence(), found, SCALE)
    assert dark is not None
    return found, image, dark


def test_a_dark_strip_under_an_object_is_not_the_object() -> None:
    found, image, dark = with_strip()
    strip = contact_shadow(found, image, dark, SCALE, 0.3)
    assert strip.dtype == bool
    assert strip[STRIP].mean() > 0.85
    strip[STRIP] = False
    assert not strip.any()


def test_it_is_looked_for_no_higher_than_it_may_rise() -> None:
    found, image, dark = with_strip(np.s_[110:130, 126:174])
    strip = contact_shadow(found, image, dark, SCALE, 0.1)
    assert not strip[:122].any()


def test_a_dark_strip_higher_up_is_a_bumper() -> None:
    found, image, dark = with_strip(np.s_[100:110, 126:174])
    assert not contact_shadow(found, image, dark, SCALE, 0.3).any()


def test_what_is_narrow_is_a_tyre() -> None:
    found, image, dark = with_strip(np.s_[120:130, 126:134])
    assert not contact_shadow(found, image, dark, SCALE, 0.3).any()


def test_a_bright_strip_is_the_object() -> None:
    found, image, _ = with_strip()
    image[STRIP] = 140
    dark = darkening(image, evidence(), found, SCALE)
    assert dark is not None
    assert not contact_shadow(found, image, dark, SCALE, 0.3).any()


def test_the_lighter_rim_under_the_strip_goes_with_it() -> None:
    found, image, _ = with_strip()
    rim = np.s_[130:132, 134:166]
    found[rim], image[rim] = 1, 100
    dark = darkening(image, evidence(), found, SCALE)
    assert dark is not None
    strip = contact_shadow(found, image, dark, 1.0, 0.3)
    assert strip[rim].all()


@pytest.mark.parametrize("below", ["another object", "the frame's border"])
def test_what_does_not_stand_on_the_ground_has_no_contact_shadow(below: str) -> None:
    found, image, dark = with_strip()
    if below == "another object":
        found[130:160, 120:180] = 2
    else:
        found, image = found[:130], image[:130]
        dark = Darkening(dark.mean[:130], dark.spread[:130], dark.brightness[:130], dark.variance[:130])
    assert not contact_shadow(found, image, dark, SCALE, 0.3)[STRIP].any()
