"""Cast shadows: they move with an object and are none of it.

Not in the paper. A shadow is ground with less light: its colour is the ground's, darker by a like factor in
all channels. The ground's colour is taken from what lies around the objects in the same frame, so that it
needs no memory: near a moving object the ground has often never been seen without its shadow.

Where no light reaches, as between the wheels of a car, nothing is left of the ground's colour, and black
tyres and bumpers look alike. There the place decides (:func:`contact_shadow`): a flat smooth dark strip at an
object's foot that rests on the ground.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from mlbs_actors.cells import spread_over_cells
from mlbs_actors.compilation import compiled
from mlbs_actors.messages import BACKGROUND, Array, FrameEvidence, Region
from mlbs_actors.region_groups import common, slices_in
from mlbs_actors.trajectory_distance import trajectory_distance

__all__ = ["Darkening", "contact_shadow", "darkening", "ground_colour", "shadow_likelihood"]

#: The ground's colour is found on the frame shrunk by this.
SHRINK = 4
#: Pixels this near to an object's trajectory may be the object itself, px of a 640×480 frame.
NEAR_PX = 16.0
#: How far the blur of the picture looks, px.
BLUR_REACH = 4
#: Side of the square around a shrunk pixel in which last frame's map must show no object either.
GROWN = 3
#: Standard deviation over which ground is looked for, twice shrunk px; where there is none, twice that, so
#: often.
REACH, DOUBLINGS = 1.5, 4
#: Least share of ground within a reach, of four pixels.
LEAST_GROUND = 4 * 0.05
#: Log darkening at which a shadow begins, over which that is certain, and the same for the darkest.
LIGHTEST, LIGHTEST_RAMP, DARKEST, DARKEST_RAMP = -0.10, 0.15, -2.2, 0.3
#: Log darkening may differ by this between the channels, and by so many grey levels more in the dark.
CHANNEL_SPREAD, CHANNEL_NOISE = 0.25, 6.0
#: Variance of the ground's log colour above which nothing is said.
GROUND_VARIANCE = 0.04
#: What stands for it where there is no ground within any reach.
NO_GROUND = 1e3
#: Log darkening of a contact shadow, and its steepest mean gradient over 5×5 px, grey levels/px of 640×480.
CONTACT_DARK, CONTACT_SMOOTH = -0.7, 6.0
#: It is at least this wide, in heights of its object, and so near above the ground, px of 640×480.
CONTACT_WIDTH, CONTACT_GAP_PX = 0.3, 6.0
#: Its edges, which are neither smooth nor flat, reach so far, px of a 640×480 frame.
CONTACT_EDGE_PX = 4.0


@dataclass(frozen=True, slots=True)
class Darkening:
    """How each pixel's colour differs from that of the ground near it, in one box of a picture.

    Attributes
    ----------
    mean : (h, w) float32
        Logarithm of colour over ground's colour, mean of the channels.
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


def ground_colour(picture: Array, evidence: FrameEvidence, previous: Array, scale: float) -> Array | None:
    """The colour of the ground near each pixel, from what is no object's.

    Parameters
    ----------
    picture : (h, w, 3) uint8
        The frame, or the means of its cells.
    evidence : FrameEvidence
        The objects' trajectories.
    previous : (H, W) uint16
        Last label map; empty if there is none.
    scale : float
        :func:`~mlbs_actors.config.length_scale` of the frame.

    Returns
    -------
    (H / 2 SHRINK, W / 2 SHRINK, 4) float32 or None
        Mean log colour and its variance. None if there is neither an object's trajectory nor an object in
        the last map.
    """
    height, width = evidence.shape
    objects = [one for one in evidence.layers if one.layer != BACKGROUND and len(one.positions)]
    if not objects and not previous.any():
        return None
    size = (max(1, width // SHRINK), max(1, height // SHRINK))
    colour = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
    free: Array = trajectory_distance(objects, Region(0, 0, *size), SHRINK) >= NEAR_PX * scale
    if previous.size:
        shown = cv2.resize(previous, size, interpolation=cv2.INTER_NEAREST) > BACKGROUND
        free &= cv2.dilate(shown.view(np.uint8), np.ones((GROWN, GROWN), np.uint8)) == 0
    return _spread_into_objects(colour, free)


def darkening(picture: Array, ground: Array, box: Region, blur: float) -> Darkening:
    """Compare each pixel of a box with the ground near it.

    Parameters
    ----------
    picture : (h, w, 3) uint8
        The frame, or the means of its cells.
    ground : (H / 2 SHRINK, W / 2 SHRINK, 4) float32
        Of :func:`ground_colour`.
    box : Region
        Of the picture.
    blur : float
        Standard deviation by which it is smoothed first, px of the picture, at most 1.

    Returns
    -------
    Darkening
    """
    around = _grown(box, BLUR_REACH, picture.shape)
    smooth = cv2.GaussianBlur(picture[around.slices], (0, 0), blur)[slices_in(box, around)]
    return Darkening(*_compared(np.ascontiguousarray(smooth), ground, box.y, box.x, picture.shape[:2], _LOG))


def shadow_likelihood(dark: Darkening) -> Array:
    """How much each pixel looks like the ground near it with less light.

    Parameters
    ----------
    dark : Darkening

    Returns
    -------
    (h, w) float32
        0 = no shadow … 1 = darker ground.
    """
    return _likelihood(dark.mean, dark.spread, dark.brightness, dark.variance)


@compiled()
def _likelihood(mean: Array, spread: Array, brightness: Array, variance: Array) -> Array:
    likelihood = np.empty(mean.shape, np.float32)
    for y in range(mean.shape[0]):
        for x in range(mean.shape[1]):
            tolerance = CHANNEL_SPREAD + CHANNEL_NOISE / brightness[y, x]
            value = min(max((LIGHTEST - mean[y, x]) / LIGHTEST_RAMP, 0.0), 1.0)
            value *= min(max((mean[y, x] - DARKEST) / DARKEST_RAMP, 0.0), 1.0)
            value *= min(max(2.0 - 2.0 * spread[y, x] / tolerance, 0.0), 1.0)
            value *= min(max(2.0 - variance[y, x] / GROUND_VARIANCE, 0.0), 1.0)
            likelihood[y, x] = value
    return likelihood


def contact_shadow(
    labels: Array, frame: Array, dark: Darkening, side: int, scale: float, rise: float
) -> Array:
    """The dark strip between an object's foot and the ground, as far as the label map gives it to the object.

    Parameters
    ----------
    labels : (h, w) unsigned integer
        A frame's label map without pinholes, 0 = background, or one of its boxes with only background along
        the sides that are not the frame's border.
    frame : (h, w, 3) uint8
        The same box of the frame.
    dark : Darkening
        Of its pixels, or of the box's cells of ``side`` px.
    side : int
    scale : float
        :func:`~mlbs_actors.config.length_scale` of the frame.
    rise : float
        How high it may reach, as a share of the height of its piece of the object.

    Returns
    -------
    (h, w) bool
    """
    found = np.zeros(labels.shape, bool)
    unlit = spread_over_cells(_unlit(dark), side, labels.shape)
    edge = 2 * int(CONTACT_EDGE_PX * scale) + 1
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (edge, edge))
    for label, part in _unlit_objects(labels, unlit):
        own = (labels[part.slices] == label).view(np.uint8)
        _, pieces, boxes, _ = cv2.connectedComponentsWithStats(own)
        for piece, (x, y, width, height, _) in enumerate(boxes[1:].tolist(), start=1):
            # Feet of one object stand at different heights of the picture.
            feet = Region(x, y + height // 2, width, height - height // 2)
            body = pieces[feet.slices] == piece
            box = Region(feet.x + part.x, feet.y + part.y, feet.width, feet.height)
            dark_body = body & unlit[box.slices]
            if not dark_body.any():
                continue
            above = _height_above_ground(labels, box.x, box.y, box.width, box.height)
            foot = dark_body & (above <= rise * height)
            if not foot.any():
                continue
            flat = _wide(foot & (_steepness(frame, box) < CONTACT_SMOOTH / scale), CONTACT_WIDTH * height)
            if not flat.any():
                continue
            _, strips = cv2.connectedComponents(flat.view(np.uint8))
            resting = np.unique(strips[flat & (above <= CONTACT_GAP_PX * scale)])
            core = np.isin(strips, resting[resting > 0])
            strip = cv2.dilate(core.view(np.uint8), disc).astype(bool) & foot
            found[box.slices] |= _and_under(strip, body)
    return found


def _unlit_objects(labels: Array, unlit: Array) -> list[tuple[int, Region]]:
    """The objects that have a pixel without light, in ascending order, and their boxes."""
    bounds = _bounds(labels, unlit, int(labels.max()) + 1)
    return [
        (label, Region(left, top, right - left + 1, bottom - top + 1))
        for label, (left, top, right, bottom, dark) in enumerate(bounds.tolist())
        if dark
    ]


@compiled()
def _bounds(labels: Array, unlit: Array, count: int) -> Array:
    """Of every label but 0: least and largest x and y, and whether it has an unlit pixel, (count, 5)."""
    bounds = np.zeros((count, 5), np.int64)
    bounds[:, :2] = 2**31
    for y in range(labels.shape[0]):
        for x in range(labels.shape[1]):
            label = np.int64(labels[y, x])
            if label != BACKGROUND:
                bounds[label, 0], bounds[label, 1] = min(bounds[label, 0], x), min(bounds[label, 1], y)
                bounds[label, 2], bounds[label, 3] = max(bounds[label, 2], x), y
                bounds[label, 4] |= unlit[y, x]
    return bounds


def _unlit(dark: Darkening) -> Array:
    """What is much darker than the ground, and alike in all channels."""
    tolerance = CHANNEL_SPREAD + CHANNEL_NOISE / dark.brightness
    return np.asarray((dark.mean < CONTACT_DARK) & (dark.spread < tolerance))


def _steepness(frame: Array, box: Region) -> Array:
    """Mean gradient over 5×5 px in a box, grey levels/px."""
    around = _grown(box, 3, frame.shape)
    gray = cv2.cvtColor(frame[around.slices], cv2.COLOR_BGR2GRAY).astype(np.float32)
    slopes = (cv2.Sobel(gray, cv2.CV_32F, *axis, scale=1 / 8) for axis in ((1, 0), (0, 1)))
    return np.asarray(cv2.blur(np.hypot(*slopes), (5, 5))[slices_in(box, around)])


def _grown(box: Region, reach: int, shape: tuple[int, ...]) -> Region:
    """The box and what a filter of this reach needs around it."""
    grown = Region(box.x - reach, box.y - reach, box.width + 2 * reach, box.height + 2 * reach)
    return common(grown, Region(0, 0, shape[1], shape[0]))


@compiled()
def _height_above_ground(labels: Array, left: int, top: int, width: int, height: int) -> Array:
    """How many px down to the first that is no object's, (h, w) int32; over H if the frame ends first."""
    above = np.empty((height, width), np.int32)
    bottom = top + height
    run = np.empty(width, np.int32)
    for x in range(width):
        run[x] = len(labels) if bottom == len(labels) or labels[bottom, left + x] > BACKGROUND else 0
    for y in range(height - 1, -1, -1):
        for x in range(width):
            run[x] = run[x] + 1 if labels[top + y, left + x] > BACKGROUND else 0
            above[y, x] = run[x]
    return above


@compiled()
def _wide(mask: Array, least: float) -> Array:
    """What of a mask lies in horizontal runs of at least so many px, rounded down to an odd number."""
    wide = np.zeros(mask.shape, np.bool_)
    length = 2 * max(1, int(least / 2)) + 1
    for y in range(mask.shape[0]):
        start = 0
        for x in range(mask.shape[1] + 1):
            if x == mask.shape[1] or not mask[y, x]:
                if x - start >= length:
                    wide[y, start:x] = True
                start = x + 1
    return wide


@compiled()
def _and_under(strip: Array, body: Array) -> Array:
    """The strip and what of the body is under it, down to the ground: the shadow's lighter rim."""
    result = strip.copy()
    for y in range(1, strip.shape[0]):
        for x in range(strip.shape[1]):
            result[y, x] |= result[y - 1, x] & body[y, x]
    return result


def _spread_into_objects(colour: Array, free: Array) -> Array:
    """Mean log colour and its variance, (h / 2, w / 2, 4) float32, of the free pixels within a reach."""
    weighted = [_moments(colour, free, _LOG)]
    for _ in range(DOUBLINGS):
        weighted.append(cv2.pyrDown(weighted[-1]))
    ground = np.zeros((*weighted[-1].shape[:2], 4), np.float32)
    ground[..., 3] = NO_GROUND
    for level in reversed(weighted):
        if ground.shape[:2] != level.shape[:2]:
            ground = cv2.pyrUp(ground, dstsize=level.shape[1::-1])
        _take_where_found(cv2.GaussianBlur(level, (0, 0), REACH), ground)
    return ground


@compiled()
def _moments(colour: Array, free: Array, log_of: Array) -> Array:
    """Sums of log colour, its square and 1 over the free pixels of 2×2: (⌈h/2⌉, ⌈w/2⌉, 7) float32."""
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


@compiled()
def _take_where_found(moments: Array, ground: Array) -> None:
    """Put mean log colour and variance into ``ground`` where there is enough of it within the reach."""
    height, width, _ = ground.shape
    for y in range(height):
        for x in range(width):
            share = moments[y, x, 6]
            if share > LEAST_GROUND:
                variance = np.float32(0.0)
                for c in range(3):
                    mean = moments[y, x, c] / share
                    variance = max(variance, moments[y, x, 3 + c] / share - mean * mean)
                    ground[y, x, c] = mean
                ground[y, x, 3] = variance


@compiled()
def _compared(
    smooth: Array, ground: Array, top: int, left: int, frame_shape: tuple[int, int], log_of: Array
) -> tuple[Array, Array, Array, Array]:
    """The fields of `Darkening` in a box; the ground is interpolated bilinearly."""
    height, width, _ = smooth.shape
    mean, spread = np.empty((height, width), np.float32), np.empty((height, width), np.float32)
    brightness, variance = np.empty((height, width), np.float32), np.empty((height, width), np.float32)
    columns = ground.shape[1]
    before, after = np.empty(width, np.intp), np.empty(width, np.intp)
    right = np.empty(width, np.float32)
    for x in range(width):
        before[x], after[x], right[x] = _between(x + left, columns / frame_shape[1], columns)
    row = np.empty((columns, 4), np.float32)
    third, here = np.float32(1.0 / 3.0), np.empty(4, np.float32)
    for y in range(height):
        above, below, down = _between(y + top, ground.shape[0] / frame_shape[0], ground.shape[0])
        for column in range(columns):
            for c in range(4):
                step = ground[below, column, c] - ground[above, column, c]
                row[column, c] = ground[above, column, c] + down * step
        for x in range(width):
            for c in range(4):
                here[c] = row[before[x], c] + right[x] * (row[after[x], c] - row[before[x], c])
            blue = log_of[smooth[y, x, 0]] - here[0]
            green = log_of[smooth[y, x, 1]] - here[1]
            red = log_of[smooth[y, x, 2]] - here[2]
            mean[y, x] = (blue + green + red) * third
            spread[y, x] = max(blue, green, red) - min(blue, green, red)
            total = np.int32(smooth[y, x, 0]) + np.int32(smooth[y, x, 1]) + np.int32(smooth[y, x, 2])
            brightness[y, x] = np.float32(total) * third + np.float32(1.0)
            variance[y, x] = here[3]
    return mean, spread, brightness, variance


@compiled()
def _between(pixel: int, ratio: float, count: int) -> tuple[int, int, float]:
    """The two pixels of a shrunk row of ``count`` next to a pixel of the row, and the share of the second."""
    place = min(max((pixel + 0.5) * ratio - 0.5, 0.0), count - 1.0)
    first = int(place)
    return first, min(first + 1, count - 1), place - first


#: Log of a channel's value + 1.
_LOG = np.log(np.arange(1, 257, dtype=np.float32))
