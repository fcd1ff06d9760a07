"""What moves, made unrecognisable.

A label map does not cover a moving object exactly: outlines lag by a few pixels, limbs are missing in a frame
and back in the next one, and an object has its first label some frames after its first move. So the area that
is blurred reaches beyond the label map, in the picture and in time.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any

import cv2
import numpy as np

from mlbs_actors.messages import BACKGROUND, Array

__all__ = ["FRAMES_AFTER", "FRAMES_BEFORE", "MovingArea", "blurred", "is_private"]

#: Label maps before a frame's own, and after it, whose objects are hidden in it, too.
FRAMES_BEFORE, FRAMES_AFTER = 2, 4

#: How far around objects pictures are blurred, as a share of their shorter side.
_MARGIN = 1 / 48

#: Blocks along the longer side of a blurred area, of which nothing but the mean colour is left: an upright
#: person's head is about one of them.
_BLOCKS = 6

_LEAST_BLOCK = 8  # px

#: Less motion of the camera is not followed.
_STILL_PX = 0.5


def is_private(description: Mapping[str, Any]) -> bool:
    """Whether a run with this ``run.json`` hides what moves."""
    return bool(description.get("private", False))


class MovingArea:
    """Where things move in the newest frames of a stream, with what is around them."""

    def __init__(self) -> None:
        # Newest last: objects, (H, W) uint8, and the homography to the frame before.
        self._maps: deque[tuple[Array, Array]] = deque(maxlen=FRAMES_BEFORE + 1 + FRAMES_AFTER)

    def follow(self, labels: Array, camera: Sequence[float] | None) -> None:
        """Take in the next label map.

        Parameters
        ----------
        labels : (H, W) uint16
        camera : sequence of 9 float, optional
            Homography of the background, row by row, that takes pixels of this frame to where they were in
            the one before; None if unknown.
        """
        matrix: Array = np.eye(3) if camera is None else np.array(camera, np.float64).reshape(3, 3)
        matrix = matrix.astype(np.float32).astype(np.float64)  # as precise as in the tables
        self._maps.append(((labels != BACKGROUND).view(np.uint8), matrix))

    def mask(self, later: int = 0) -> Array:
        """Return what is to be hidden in a frame.

        Parameters
        ----------
        later : int
            Number of label maps after the frame's own, at most :data:`FRAMES_AFTER`.

        Returns
        -------
        (H, W) uint8
            1 where it is to be hidden, 0 elsewhere.
        """
        maps = list(self._maps)
        own = len(maps) - 1 - later
        hidden = maps[own][0].copy()
        there: Array = np.eye(3)  # from the frame to the one whose objects are added
        for place in range(own, max(own - FRAMES_BEFORE, 0), -1):
            there = maps[place][1] @ there
            _add(maps[place - 1][0], there, hidden)
        there = np.eye(3)
        for objects, back in maps[own + 1 :]:
            there = np.linalg.solve(back, there)
            _add(objects, there, hidden)
        margin = math.ceil(min(hidden.shape) * _MARGIN)
        # Gaps of up to two margins between what is hidden are hidden, too: limbs show through them.
        wide = cv2.dilate(hidden, np.ones((4 * margin + 1,) * 2, np.uint8))
        return np.asarray(cv2.erode(wide, np.ones((2 * margin + 1,) * 2, np.uint8)))


def _add(objects: Array, there: Array, hidden: Array) -> None:
    """Add the objects of another frame of that size, to which a homography leads, in place."""
    if objects.shape != hidden.shape or not objects.any():
        return
    height, width = hidden.shape
    if _moves(there, height, width):
        flags = cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP
        objects = np.asarray(cv2.warpPerspective(objects, there, (width, height), flags=flags))
    hidden |= objects


def _moves(there: Array, height: int, width: int) -> bool:
    """Whether a homography moves a corner of the picture by half a pixel: mostly a camera stands still."""
    corners = np.array([[0, width, 0, width], [0, 0, height, height], [1, 1, 1, 1]], np.float64)
    moved = there @ corners
    return bool(np.abs(moved[:2] / moved[2] - corners[:2]).max() >= _STILL_PX)


def blurred(image: Array, mask: Array) -> Array:
    """Replace each connected part of a mask by a few blocks of its mean colours, which run into one another.

    Parameters
    ----------
    image : (H, W, 3) uint8
        Not changed.
    mask : (H, W) uint8
        0 where the picture stays as it is.

    Returns
    -------
    (H, W, 3) uint8
    """
    result = image.copy()
    count, parts, boxes, _ = cv2.connectedComponentsWithStats(mask)
    for part in range(1, count):
        x, y, width, height = boxes[part, :4].tolist()
        box = slice(y, y + height), slice(x, x + width)
        block = max(_LEAST_BLOCK, max(width, height) / _BLOCKS)
        blocks = max(1, round(width / block)), max(1, round(height / block))
        coarse = cv2.resize(image[box], blocks, interpolation=cv2.INTER_AREA)
        smooth = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_LINEAR)
        cv2.copyTo(smooth, (parts[box] == part).view(np.uint8), result[box])
    return result
