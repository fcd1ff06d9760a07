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

from mlbs_actors.compilation import compiled
from mlbs_actors.messages import Array, Region

__all__ = ["FramePart", "photometric_advantage"]

#: Side of the window over which a motion is judged.
WINDOW = 3
#: Bounds of what is taken for noise, grey levels: lower than those of the camera's evidence, for the means of
#: cells are less noisy.
LEAST_NOISE, MOST_NOISE = 1.5, 3.0
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
    motion : (h, w, 2) float32
        The object's backward motion at the pixels of ``now``, px.
    camera : (3, 3) float64
        The camera's: takes pixels of frame t to frame t−1.
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
    sources = np.empty((2, 2, *motion.shape[:2]), np.float32)
    known = np.empty(motion.shape[:2], np.bool_)
    _find_sources(motion, camera, region.x, region.y, before.region.x, before.region.y, last, sources, known)
    own_error, camera_error = (
        cv2.boxFilter(
            cv2.absdiff(newest, cv2.remap(last, source[0], source[1], cv2.INTER_LINEAR)),
            cv2.CV_32F,
            (WINDOW, WINDOW),
        )
        for source in sources
    )
    noise = np.float32(min(max(_median(camera_error[::2, ::2]), LEAST_NOISE), MOST_NOISE))
    advantage = np.zeros(known.shape, np.float32)
    _compare(own_error, camera_error, noise, own, known, np.float32(largest), advantage)
    return advantage


@compiled()  # where the camera's horizon lies in the frame, a depth can be 0
def _find_sources(
    motion: Array, camera: Array, x0: int, y0: int, last_x0: int, last_y0: int, last: Array, sources: Array,
    known: Array,
) -> None:  # fmt: skip
    """Where (x, y) in the last image each pixel comes from by either motion, and whether both are inside."""
    bottom, right = last.shape[0] - 1, last.shape[1] - 1
    for v in range(known.shape[0]):
        for u in range(known.shape[1]):
            x, y = np.float64(u + x0), np.float64(v + y0)
            depth = camera[2, 0] * x + camera[2, 1] * y + camera[2, 2]
            own_x, own_y = x + motion[v, u, 0] - last_x0, y + motion[v, u, 1] - last_y0
            camera_x = (camera[0, 0] * x + camera[0, 1] * y + camera[0, 2]) / depth - last_x0
            camera_y = (camera[1, 0] * x + camera[1, 1] * y + camera[1, 2]) / depth - last_y0
            sources[0, 0, v, u], sources[0, 1, v, u] = own_x, own_y
            sources[1, 0, v, u], sources[1, 1, v, u] = camera_x, camera_y
            known[v, u] = (
                0 <= own_x <= right
                and 0 <= own_y <= bottom
                and 0 <= camera_x <= right
                and 0 <= camera_y <= bottom
            )


@compiled()
def _median(values: Array) -> float:
    return float(np.median(values))


@compiled()
def _compare(
    own_error: Array, camera_error: Array, noise: np.float32, own: Array, known: Array,
    largest: np.float32, advantage: Array,
) -> None:  # fmt: skip
    zero, one = np.float32(0), np.float32(1)
    for y in range(known.shape[0]):
        for x in range(known.shape[1]):
            by_own, by_camera = own_error[y, x] / noise, camera_error[y, x] / noise
            lead = min(max(by_camera - by_own, -largest), largest)
            believed = np.float32(CAMERA_BELIEVED) - by_camera
            if lead > 0:
                believed = np.float32(OWN_BELIEVED) - by_own if own[y, x] else zero
            if known[y, x]:
                advantage[y, x] = lead * min(max(believed, zero), one)
