"""What moves, made unrecognisable.

A label map does not cover a moving object exactly: outlines lag by a few pixels, limbs are missing in a frame
and back in the next one, and an object has its first label some frames after its first move. So the area that
is blurred reaches beyond the label map, in the picture and in time.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
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

#: Less motion of the camera is not followed; cells.
_STILL = 0.5


def is_private(description: Mapping[str, Any]) -> bool:
    """Whether a run with this ``run.json`` hides what moves."""
    return bool(description.get("private", False))


class MovingArea:
    """Where things move in the newest frames of a stream, with what is around them.

    Frames are looked at in cells of a third of the margin, all of which are hidden if anything in them is.
    """

    def __init__(self) -> None:
        self._maps: deque[_Objects] = deque(maxlen=FRAMES_BEFORE + 1 + FRAMES_AFTER)  # newest last

    def follow(self, labels: Array, camera: Sequence[float] | None) -> None:
        """Take in the next label map.

        Parameters
        ----------
        labels : (H, W) uint16
        camera : sequence of 9 float, optional
            Homography of the background, row by row, that takes pixels of this frame to where they were in
            the one before; None if unknown.
        """
        self._maps.append(_Objects.of(labels, camera))

    def mask(self, later: int = 0) -> Array:
        """Return what is to be hidden in a frame.

        Parameters
        ----------
        later : int
            Number of label maps after the frame's own, at most :data:`FRAMES_AFTER`.

        Returns
        -------
        (h, w) uint8
            1 in cells that are to be hidden, 0 elsewhere; see :func:`blurred`.
        """
        maps = list(self._maps)
        own = len(maps) - 1 - later
        hidden = maps[own].cells.copy()
        there: Array = np.eye(3)  # from the frame to the one whose objects are added
        for place in range(own, max(own - FRAMES_BEFORE, 0), -1):
            there = maps[place].back @ there
            _add(maps[place - 1].cells, there, hidden)
        there = np.eye(3)
        for one in maps[own + 1 :]:
            there = np.linalg.solve(one.back, there)
            _add(one.cells, there, hidden)
        margin = round(_margin(maps[own].shape) / _cell(maps[own].shape))
        # Gaps of up to two margins between what is hidden are hidden, too: limbs show through them.
        wide = cv2.dilate(hidden, np.ones((4 * margin + 1,) * 2, np.uint8))
        return np.asarray(cv2.erode(wide, np.ones((2 * margin + 1,) * 2, np.uint8)))


@dataclass(frozen=True, slots=True)
class _Objects:
    """A label map in cells.

    Attributes
    ----------
    shape : (H, W)
    cells : (h, w) uint8
        1 where there is an object.
    back : (3, 3) float64
        Homography of the background to the frame before, in cells.
    """

    shape: tuple[int, int]
    cells: Array
    back: Array

    @classmethod
    def of(cls, labels: Array, camera: Sequence[float] | None) -> _Objects:
        height, width = labels.shape
        cell = _cell((height, width))
        size = math.ceil(width / cell), math.ceil(height / cell)
        objects = np.where(labels != BACKGROUND, np.uint8(255), np.uint8(0))
        cells = np.asarray(cv2.resize(objects, size, interpolation=cv2.INTER_AREA) > 0).view(np.uint8)
        if camera is None:
            return cls((height, width), cells, np.eye(3))
        # As precise as in the tables, so that a record that is read again hides the same.
        back = np.array(camera, np.float32).astype(np.float64).reshape(3, 3)
        across, down = size[0] / width, size[1] / height
        # Pixels' centres are whole numbers.
        to_cells = np.array([[across, 0, (across - 1) / 2], [0, down, (down - 1) / 2], [0, 0, 1]])
        return cls((height, width), cells, to_cells @ back @ np.linalg.inv(to_cells))


def _margin(shape: tuple[int, int]) -> int:
    return math.ceil(min(shape) * _MARGIN)


def _cell(shape: tuple[int, int]) -> int:
    return max(1, _margin(shape) // 3)


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
    """Whether a homography moves a corner by half a cell: mostly a camera stands still."""
    corners = np.array([[0, width, 0, width], [0, 0, height, height], [1, 1, 1, 1]], np.float64)
    moved = there @ corners
    return bool(np.abs(moved[:2] / moved[2] - corners[:2]).max() >= _STILL)


def blurred(image: Array, mask: Array) -> Array:
    """Replace each connected part of a mask by a few blocks of its mean colours, which run into one another.

    Parameters
    ----------
    image : (H, W, 3) uint8
        Not changed.
    mask : (h, w) uint8
        0 where the picture stays as it is. Each of its pixels stands for a part of the picture.

    Returns
    -------
    (H, W, 3) uint8
    """
    result = image.copy()
    down, across = image.shape[0] / mask.shape[0], image.shape[1] / mask.shape[1]
    count, parts, boxes, _ = cv2.connectedComponentsWithStats(mask)
    for part in range(1, count):
        x, y, width, height = boxes[part, :4].tolist()
        inside = (parts[y : y + height, x : x + width] == part).view(np.uint8)
        top, bottom = math.floor(y * down), math.ceil((y + height) * down)
        left, right = math.floor(x * across), math.ceil((x + width) * across)
        picture, size = result[top:bottom, left:right], (right - left, bottom - top)
        block = max(_LEAST_BLOCK, max(size) / _BLOCKS)
        blocks = max(1, round(size[0] / block)), max(1, round(size[1] / block))
        coarse = cv2.resize(image[top:bottom, left:right], blocks, interpolation=cv2.INTER_AREA)
        smooth = cv2.resize(coarse, size, interpolation=cv2.INTER_LINEAR)
        cv2.copyTo(smooth, cv2.resize(inside, size, interpolation=cv2.INTER_NEAREST), picture)
    return result
