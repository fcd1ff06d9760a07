"""Contact shadows: a dark strip at an object's foot is told from the object."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from test_shadows import CAR, SHAPE, darkened, evidence, picture

from mlbs_actors.cells import spread_over_cells
from mlbs_actors.config import SegmentationConfig
from mlbs_actors.messages import BACKGROUND, Array, Region
from mlbs_actors.segmentation.contact_shadow import contact_shadow
from mlbs_actors.segmentation.shadows import Darkening, darkening, ground_colour

#: Lengths are stated for 640×480.
SCALE = 0.5
#: Below the red car, nearly black; with it the object is 50 px high.
STRIP = np.s_[120:130, 126:174]
RISE = 0.25
CONFIG = SegmentationConfig(contact_shadow=RISE)
#: Nearer than this to an outline no place is smooth.
EDGE = 3


def strip_found(image: Array, found: Array) -> Array:
    return contact_shadow(found, image, darkened(evidence(image), found), 1, SCALE, CONFIG)


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
    width = int(CONFIG.contact_width * 50) - 1 + 2 * EDGE
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
    dark = darkened(evidence(image), found)
    assert dark.mean[258:260, 264:336].min() > CONFIG.contact_dark
    assert contact_shadow(found, image, dark, 1, 2 * SCALE, CONFIG)[258:260, 264:336].all()


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
        dark = darkened(evidence(image), found)
        cut = Darkening(dark.mean[:130], dark.spread[:130], dark.brightness[:130], dark.variance[:130])
        assert not contact_shadow(found[:130], image[:130], cut, 1, SCALE, CONFIG).any()


def test_a_contact_shadow_is_found_in_a_box_as_in_the_whole_frame() -> None:
    image, found = with_strip()
    ground = ground_colour(evidence(image), 1, found, CONFIG)
    assert ground is not None
    box = Region(100, 60, 100, 100)
    part, inside = (np.ascontiguousarray(one[box.slices]) for one in (image, found))
    strip = contact_shadow(inside, part, darkening(image, ground, box, 1.0), 1, SCALE, CONFIG)
    np.testing.assert_array_equal(strip, strip_found(image, found)[box.slices])


def test_a_contact_shadow_is_found_from_the_means_of_cells_too() -> None:
    image, found = (one.repeat(2, axis=0).repeat(2, axis=1) for one in with_strip())
    given = evidence(image, side=2)
    ground = ground_colour(given, 2, found, CONFIG)
    assert ground is not None
    dark = darkening(given.colours, ground, Region(0, 0, SHAPE[1], SHAPE[0]), 0.5)
    strip = contact_shadow(found, image, dark, 2, 2 * SCALE, CONFIG)
    assert strip.any()
    by_pixels = contact_shadow(found, image, darkened(evidence(image), found), 1, 2 * SCALE, CONFIG)
    assert (strip != by_pixels).sum() <= 0.1 * by_pixels.sum()


# Against OpenCV's components of one object after the other


def slow_contact_shadow(
    labels: Array, frame: Array, dark: Darkening, side: int, scale: float, config: SegmentationConfig
) -> Array:
    found = np.zeros(labels.shape, bool)
    tolerance = config.channel_spread + config.channel_noise / dark.brightness
    unlit = spread_over_cells(
        (dark.mean < config.contact_dark) & (dark.spread < tolerance), side, labels.shape
    )
    gray = cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY).astype(np.float32)
    slopes = np.hypot(
        cv2.Sobel(gray, cv2.CV_32F, 1, 0, scale=1 / 8), cv2.Sobel(gray, cv2.CV_32F, 0, 1, scale=1 / 8)
    )
    smooth = cv2.blur(slopes, (5, 5)) < config.contact_smooth / scale
    edge = 2 * int(config.contact_edge_px * scale) + 1
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (edge, edge))
    for label in set(labels[labels > BACKGROUND].tolist()):
        _, pieces, boxes, _ = cv2.connectedComponentsWithStats((labels == label).astype(np.uint8))
        for piece, (_, top, _, height, _) in enumerate(boxes[1:].tolist(), start=1):
            body = (pieces == piece) & (np.arange(len(labels)) >= top + height // 2)[:, None]
            below = np.append(labels > BACKGROUND, np.ones((1, labels.shape[1]), bool), axis=0)[top + height]
            climb, above = np.where(below, len(labels), 0), np.zeros(labels.shape)
            for y in range(top + height - 1, -1, -1):
                climb = above[y] = np.where(labels[y] > BACKGROUND, climb + 1, 0)
            foot = body & unlit & (above <= config.contact_shadow * height)
            length = 2 * max(1, int(config.contact_width * height / 2)) + 1
            beside = np.pad((foot & smooth).astype(np.uint8), ((0, 0), (length, length)))
            opened = cv2.morphologyEx(beside, cv2.MORPH_OPEN, np.ones((1, length), np.uint8))
            flat = np.ascontiguousarray(opened[:, length:-length])
            _, strips = cv2.connectedComponents(flat)
            resting = np.unique(strips[(flat > 0) & (above <= config.contact_gap_px * scale)])
            strip = (cv2.dilate(np.isin(strips, resting).astype(np.uint8), disc) > 0) & foot
            for y in range(1, len(labels)):
                strip[y] |= strip[y - 1] & body[y]
            found |= strip
    return found


def test_it_is_what_the_components_of_one_object_after_the_other_give() -> None:
    for seed in range(60):
        random = np.random.default_rng(seed)
        side, scale, rise = (
            int(random.integers(1, 4)),
            float(random.uniform(0.3, 2)),
            float(random.uniform(0.1, 0.8)),
        )
        height, width = (int(random.integers(5, most)) for most in (90, 120))
        labels = np.zeros((height, width), np.uint16)
        for label in random.choice([0, 1, 2, 7], 6):
            y, x = random.integers(0, height), random.integers(0, width)
            labels[y : y + random.integers(1, height), x : x + random.integers(1, width)] = label
        if seed % 3 == 0:
            labels[random.random(labels.shape) < 0.03] = BACKGROUND
        noise = random.normal(60, random.uniform(1, 60), (height, width, 3))
        frame = np.clip(cv2.GaussianBlur(noise, (0, 0), random.uniform(0.5, 3)), 0, 255).astype(np.uint8)
        cells = (-(-height // side), -(-width // side))
        mean = cv2.GaussianBlur(random.normal(-0.8, 0.5, cells), (0, 0), 2).astype(np.float32)
        spread = random.uniform(0, 0.4 * random.random(), cells).astype(np.float32)
        brightness = random.uniform(1, 60, cells).astype(np.float32)
        dark = Darkening(mean, spread, brightness, np.zeros(cells, np.float32))
        config = SegmentationConfig(contact_shadow=rise)
        strip = contact_shadow(labels, frame, dark, side, scale, config)
        np.testing.assert_array_equal(strip, slow_contact_shadow(labels, frame, dark, side, scale, config))
