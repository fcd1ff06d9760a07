"""Labels drawn over a picture so that people can tell which object is which, on dark and on light video."""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np

from mlbs_actors.messages import BACKGROUND, Array
from orchestrator.sinks.layer_colours import layer_colour

__all__ = ["draw_caption", "draw_labels"]

_OPACITY = 0.4
_LINE_PX = 1 / 360  # width of an outline against the picture's shorter side
_TEXT_PX = 1 / 28  # height of a digit against the picture's shorter side
_LEAST_TEXT_PX = 12
_FONT = cv2.FONT_HERSHEY_SIMPLEX
_FONT_PX = 22  # height of this font's digits at scale 1


def draw_labels(image: Array, labels: Array) -> Array:
    """Tint each layer with its colour, outline it in light and dark, and write its id on it.

    Parameters
    ----------
    image : (H, W, 3) uint8
        BGR; not changed.
    labels : (H, W) uint16
        An id's colour is that of :mod:`orchestrator.sinks.layer_colours`.

    Returns
    -------
    (H, W, 3) uint8
    """
    drawn = image.copy()
    line = max(1, round(min(image.shape[:2]) * _LINE_PX))
    around = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * line + 1, 2 * line + 1))
    texts = []
    # Some pixels more on each side for the dark rim.
    all_objects = _box((labels != BACKGROUND).view(np.uint8), line)
    objects, canvases = labels[all_objects], drawn[all_objects]
    for layer in _ids(objects):
        if layer == BACKGROUND:
            continue
        mask = (objects == layer).view(np.uint8)
        box = _box(mask, line)
        # OpenCV's masked copies take a tenth of the time of assignments by a mask.
        mask, canvas = mask[box], canvases[box]
        colour = cv2.merge([np.full(mask.shape, channel, np.uint8) for channel in layer_colour(layer)])
        cv2.copyTo(cv2.addWeighted(canvas, 1 - _OPACITY, colour, _OPACITY, 0), mask, canvas)
        cv2.copyTo(colour, cv2.absdiff(mask, cv2.erode(mask, around)), canvas)
        free = (objects[box] == BACKGROUND).view(np.uint8)
        cv2.copyTo(np.zeros_like(canvas), cv2.bitwise_and(cv2.dilate(mask, around), free), canvas)
        x, y = _inner_point(mask)
        left, top = (all_objects[axis].start + box[axis].start for axis in (1, 0))
        texts.append((str(layer), (left + x, top + y)))
    for text, place in texts:
        _write(drawn, text, place)
    return drawn


def draw_caption(image: Array, text: str) -> None:
    """Write a line into the picture's upper left corner, in place."""
    _write(image, text, (0, 0))


def _ids(labels: Array) -> list[int]:
    """Which ids there are: each begins somewhere in a row."""
    begins = labels[:, 1:] != labels[:, :-1]
    ids: list[int] = np.unique(np.concatenate([labels[:, 0], labels[:, 1:][begins]])).tolist()
    return ids


def _box(mask: Array, margin: int) -> tuple[slice, slice]:
    """The smallest box that holds all of a mask's pixels, and some more on each side."""
    x, y, width, height = cv2.boundingRect(mask)
    left, top = max(x - margin, 0), max(y - margin, 0)
    return slice(top, y + height + margin), slice(left, x + width + margin)


def _inner_point(mask: Array) -> tuple[int, int]:
    """The mean (x, y) of a mask's pixels if it lies on the mask, else the pixel deepest inside."""
    moments = cv2.moments(mask, binaryImage=True)
    x, y = round(moments["m10"] / moments["m00"]), round(moments["m01"] / moments["m00"])
    if not mask[y, x]:
        rimmed = cv2.copyMakeBorder(mask, 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=0)
        depth = cv2.distanceTransform(rimmed, cv2.DIST_L2, 3)[1:-1, 1:-1]
        y, x = (int(axis) for axis in np.unravel_index(int(depth.argmax()), depth.shape))
    return x, y


def _write(picture: Array, text: str, centre: tuple[int, int]) -> None:
    """Write white text with a black rim around a point, moved so far that it lies in the picture."""
    fill, rim = _stencil(text, _text_height(picture))
    height, width = fill.shape
    top = max(min(centre[1] - height // 2, picture.shape[0] - height), 0)
    left = max(min(centre[0] - width // 2, picture.shape[1] - width), 0)
    patch = picture[top : top + height, left : left + width]
    fill, rim = fill[: patch.shape[0], : patch.shape[1]], rim[: patch.shape[0], : patch.shape[1]]
    patch[:] = cv2.max(cv2.subtract(patch, cv2.merge([rim] * 3)), cv2.merge([fill] * 3))


@lru_cache(maxsize=256)
def _stencil(text: str, digit_height: int) -> tuple[Array, Array]:
    """How much (0 … 255) of each pixel the strokes of a text cover, and these with a rim around them."""
    scale, rim = digit_height / _FONT_PX, max(1, round(digit_height / 8))
    stroke = max(1, round(digit_height / 7))
    (width, height), below = cv2.getTextSize(text, _FONT, scale, stroke)
    fill = np.zeros((height + below + 4 * rim, width + 4 * rim), np.uint8)
    cv2.putText(fill, text, (2 * rim, height + 2 * rim), _FONT, scale, 255, stroke, cv2.LINE_AA)
    around = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * rim + 1, 2 * rim + 1))
    return fill, cv2.dilate(fill, around)


def _text_height(picture: Array) -> int:
    shorter = int(min(picture.shape[:2]))
    return max(_LEAST_TEXT_PX, round(shorter * _TEXT_PX))
