"""Labels drawn over a picture so that objects can be distinguished, on dark and on light video."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from mlbs_actors.errors import FrameError
from mlbs_actors.messages import BACKGROUND, Array, Region
from mlbs_actors.pictures.layer_colours import layer_colour
from mlbs_actors.wording import described

__all__ = ["Outline", "draw_box", "draw_caption", "draw_labels", "draw_outlines"]

_OPACITY = 0.4
_OUTLINE = (255, 255, 255)
_LINE_PX = 1 / 360  # width of an outline against the picture's shorter side
_TEXT_PX = 1 / 28  # height of a digit against the picture's shorter side
_LEAST_TEXT_PX = 12
_LEAST_CAPTION_PX = 6
_LEAST_NAME_PX = 11
_FONT = cv2.FONT_HERSHEY_SIMPLEX
_FONT_PX = 22  # height of this font's digits at scale 1


@dataclass(frozen=True, slots=True)
class Outline:
    """A polygon or a line to be drawn over a picture.

    Attributes
    ----------
    name : str
    corners : (n, 2) float64
        x before y, px.
    closed : bool
        Whether the last one is joined to the first.
    """

    name: str
    corners: Array
    closed: bool = True


def draw_labels(
    image: Array, labels: Array, regions: Mapping[int, Region] | None = None, *, ids: bool = True
) -> Array:
    """Tint each layer with its colour, outline it in light and dark, and write its id on it.

    Parameters
    ----------
    image : (H, W, 3) uint8
        BGR; not changed.
    labels : (H, W) uint16
        An id's colour is that of :mod:`mlbs_actors.pictures.layer_colours`.
    regions : mapping of int to Region, optional
        The bounding boxes of all layers present, if known; else they are computed.
    ids : bool
        Whether ids are written.

    Returns
    -------
    (H, W, 3) uint8

    Raises
    ------
    FrameError
        If they are no image and label map of one size.
    """
    _check_labels(image, labels)
    drawn = image.copy()
    line = max(1, round(min(image.shape[:2]) * _LINE_PX))
    around = _disc(line)
    cut = []
    # All dark rims come first, so that a rim never covers another layer's outline.
    # OpenCV's masked copies take a tenth of the time of assignments by a mask.
    for layer, region in (_regions(labels) if regions is None else regions).items():
        left, top = max(region.x - line, 0), max(region.y - line, 0)
        box = slice(top, region.y + region.height + line), slice(left, region.x + region.width + line)
        mask, canvas = (labels[box] == layer).view(np.uint8), drawn[box]
        cv2.copyTo(np.zeros(canvas.shape, np.uint8), cv2.dilate(mask, around), canvas)
        cut.append((layer, left, top, mask, canvas, image[box]))
    texts = []
    for layer, left, top, mask, canvas, picture in cut:
        colour = np.empty(canvas.shape, np.uint8)
        cv2.rectangle(colour, (0, 0), (mask.shape[1], mask.shape[0]), layer_colour(layer), cv2.FILLED)
        cv2.copyTo(colour, mask, canvas)
        tinted = cv2.addWeighted(picture, 1 - _OPACITY, colour, _OPACITY, 0)
        cv2.copyTo(tinted, cv2.erode(mask, around), canvas)
        if ids:
            x, y = _inner_point(mask)
            texts.append((str(layer), (left + x, top + y)))
    digit_height = _text_height(drawn)
    for text, place in texts:
        _write(drawn, text, place, digit_height)
    return drawn


def _check_labels(image: Array, labels: Array) -> None:
    for name, given, axes in (("image", image, 3), ("labels", labels, 2)):
        if not isinstance(given, np.ndarray):
            advice = "; give result.labels" if hasattr(given, "labels") else ""
            raise FrameError(f"{name} must be an array, not {described(given)}{advice}.")
        if given.ndim != axes:
            raise FrameError(
                f"{name} is {described(given)}; give draw_labels the picture, (height, width, 3) uint8, and "
                "then the label map, (height, width)."
            )
    if image.shape[:2] != labels.shape:
        raise FrameError(
            f"The picture is {image.shape[1]}×{image.shape[0]} px, the label map {labels.shape[1]}×"
            f"{labels.shape[0]}; give those of one frame, or resize the picture first."
        )


def draw_caption(image: Array, text: str) -> None:
    """Write a line into the picture's upper left corner; one that is too long for it in smaller letters.

    Parameters
    ----------
    image : (H, W, 3) uint8
        BGR; drawn on in place.
    text : str
        White with a black rim. Letters have a 28th of the shorter side's height, at least 12 px, and for a
        long line 6 px at least; what does not fit even so is cut off.
    """
    usual = _text_height(image)
    heights = range(usual, _LEAST_CAPTION_PX - 1, -1)
    fitting = (height for height in heights if _stencil(text, height)[0].shape[1] <= image.shape[1])
    _write(image, text, (0, 0), next(fitting, usual))


def draw_outlines(image: Array, outlines: Iterable[Outline]) -> None:
    """Draw thin outlines and lines, white with a black rim, with their names in the middle.

    Parameters
    ----------
    image : (H, W, 3) uint8
        BGR, C-contiguous or a rectangle of such a picture; drawn on in place.
    outlines : iterable of Outline
        Those that do not reach into the picture are left out.
    """
    for outline in outlines:
        farthest = 10 * max(
            image.shape
        )  # OpenCV draws nothing of what is farther away than its integers reach
        corners = np.rint(np.clip(outline.corners, -farthest, farthest)).astype(np.int32)
        if not len(corners) or not _in_picture(corners, image):
            continue
        for colour, width in (((0, 0, 0), 3), (_OUTLINE, 1)):
            cv2.polylines(image, [corners], outline.closed, colour, width, cv2.LINE_AA)
        x, y = corners.mean(axis=0).round().astype(int).tolist()
        _write(image, outline.name, (x, y), max(_text_height(image) * 2 // 3, _LEAST_NAME_PX))


def draw_box(image: Array, box: tuple[int, int, int, int], layer: int, *, ids: bool = True) -> None:
    """Draw a box in the colour of a layer, with its id above it, or below where there is no room.

    Parameters
    ----------
    image : (H, W, 3) uint8
        BGR, C-contiguous or a rectangle of such a picture; drawn on in place.
    box : tuple of int
        Left, top, width and height, px; it may reach beyond the picture.
    layer : int
        Its id, whose colour is that of :mod:`mlbs_actors.pictures.layer_colours`.
    ids : bool
        Whether the id is written.
    """
    left, top, width, height = box
    line = max(1, round(min(image.shape[:2]) * _LINE_PX))
    for colour, thickness in (((0, 0, 0), 3 * line + 1), (layer_colour(layer), line + 1)):
        cv2.rectangle(image, (left, top), (left + width - 1, top + height - 1), colour, thickness)
    if ids:
        digits = _text_height(image)
        above, below = top - digits, top + height + digits
        y = above if above >= digits else min(below, image.shape[0])
        _write(image, str(layer), (left + width // 2, y), digits)


def _in_picture(corners: Array, image: Array) -> bool:
    low, high = corners.min(axis=0), corners.max(axis=0)
    return bool((high >= 0).all() and (low < image.shape[1::-1]).all())


def _regions(labels: Array) -> dict[int, Region]:
    """Return the bounding box of each layer present, in ascending id."""
    begins = labels[:, 1:] != labels[:, :-1]  # each layer begins somewhere in a row
    layers = np.unique(np.concatenate([labels[:, 0], labels[:, 1:][begins]])).tolist()
    return {
        layer: Region(*cv2.boundingRect((labels == layer).view(np.uint8)))
        for layer in layers
        if layer != BACKGROUND
    }


def _inner_point(mask: Array) -> tuple[int, int]:
    """Return the mean (x, y) of a mask's pixels if it lies on the mask, else the pixel deepest inside."""
    moments = cv2.moments(mask)  # of zeros and ones; OpenCV's flag for binary images makes it slower
    x, y = round(moments["m10"] / moments["m00"]), round(moments["m01"] / moments["m00"])
    if not mask[y, x]:
        rimmed = cv2.copyMakeBorder(mask, 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=0)
        depth = cv2.distanceTransform(rimmed, cv2.DIST_L2, 3)[1:-1, 1:-1]
        y, x = (int(axis) for axis in np.unravel_index(int(depth.argmax()), depth.shape))
    return x, y


def _write(picture: Array, text: str, centre: tuple[int, int], digit_height: int) -> None:
    """Write white text with a black rim around a point, shifted into the picture."""
    fill, rim = _stencil(text, digit_height)
    height, width = fill.shape[:2]
    top = max(min(centre[1] - height // 2, picture.shape[0] - height), 0)
    left = max(min(centre[0] - width // 2, picture.shape[1] - width), 0)
    patch = picture[top : top + height, left : left + width]
    fill, rim = fill[: patch.shape[0], : patch.shape[1]], rim[: patch.shape[0], : patch.shape[1]]
    patch[:] = cv2.max(cv2.subtract(patch, rim), fill)


@lru_cache(maxsize=256)
def _stencil(text: str, digit_height: int) -> tuple[Array, Array]:
    """Return the coverage (0 … 255) of each pixel's channels by a text's strokes, without and with rim."""
    scale, rim = digit_height / _FONT_PX, max(1, round(digit_height / 8))
    stroke = max(1, round(digit_height / 7))
    (width, height), below = cv2.getTextSize(text, _FONT, scale, stroke)
    fill = np.zeros((height + below + 4 * rim, width + 4 * rim), np.uint8)
    cv2.putText(fill, text, (2 * rim, height + 2 * rim), _FONT, scale, 255, stroke, cv2.LINE_AA)
    return cv2.merge([fill] * 3), cv2.merge([cv2.dilate(fill, _disc(rim))] * 3)


@lru_cache(maxsize=16)
def _disc(radius: int) -> Array:
    return cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))


def _text_height(picture: Array) -> int:
    shorter = int(min(picture.shape[:2]))
    return max(_LEAST_TEXT_PX, round(shorter * _TEXT_PX))
