"""Cast shadows: they move with an object and are none of it.

Not in the paper. A shadow is ground with less light: its colour is the ground's, darker by a like factor in
all channels. The ground's colour is taken from what lies around the objects in the same frame, so that it
needs no memory: near a moving object the ground has often never been seen without its shadow.
"""

from __future__ import annotations

import cv2
import numpy as np

from mlbs_actors.messages import BACKGROUND, Array, FrameEvidence, Region
from mlbs_actors.trajectory_distance import trajectory_distance

__all__ = ["shadow_likelihood"]

#: The ground's colour is found on the frame shrunk by this.
SHRINK = 4
#: Pixels this near to an object's trajectory may be the object itself, px of a 640×480 frame.
NEAR_PX = 16.0
#: So many px around last frame's objects are not taken for ground either.
GROWN_PX = 9
#: Standard deviations over which ground is looked for, nearest first, shrunk px.
REACHES = (3.0, 6.0, 12.0, 24.0, 48.0)
#: Least share of ground within a reach.
LEAST_GROUND = 0.05
#: Log darkening at which a shadow begins, over which that is certain, and the same for the darkest.
LIGHTEST, LIGHTEST_RAMP, DARKEST, DARKEST_RAMP = -0.10, 0.15, -2.2, 0.3
#: Log darkening may differ by this between the channels, and by so many grey levels more in the dark.
CHANNEL_SPREAD, CHANNEL_NOISE = 0.25, 6.0
#: Variance of the ground's log colour above which nothing is said.
GROUND_VARIANCE = 0.04


def shadow_likelihood(frame: Array, evidence: FrameEvidence, previous: Array, scale: float) -> Array | None:
    """How much each pixel looks like the ground near it, but darker.

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
    (H, W) float32 or None
        0 = no shadow … 1 = darker ground; None if no object has a trajectory.
    """
    height, width = frame.shape[:2]
    objects = [one for one in evidence.layers if one.layer != BACKGROUND and len(one.positions)]
    if not objects:
        return None
    occupied = trajectory_distance(objects, Region(0, 0, width, height)) < NEAR_PX * scale
    if previous.size:
        grown = cv2.dilate((previous > BACKGROUND).astype(np.uint8), np.ones((GROWN_PX, GROWN_PX), np.uint8))
        occupied |= grown.astype(bool)
    ground, variance = _ground(frame, occupied)
    smooth = cv2.GaussianBlur(frame, (0, 0), 1.0).astype(np.float32) + 1.0
    darkening = np.log(smooth) - ground
    mean = darkening.mean(axis=2)
    spread = darkening.max(axis=2) - darkening.min(axis=2)
    tolerance = CHANNEL_SPREAD + CHANNEL_NOISE / smooth.mean(axis=2)
    likelihood = np.clip((LIGHTEST - mean) / LIGHTEST_RAMP, 0.0, 1.0)
    likelihood *= np.clip((mean - DARKEST) / DARKEST_RAMP, 0.0, 1.0)
    likelihood *= np.clip(2.0 - 2.0 * spread / tolerance, 0.0, 1.0)
    likelihood *= np.clip(2.0 - variance / GROUND_VARIANCE, 0.0, 1.0)
    return np.asarray(likelihood, np.float32)


def _ground(frame: Array, occupied: Array) -> tuple[Array, Array]:
    """Mean log colour (H, W, 3) and its variance (H, W) of the free pixels within the nearest reach."""
    height, width = occupied.shape
    size = (max(1, width // SHRINK), max(1, height // SHRINK))
    colour = np.log(cv2.resize(frame, size, interpolation=cv2.INTER_AREA).astype(np.float32) + 1.0)
    free = (cv2.resize(occupied.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) == 0).astype(
        np.float32
    )
    weighted = np.dstack([colour * free[..., None], np.square(colour) * free[..., None], free])
    mean, variance = np.zeros_like(colour), np.full(free.shape, np.inf, np.float32)
    missing = np.ones(free.shape, bool)
    for reach in REACHES:
        blurred = cv2.GaussianBlur(weighted, (0, 0), reach)
        found = missing & (blurred[..., 6] > LEAST_GROUND)
        moments = blurred[found, :6] / blurred[found, 6:]
        mean[found] = moments[:, :3]
        variance[found] = (moments[:, 3:] - np.square(moments[:, :3])).max(axis=1)
        missing &= ~found
    return (
        cv2.resize(mean, (width, height)),
        cv2.resize(np.minimum(variance, 1e3), (width, height)),
    )
