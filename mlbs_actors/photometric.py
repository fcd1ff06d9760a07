"""Which motion explains the image: an object's own, or the camera's.

Not in the paper. Both motions move the last frame into the new one; what they leave unexplained is compared
over a small window. In smooth places both explain it, and nothing is said; on texture the right one wins,
which takes back ground that an object once was thought to own, and holds an object together between its
trajectories.

Either motion is believed only where it explains the image well in itself: a limb obeys neither. An object's
own is also believed only where it leads back to pixels that were the object's: ground that it has just
uncovered has no past that could explain it, but over smooth ground any motion seems to.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from mlbs_actors.camera import LEAST_NOISE, MOST_NOISE
from mlbs_actors.messages import Array, Region

__all__ = ["FramePart", "photometric_advantage"]

#: Side of the window over which a motion is judged, px.
WINDOW = 5
#: Error from which on a motion is not believed at all, and from one less on altogether, × noise.
OWN_BELIEVED, CAMERA_BELIEVED = 4.0, 2.5


@dataclass(frozen=True, slots=True)
class FramePart:
    """The colours of a region of a frame.

    Attributes
    ----------
    region : Region
    image : (h, w, 3) uint8
        BGR.
    """

    region: Region
    image: Array


def photometric_advantage(
    before: FramePart, now: FramePart, motion: Array, camera: Array, own: Array, largest: float
) -> Array:
    """By how much an object's motion explains the image better than the camera's.

    Parameters
    ----------
    before, now : FramePart
        Of frames t−1 and t.
    motion, camera : (h, w, 2) float32
        The object's and the camera's backward motion at the pixels of ``now``, px.
    own : (h, w) bool
        Where the object's motion leads back to its own pixels.
    largest : float
        Most that it can be, either way.

    Returns
    -------
    (h, w) float32
        In units of the noise, which is the median error of the camera's motion, between ``LEAST_NOISE`` and
        ``MOST_NOISE`` grey levels; 0 where either motion leads out of ``before``.
    """
    region = now.region
    if region.area == 0 or before.region.area == 0:
        return np.zeros(motion.shape[:2], np.float32)
    last, newest = (cv2.cvtColor(part.image, cv2.COLOR_BGR2GRAY) for part in (before, now))
    rows, columns = np.mgrid[region.slices].astype(np.float32)
    known = np.ones(motion.shape[:2], bool)
    errors = []
    for candidate in (motion, camera):
        x = columns + candidate[..., 0] - np.float32(before.region.x)
        y = rows + candidate[..., 1] - np.float32(before.region.y)
        known &= (x >= 0) & (x <= last.shape[1] - 1) & (y >= 0) & (y <= last.shape[0] - 1)
        moved = cv2.remap(last, x, y, cv2.INTER_LINEAR)
        errors.append(cv2.blur(cv2.absdiff(newest, moved).astype(np.float32), (WINDOW, WINDOW)))
    noise = np.float32(np.clip(np.median(errors[1]), LEAST_NOISE, MOST_NOISE))
    own_error, camera_error = errors[0] / noise, errors[1] / noise
    advantage = np.clip(camera_error - own_error, -largest, largest)
    believed = np.where(
        advantage > 0,
        own * np.clip(OWN_BELIEVED - own_error, 0.0, 1.0),
        np.clip(CAMERA_BELIEVED - camera_error, 0.0, 1.0),
    )
    return np.asarray(advantage * believed * known, np.float32)
