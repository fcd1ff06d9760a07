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

from mlbs_actors.messages import BACKGROUND, Array, FrameEvidence, Region
from mlbs_actors.trajectory_distance import trajectory_distance

__all__ = ["Darkening", "contact_shadow", "darkening", "shadow_likelihood"]

#: The ground's colour is found on the frame shrunk by this.
SHRINK = 4
#: Pixels this near to an object's trajectory may be the object itself, px of a 640×480 frame.
NEAR_PX = 16.0
#: So many px around last frame's objects are not taken for ground either.
GROWN_PX = 9
#: Standard deviation over which ground is looked for, shrunk px; where there is none, twice that, so often.
REACH, DOUBLINGS = 3.0, 4
#: Least share of ground within a reach.
LEAST_GROUND = 0.05
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
    """How each pixel's colour differs from that of the ground near it.

    Attributes
    ----------
    mean : (H, W) float32
        Logarithm of colour over ground's colour, mean of the channels.
    spread : (H, W) float32
        Its range over the channels.
    brightness : (H, W) float32
        Mean of the channels, grey levels + 1.
    variance : (H, W) float32
        Of the ground's log colour; large where there is no ground.
    """

    mean: Array
    spread: Array
    brightness: Array
    variance: Array


def darkening(frame: Array, evidence: FrameEvidence, previous: Array, scale: float) -> Darkening | None:
    """Compare each pixel with the ground near it.

    Parameters
    ----------
    frame : (H, W, 3) uint8
    evidence : FrameEvidence
        The objects' trajectories.
    previous : (H, W) uint16
        Last label map; empty if there is none.
    scale : float
        :func:`~mlbs_actors.config.length_scale` of the frame.

    Returns
    -------
    Darkening or None
        None if there is neither an object's trajectory nor an object in the last map.
    """
    height, width = frame.shape[:2]
    objects = [one for one in evidence.layers if one.layer != BACKGROUND and len(one.positions)]
    if not objects and not previous.any():
        return None
    occupied = trajectory_distance(objects, Region(0, 0, width, height)) < NEAR_PX * scale
    if previous.size:
        grown = cv2.dilate((previous > BACKGROUND).astype(np.uint8), np.ones((GROWN_PX, GROWN_PX), np.uint8))
        occupied |= grown.astype(bool)
    ground, variance = _ground(frame, occupied)
    smooth = cv2.GaussianBlur(frame, (0, 0), 1.0).astype(np.float32) + 1.0
    channels = np.log(smooth) - ground
    return Darkening(
        mean=channels.mean(axis=2),
        spread=channels.max(axis=2) - channels.min(axis=2),
        brightness=smooth.mean(axis=2),
        variance=variance,
    )


def shadow_likelihood(dark: Darkening) -> Array:
    """How much each pixel looks like the ground near it with less light.

    Parameters
    ----------
    dark : Darkening

    Returns
    -------
    (H, W) float32
        0 = no shadow … 1 = darker ground.
    """
    likelihood = np.clip((LIGHTEST - dark.mean) / LIGHTEST_RAMP, 0.0, 1.0)
    likelihood *= np.clip((dark.mean - DARKEST) / DARKEST_RAMP, 0.0, 1.0)
    likelihood *= np.clip(2.0 - 2.0 * dark.spread / _tolerance(dark), 0.0, 1.0)
    likelihood *= np.clip(2.0 - dark.variance / GROUND_VARIANCE, 0.0, 1.0)
    return np.asarray(likelihood, np.float32)


def _tolerance(dark: Darkening) -> Array:
    """What the channels' darkening may differ by; a dark colour is uncertain."""
    return np.asarray(CHANNEL_SPREAD + CHANNEL_NOISE / dark.brightness)


def contact_shadow(labels: Array, frame: Array, dark: Darkening, scale: float, rise: float) -> Array:
    """The dark strip between an object's foot and the ground, as far as the label map gives it to the object.

    Parameters
    ----------
    labels : (H, W) integer
        Without pinholes; 0 = background.
    frame : (H, W, 3) uint8
    dark : Darkening
    scale : float
        :func:`~mlbs_actors.config.length_scale` of the frame.
    rise : float
        How high it may reach, as a share of the height of its piece of the object.

    Returns
    -------
    (H, W) bool
    """
    found = np.zeros(labels.shape, bool)
    unlit = (dark.mean < CONTACT_DARK) & (dark.spread < _tolerance(dark))
    smooth = _steepness(frame) < CONTACT_SMOOTH / scale
    edge = 2 * int(CONTACT_EDGE_PX * scale) + 1
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (edge, edge))
    for label in np.unique(labels[labels > BACKGROUND]):
        _, pieces, boxes, _ = cv2.connectedComponentsWithStats((labels == label).astype(np.uint8))
        for piece, (x, y, width, height, _) in enumerate(boxes[1:], start=1):
            # Feet of one object stand at different heights of the picture.
            box = np.s_[y + height // 2 : y + height, x : x + width]
            body = pieces[box] == piece
            above = _height_above_ground(labels, box)
            foot = body & unlit[box] & (above <= rise * height)
            flat = _wide(foot & smooth[box], CONTACT_WIDTH * height)
            _, strips = cv2.connectedComponents(flat.astype(np.uint8))
            resting = np.unique(strips[flat & (above <= CONTACT_GAP_PX * scale)])
            core = np.isin(strips, resting[resting > 0])
            strip = cv2.dilate(core.astype(np.uint8), disc).astype(bool) & foot
            found[box] |= _and_under(strip, body)
    return found


def _steepness(frame: Array) -> Array:
    """Mean gradient over 5×5 px, grey levels/px."""
    gray = cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY).astype(np.float32)
    slopes = (cv2.Sobel(gray, cv2.CV_32F, *axis, scale=1 / 8) for axis in ((1, 0), (0, 1)))
    return np.asarray(cv2.blur(np.hypot(*slopes), (5, 5)))


def _height_above_ground(labels: Array, box: tuple[slice, slice]) -> Array:
    """How many px down to the first that is no object's, (h, w) int32; over H if the frame ends first."""
    rows, columns = box
    occupied = labels[rows, columns] > BACKGROUND
    above = np.zeros(occupied.shape, np.int32)
    under = labels[rows.stop, columns] > BACKGROUND if rows.stop < len(labels) else np.True_
    run = np.where(under, len(labels), 0)
    for row in range(len(occupied) - 1, -1, -1):
        run = np.where(occupied[row], run + 1, 0)
        above[row] = run
    return above


def _wide(mask: Array, least: float) -> Array:
    """What of a mask lies in horizontal runs of at least so many px."""
    run = np.ones((1, 2 * max(1, int(least / 2)) + 1), np.uint8)
    opened = cv2.morphologyEx(
        mask.astype(np.uint8), cv2.MORPH_OPEN, run, borderType=cv2.BORDER_CONSTANT, borderValue=0
    )
    return np.asarray(opened, bool)


def _and_under(strip: Array, body: Array) -> Array:
    """The strip and what of the body is under it, down to the ground: the shadow's lighter rim."""
    result = strip.copy()
    for row in range(1, len(strip)):
        result[row] |= result[row - 1] & body[row]
    return result


def _ground(frame: Array, occupied: Array) -> tuple[Array, Array]:
    """Mean log colour (H, W, 3) and its variance (H, W) of the free pixels within the nearest reach."""
    height, width = occupied.shape
    size = (max(1, width // SHRINK), max(1, height // SHRINK))
    colour = np.log(cv2.resize(frame, size, interpolation=cv2.INTER_AREA).astype(np.float32) + 1.0)
    free = (cv2.resize(occupied.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) == 0).astype(
        np.float32
    )
    weighted = [np.dstack([colour * free[..., None], np.square(colour) * free[..., None], free])]
    for _ in range(DOUBLINGS):
        weighted.append(cv2.pyrDown(weighted[-1]))
    ground: Array | None = None
    for level in reversed(weighted):
        blurred = cv2.GaussianBlur(level, (0, 0), REACH)
        found = blurred[..., 6] > LEAST_GROUND
        moments = blurred[..., :6] / np.maximum(blurred[..., 6:], LEAST_GROUND)
        variance = (moments[..., 3:] - np.square(moments[..., :3])).max(axis=2)
        variance[~found] = NO_GROUND
        own = np.dstack([moments[..., :3], variance])
        if ground is not None:
            own = np.where(found[..., None], own, cv2.pyrUp(ground, dstsize=found.shape[::-1]))
        ground = own
    assert ground is not None
    ground = cv2.resize(ground, (width, height))
    return ground[..., :3], ground[..., 3]
