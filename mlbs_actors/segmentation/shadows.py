"""Cast shadows: they move with an object but are not part of it.

Not in the paper. A shadow is ground with less light: its colour is the ground's, darkened by a similar factor
in all channels. The ground's colour is estimated around the objects in the same frame, without memory: near a
moving object the ground has often never been seen without its shadow. Where no light reaches the ground, its
colour is lost and position decides (:mod:`mlbs_actors.segmentation.contact_shadow`).

A plain dark thing on plain ground has the colours of a shadow. But a shadow is cast by something: where
nothing is claimed but ground and shadow, that is the thing
(:func:`~mlbs_actors.segmentation.unaries.discount_shadows`).
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import cv2
import numpy as np

from mlbs_actors.config import SegmentationConfig, length_scale
from mlbs_actors.geometry.distance import trajectory_distance
from mlbs_actors.kernels.image_rows import mirrored
from mlbs_actors.kernels.jit import compiled
from mlbs_actors.messages import BACKGROUND, Array, FrameEvidence, Region

__all__ = ["Darkening", "darkening", "ground_colour", "ground_likelihoods"]

#: The ground's colour is estimated on a picture of squares of so many cells a side.
SHRINK = 2
#: Reach of the blur of the picture, px.
BLUR_REACH = 4
#: Side of the square around such a square in which last frame's map must show no object either.
GROWN = 3
#: Where there is no ground within the reach, the reach is doubled, this many times.
DOUBLINGS = 4
#: Variance of the ground where there is no ground within any reach.
NO_GROUND = 1e3


@dataclass(frozen=True, slots=True)
class Darkening:
    """Difference of each pixel's colour from that of the ground near it, in one box of a picture.

    Attributes
    ----------
    mean : (h, w) float32
        Logarithm of the colour's ratio to the ground's, mean of the channels.
    spread : (h, w) float32
        Its range over the channels.
    brightness : (h, w) float32
        Mean of the channels, grey levels + 1.
    variance : (h, w) float32
        Of the ground's log colour; large where there is no ground.
    """

    mean: Array
    spread: Array
    brightness: Array
    variance: Array


def ground_colour(
    evidence: FrameEvidence, side: int, previous: Array, config: SegmentationConfig
) -> Array | None:
    """Estimate the colour of the ground near each pixel from pixels of no object.

    Parameters
    ----------
    evidence : FrameEvidence
        The frame's colours, and the objects' trajectories.
    side : int
        Of a cell, px.
    previous : (H, W) uint16
        Last label map; empty if there is none.

    Returns
    -------
    (h / 2 SHRINK, w / 2 SHRINK, 4) float32 or None
        Mean log colour and its variance. None if there is neither an object's trajectory nor an object in
        the last map.
    """
    height, width = evidence.colours.shape[:2]
    positions = evidence.positions[evidence.tracks_of(BACKGROUND).end :]  # the objects', which come after it
    if not len(positions) and not previous.any():
        return None
    size = (max(1, width // SHRINK), max(1, height // SHRINK))
    whole = evidence.colours[: SHRINK * size[1], : SHRINK * size[0]]
    colour = cv2.resize(whole, size, interpolation=cv2.INTER_AREA)
    reach, square = config.ground_px * length_scale(*evidence.shape), SHRINK * side
    free: Array = trajectory_distance(positions, Region(0, 0, *size), square) >= reach
    if previous.size:
        shown = previous[::square, ::square][: size[1], : size[0]] > BACKGROUND
        free &= cv2.dilate(shown.view(np.uint8), np.ones((GROWN, GROWN), np.uint8)) == 0
    return _spread_into_objects(colour, free, config)


def darkening(picture: Array, ground: Array, box: Region, blur: float) -> Darkening:
    """Compare each pixel of a box with the ground near it.

    Parameters
    ----------
    picture : (h, w, 3) uint8
        The frame, or the means of its cells.
    ground : (h / 2 SHRINK, w / 2 SHRINK, 4) float32
        Of :func:`ground_colour`.
    box : Region
        Of the picture.
    blur : float
        Standard deviation by which it is smoothed first, px of the picture, at most 1.

    Returns
    -------
    Darkening
    """
    smooth = _smoothed(np.ascontiguousarray(picture), _blur_weights(blur), box.box)
    return Darkening(*_compared(smooth, ground, box.y, box.x, picture.shape[:2], _LOG))


def ground_likelihoods(dark: Darkening, config: SegmentationConfig) -> tuple[Array, Array]:
    """Rate how much each pixel looks like the ground near it, with less light and with all of it.

    Returns
    -------
    shadow, lit : (h, w) float32
        0 = not at all … 1 = darker ground, and ground. Their sum is at most 1.
    """
    lightest = config.shadow_lightest, config.shadow_lightest_ramp
    darkest = config.shadow_darkest, config.shadow_darkest_ramp
    most = config.channel_spread, config.channel_noise, config.ground_variance
    likelihoods: tuple[Array, Array] = _ground_likelihoods(
        dark.mean, dark.spread, dark.brightness, dark.variance, lightest, darkest, most
    )
    return likelihoods


@functools.lru_cache(maxsize=16)
def _blur_weights(blur: float) -> Array:
    """Return the weights of a Gaussian of this standard deviation, at most 1 px, as OpenCV smooths 8-bit
    pictures: (2 · 4 + 1,) int32, parts of 256."""
    flat = np.zeros((1, 4 * BLUR_REACH + 1), np.uint8)
    flat[0, 2 * BLUR_REACH] = 255
    smooth = cv2.GaussianBlur(np.repeat(flat, 4 * BLUR_REACH + 1, axis=0), (0, 0), blur)
    weights = np.rint(smooth[0, BLUR_REACH : 3 * BLUR_REACH + 1] * (256 / 255))
    weights[BLUR_REACH] += 256 - weights.sum()
    return np.asarray(weights, np.int32)


@compiled
def _smoothed(picture: Array, weights: Array, box: tuple[int, int, int, int]) -> Array:
    """Smooth a box of a picture (h, w, 3) uint8; the picture is mirrored at its border."""
    left, top, width, height = box
    middle = weights.size // 2
    reach = middle
    while reach > 0 and weights[middle - reach] == 0:
        reach -= 1
    # The pixels of a row inside the picture first: that loop is vectorised.
    first, last = max(reach - left, 0), min(picture.shape[1] + reach - left, width + 2 * reach)
    column, row = np.empty(3 * (width + 2 * reach), np.int32), np.empty(3 * width, np.int32)
    smooth = np.empty((height, width, 3), np.uint8)
    pixels, results, length = picture.reshape(-1), smooth.reshape(-1), picture.shape[1]
    for y in range(height):
        inside = column[3 * first : 3 * last]
        inside[:] = 0
        for k in range(-reach, reach + 1):
            begin = length * mirrored(top + y + k, picture.shape[0]) + left - reach
            known, weight = pixels[3 * (begin + first) : 3 * (begin + last)], weights[middle + k]
            for i in range(inside.size):
                inside[i] += weight * np.int32(known[i])
        for x in range(width + 2 * reach):
            if not first <= x < last:
                twin = mirrored(left + x - reach, picture.shape[1]) + reach - left
                column[3 * x : 3 * x + 3] = column[3 * twin : 3 * twin + 3]
        row[:] = 1 << 15
        for k in range(2 * reach + 1):
            weight, beside = weights[middle - reach + k], column[3 * k : 3 * (k + width)]
            for i in range(row.size):
                row[i] += weight * beside[i]
        flat = results[3 * width * y : 3 * width * (y + 1)]
        for i in range(row.size):
            flat[i] = np.uint8(row[i] >> np.int32(16))
    return smooth


@compiled
def _ground_likelihoods(
    mean: Array, spread: Array, brightness: Array, variance: Array, lightest: tuple[float, float],
    darkest: tuple[float, float], most: tuple[float, float, float],
) -> tuple[Array, Array]:  # fmt: skip
    shadow, lit = np.empty(mean.shape, np.float32), np.empty(mean.shape, np.float32)
    for y in range(mean.shape[0]):
        for x in range(mean.shape[1]):
            tolerance = most[0] + most[1] / brightness[y, x]
            alike = min(max(2.0 - 2.0 * spread[y, x] / tolerance, 0.0), 1.0)
            alike *= min(max(2.0 - variance[y, x] / most[2], 0.0), 1.0)
            darker = min(max((lightest[0] - mean[y, x]) / lightest[1], 0.0), 1.0)
            brighter = min(max((lightest[0] + mean[y, x]) / lightest[1], 0.0), 1.0)
            lit[y, x] = alike * (1.0 - darker - brighter)
            shadow[y, x] = alike * darker * min(max((mean[y, x] - darkest[0]) / darkest[1], 0.0), 1.0)
    return shadow, lit


def _spread_into_objects(colour: Array, free: Array, config: SegmentationConfig) -> Array:
    """Return mean log colour and its variance, (h / 2, w / 2, 4) float32, of the free pixels in reach."""
    weighted = [_moments(colour, free, _LOG)]
    for _ in range(DOUBLINGS):
        weighted.append(cv2.pyrDown(weighted[-1]))
    ground = np.zeros((*weighted[-1].shape[:2], 4), np.float32)
    ground[..., 3] = NO_GROUND
    for level in reversed(weighted):
        if ground.shape[:2] != level.shape[:2]:
            ground = cv2.pyrUp(ground, dstsize=level.shape[1::-1])
        smooth = cv2.GaussianBlur(level, (0, 0), config.ground_reach)
        _take_where_found(smooth, ground, 4 * config.ground_share)  # of four pixels
    return ground


@compiled
def _moments(colour: Array, free: Array, log_of: Array) -> Array:
    """Sum log colour, its square and 1 over the free pixels of 2×2: (⌈h/2⌉, ⌈w/2⌉, 7) float32."""
    height, width = free.shape
    moments = np.zeros(((height + 1) // 2, (width + 1) // 2, 7), np.float32)
    for y in range(height):
        for x in range(width):
            if free[y, x]:
                block = moments[y // 2, x // 2]
                for c in range(3):
                    value = log_of[colour[y, x, c]]
                    block[c] += value
                    block[3 + c] += value * value
                block[6] += 1.0
    return moments


@compiled
def _take_where_found(moments: Array, ground: Array, least_share: float) -> None:
    """Write mean log colour and variance into ``ground`` where there is enough of it within the reach."""
    height, width, _ = ground.shape
    for y in range(height):
        for x in range(width):
            share = moments[y, x, 6]
            if share > least_share:
                variance = np.float32(0.0)
                for c in range(3):
                    mean = moments[y, x, c] / share
                    variance = max(variance, moments[y, x, 3 + c] / share - mean * mean)
                    ground[y, x, c] = mean
                ground[y, x, 3] = variance


@compiled
def _compared(
    smooth: Array, ground: Array, top: int, left: int, frame_shape: tuple[int, int], log_of: Array
) -> tuple[Array, Array, Array, Array]:
    """Compute the fields of `Darkening` in a box; the ground is interpolated bilinearly."""
    height, width, _ = smooth.shape
    mean, spread = np.empty((height, width), np.float32), np.empty((height, width), np.float32)
    brightness, variance = np.empty((height, width), np.float32), np.empty((height, width), np.float32)
    columns = ground.shape[1]
    before, after = np.empty(width, np.uint64), np.empty(width, np.uint64)
    right = np.empty(width, np.float32)
    for x in range(width):
        before[x], after[x], right[x] = _between(x + left, columns / frame_shape[1], columns)
    row = np.empty((columns, 4), np.float32)
    third = np.float32(1.0 / 3.0)
    for y in range(height):
        above, below, down = _between(y + top, ground.shape[0] / frame_shape[0], ground.shape[0])
        for column in range(int(before[0]), int(after[width - 1]) + 1):
            for c in range(4):
                step = ground[below, column, c] - ground[above, column, c]
                row[column, c] = ground[above, column, c] + down * step
        for x in range(width):
            at = np.uint64(x)
            one, other, share, colour = row[before[at]], row[after[at]], right[at], smooth[y, at]
            blue = log_of[colour[0]] - (one[0] + share * (other[0] - one[0]))
            green = log_of[colour[1]] - (one[1] + share * (other[1] - one[1]))
            red = log_of[colour[2]] - (one[2] + share * (other[2] - one[2]))
            mean[y, at] = (blue + green + red) * third
            spread[y, at] = max(blue, green, red) - min(blue, green, red)
            total = np.int32(colour[0]) + np.int32(colour[1]) + np.int32(colour[2])
            brightness[y, at] = np.float32(total) * third + np.float32(1.0)
            variance[y, at] = one[3] + share * (other[3] - one[3])
    return mean, spread, brightness, variance


@compiled
def _between(pixel: int, ratio: float, count: int) -> tuple[int, int, float]:
    """Return the two pixels of a shrunk row next to a pixel of the row, and the second's share."""
    place = min(max((pixel + 0.5) * ratio - 0.5, 0.0), count - 1.0)
    first = int(place)
    return first, min(first + 1, count - 1), place - first


#: Log of a channel's value + 1.
_LOG = np.log(np.arange(1, 257, dtype=np.float32))
