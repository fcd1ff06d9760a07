"""The painted pieces of a street: facades under a sky, a road, trees, vehicles, a balloon.

Lengths are in canvas units (see :mod:`mlbs_actors.scenes.stage`); ``unit`` is px a unit. Every
piece has some grain, as surfaces have, so that points can be followed on it.
"""

from __future__ import annotations

import cv2
import numpy as np

from mlbs_actors.messages import Array
from mlbs_actors.scenes.textures import blob, grain

__all__ = ["balloon", "facades", "road", "tree", "vehicle"]

Piece = tuple[Array, Array]
"""Texture (h, w, 3) uint8 BGR and opacity (h, w) uint8."""

_WALLS = ((150, 172, 196), (128, 150, 190), (176, 190, 200), (150, 160, 150), (170, 160, 178))
_GLASS, _LIT, _TYRE, _HUB = (96, 74, 58), (150, 205, 235), (38, 36, 36), (178, 178, 180)
_ASPHALT, _PAVEMENT, _GRASS, _PAINT = (104, 102, 100), (158, 162, 164), (76, 128, 96), (222, 224, 224)


def facades(rng: np.random.Generator, side: float, unit: float, ground: float) -> Array:
    """Paint a row of houses under a sky with clouds.

    Parameters
    ----------
    rng : numpy Generator
    side : float
        Of the square texture, units; it tiles from left to right. Its middle is height 0.
    unit : float
    ground : float
        Height at which the houses stand.

    Returns
    -------
    (round(side · unit), round(side · unit), 3) uint8 BGR
    """
    size = round(side * unit)
    houses = np.zeros((size, size, 3))

    def part(left: float, top: float, width: float, height: float) -> tuple[slice, slice]:
        y = round((top + side / 2) * unit)
        columns = slice(round(left * unit), round((left + width) * unit))
        return slice(y, y + max(1, round(height * unit))), columns

    left = 0.0
    while left < side:
        width, height = rng.uniform(34, 62), rng.uniform(34, 84)
        if side - left - width < 34:
            width = side - left
        houses[part(left, ground - height, width, height + 8)] = _WALLS[rng.integers(len(_WALLS))]
        houses[part(left, ground - height, width, 3)] *= 0.6
        for top in np.arange(ground - height + 7, ground - 9, 10):
            for start in np.arange(left + 4, left + width - 6, 10):
                houses[part(start, top, 5, 6)] = _LIT if rng.random() < 0.2 else _GLASS
                houses[part(start, top + 6, 5, 1)] *= 0.75
        left += width
    share = np.linspace(0, 1, size)[:, None, None]
    sky = (1 - share) * (226, 176, 128) + share * (250, 240, 226)
    shape = (size, size)
    clouds = np.clip(grain(rng, shape, 60 * unit) + 0.3 * grain(rng, shape, 12 * unit), 0, 1.2) / 1.2
    picture = np.where(houses.any(axis=2, keepdims=True), houses, sky + (255 - sky) * clouds[:, :, None])
    return _finished(rng, picture, unit, 7.0)


def road(rng: np.random.Generator, side: int, unit: float) -> Array:
    """Paint pavement, two lanes, a kerb and grass, from far to near; tiles from left to right.

    Returns
    -------
    (side, side, 3) uint8 BGR
    """
    picture = np.empty((side, side, 3))

    def rows(low: float, high: float) -> slice:
        return slice(max(round(low * unit + side / 2), 0), round(high * unit + side / 2))

    picture[:] = _GRASS
    picture[rows(-200, 2)], picture[rows(2, 84)], picture[rows(84, 90)] = _PAVEMENT, _ASPHALT, _PAVEMENT
    picture[rows(0, 2)] = picture[rows(90, 91)] = (120, 124, 126)
    for x in range(0, side, round(16 * unit)):  # joints of the flags, marks between the lanes
        picture[rows(-200, 0), x : x + max(1, round(0.7 * unit))] *= 0.75
        if x // round(16 * unit) % 2 == 0:
            picture[rows(38, 40.5), x : x + round(16 * unit)] = _PAINT
    patches = grain(rng, (side, side), 14 * unit)
    picture *= 1 + 0.07 * np.sign(patches)[:, :, None]
    return _finished(rng, picture, unit, 11.0)


def tree(rng: np.random.Generator, size: float, unit: float) -> Piece:
    """Paint a crown on a trunk; ``size`` is half the crown's width."""
    crown = blob(rng, (size, 0.9 * size), unit, wobble=0.3)
    height, width = crown.shape
    trunk = round(0.9 * size * unit)
    opacity = np.zeros((height + trunk, width), np.uint8)
    half = max(1, round(0.12 * size * unit))
    opacity[height // 2 :, width // 2 - half : width // 2 + half + 1] = 255
    picture = np.empty((*opacity.shape, 3))
    picture[:] = (58, 84, 112)
    picture[:height][crown > 0] = (62, 122, 84)
    leaves = grain(rng, opacity.shape, 5 * unit)
    picture *= 1 + 0.22 * np.clip(leaves, -1, 1)[:, :, None]
    opacity[:height] = np.maximum(opacity[:height], crown)
    return _finished(rng, picture, unit, 8.0), opacity


def vehicle(
    rng: np.random.Generator,
    size: tuple[float, float],
    colour: tuple[float, ...],
    unit: float,
    *,
    faces_right: bool = False,
) -> Piece:
    """Paint a car from its side: body, windows, lights, wheels; ``size`` is its length and height."""
    width, height = (round(axis * unit) for axis in size)
    picture, opacity = np.zeros((height, width, 3)), np.zeros((height, width), np.uint8)

    def outline(*points: tuple[float, float]) -> Array:
        return np.array([(round(x * (width - 1)), round(y * (height - 1))) for x, y in points], np.int32)

    def part(left: float, top: float, right: float, bottom: float) -> tuple[slice, slice]:
        rows = slice(round(top * height), round(bottom * height))
        return rows, slice(round(left * width), max(round(right * width), round(left * width) + 1))

    roof = (0.02, 0.5), (0.14, 0.42), (0.3, 0.04), (0.76, 0.04), (0.88, 0.42), (0.99, 0.52)
    cv2.fillPoly(opacity, [outline(*roof, (0.99, 0.84), (0.01, 0.84))], 255, cv2.LINE_AA)
    picture[:] = colour
    picture[part(0, 0.68, 1, 1)] *= 0.72
    cv2.fillPoly(picture, [outline((0.22, 0.4), (0.33, 0.12), (0.5, 0.12), (0.5, 0.4))], _GLASS)
    cv2.fillPoly(picture, [outline((0.54, 0.4), (0.54, 0.12), (0.73, 0.12), (0.81, 0.4))], _GLASS)
    for x in (0.5, 0.78):
        picture[part(x, 0.44, x + 0.01, 0.82)] *= 0.5
    picture[part(0, 0.5, 0.05, 0.6)], picture[part(0.95, 0.5, 1, 0.6)] = _LIT, (60, 60, 210)
    for x in (0.22, 0.78):
        centre, radius = (round(x * width), round(0.82 * height)), round(0.17 * height)
        cv2.circle(opacity, centre, radius, 255, -1, cv2.LINE_AA)
        cv2.circle(picture, centre, radius, _TYRE, -1, cv2.LINE_AA)
        cv2.circle(picture, centre, radius // 2, _HUB, -1, cv2.LINE_AA)
    along = slice(None, None, -1 if faces_right else 1)
    return _finished(rng, picture[:, along], unit, 7.0), np.ascontiguousarray(opacity[:, along])


def balloon(rng: np.random.Generator, size: float, unit: float) -> Piece:
    """Paint a striped balloon with its basket; ``size`` is half its width."""
    half = round(size * unit)
    shape = (round(3.1 * half), 2 * half + 1)
    opacity = np.zeros(shape, np.uint8)
    x = (np.arange(shape[1]) - half) / half
    stripes = np.floor(np.arcsin(np.clip(x, -1, 1)) / np.pi * 7 + 0.5).astype(int) % 2
    picture = np.tile(np.array([(58.0, 74.0, 214.0), (90.0, 214.0, 246.0)])[stripes], (shape[0], 1, 1))
    picture *= 1 - 0.25 * np.abs(x)[None, :, None]
    cv2.circle(opacity, (half, half), half, 255, -1, cv2.LINE_AA)
    corners = (0.18, 1.55), (0.75, 2.3), (1.25, 2.3), (1.82, 1.55)
    below = np.array([(round(x * half), round(y * half)) for x, y in corners], np.int32)
    cv2.fillPoly(opacity, [below], 255, cv2.LINE_AA)
    basket = slice(round(2.45 * half), round(2.95 * half)), slice(round(0.75 * half), round(1.25 * half))
    opacity[basket], picture[basket] = 255, (60, 96, 140)
    opacity[round(2.3 * half) : basket[0].start, [round(0.8 * half), round(1.2 * half)]] = 255
    return _finished(rng, picture, unit, 7.0), opacity


def _finished(rng: np.random.Generator, picture: Array, unit: float, contrast: float) -> Array:
    """Add grain: coarse grain to be seen, and fine grain to be tracked."""
    shape = (picture.shape[0], picture.shape[1])
    shading = contrast * grain(rng, shape, 7.0 * unit) + 0.7 * contrast * grain(rng, shape, 3.5)
    finished: Array = np.clip(picture + shading[:, :, None] + 0.5, 0, 255).astype(np.uint8)
    return finished
