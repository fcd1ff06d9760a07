"""Pictures in which what was chosen is blurred, pixelated, or all that has its colours.

What is blurred reaches a little beyond objects and over narrow gaps in them, as label maps do not cover them
to the last pixel; what belongs to others is left as it is.
"""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from mlbs_actors.messages import Array
from orchestrator.make.footage import Shot

__all__ = ["COVERS", "blurred", "highlighted", "pixelated"]

#: As shares of the picture's shorter side: the margin, the blur's standard deviation, a block of a mosaic.
_MARGIN, _BLUR, _BLOCK = 1 / 120, 1 / 32, 1 / 32

_LEAST_MARGIN, _LEAST_BLOCK = 2, 4  # px
_COARSER = 4  # times, in which a wide blur is computed

#: Brightness of what is grey beside what has colours.
_DIMMED = 0.6


def blurred(shot: Shot, covered: Array) -> Array:
    """Blur what is covered, (H, W) bool; returns (H, W, 3) uint8."""
    picture, area = shot.picture, _area(covered, shot.masks()[1])
    height, width = picture.shape[:2]
    # A blur that wide looks the same from a quarter of the picture, in a tenth of the time.
    coarse = cv2.resize(
        picture, (-(-width // _COARSER), -(-height // _COARSER)), interpolation=cv2.INTER_AREA
    )
    smooth = cv2.GaussianBlur(coarse, (0, 0), max(1.0, _BLUR * min(height, width) / _COARSER))
    return _where(area, np.asarray(cv2.resize(smooth, (width, height))), picture)


def pixelated(shot: Shot, covered: Array) -> Array:
    """Replace the blocks that hold anything covered, (H, W) bool, by their mean colours."""
    picture, others = shot.picture, shot.masks()[1]
    height, width = covered.shape
    block = max(_LEAST_BLOCK, round(_BLOCK * min(height, width)))
    below, right = -height % block, -width % block
    padded = cv2.copyMakeBorder(picture, 0, below, 0, right, cv2.BORDER_REPLICATE)
    blocks = padded.shape[1] // block, padded.shape[0] // block
    touched = cv2.copyMakeBorder(
        covered.view(np.uint8) * 255, 0, below, 0, right, cv2.BORDER_CONSTANT, value=0
    )
    touched = np.asarray(cv2.resize(touched.astype(np.float32), blocks, interpolation=cv2.INTER_AREA) > 0)
    means = cv2.resize(padded, blocks, interpolation=cv2.INTER_AREA)
    mosaic = means.repeat(block, axis=0).repeat(block, axis=1)[:height, :width]
    area = touched.repeat(block, axis=0).repeat(block, axis=1)[:height, :width]
    return _where(area & ~others, mosaic, picture)


def highlighted(shot: Shot) -> Array:
    """Make all grey and darker but the chosen objects; returns (H, W, 3) uint8."""
    chosen, _ = shot.masks()
    grey = cv2.convertScaleAbs(cv2.cvtColor(shot.picture, cv2.COLOR_BGR2GRAY), alpha=_DIMMED)
    return _where(chosen, shot.picture, np.asarray(cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR)))


#: By the names of their kinds, what makes somebody unrecognisable; given where that is to be.
COVERS: dict[str, Callable[[Shot, Array], Array]] = {"blur": blurred, "pixelate": pixelated}


def _area(covered: Array, others: Array) -> Array:
    """Return what is covered with its margin, without the pixels of others, (H, W) bool."""
    margin = max(_LEAST_MARGIN, round(_MARGIN * min(covered.shape)))
    # With a border, as what lies beyond it would be nearer to the erosion than to the dilation.
    around = 3 * margin
    wide = cv2.copyMakeBorder(covered.view(np.uint8), around, around, around, around, cv2.BORDER_REPLICATE)
    closed = cv2.erode(cv2.dilate(wide, _disc(3 * margin)), _disc(2 * margin))
    return closed[around:-around, around:-around].view(np.bool_) & ~others


def _disc(radius: int) -> Array:
    return cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))


def _where(area: Array, picture: Array, other: Array) -> Array:
    result = other.copy()
    cv2.copyTo(np.ascontiguousarray(picture), area.astype(np.uint8), result)
    return result
