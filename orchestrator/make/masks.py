"""Masks of frames: at the small size at which they are joined, whole again, widened, and packed."""

from __future__ import annotations

import cv2
import numpy as np

from mlbs_actors.messages import Array

__all__ = ["SMALL_WIDTH", "packed", "small_mask", "unpacked", "whole_mask", "widened"]

#: Width of small masks, px, at most.
SMALL_WIDTH = 320


def small_mask(covered: Array, width: int = SMALL_WIDTH) -> Array:
    """Make a mask (H, W) bool no wider than so many px."""
    scale = min(1.0, width / covered.shape[1])
    size = tuple(max(1, round(side * scale)) for side in covered.shape[::-1])
    small: Array = cv2.resize(covered * np.uint8(255), size, interpolation=cv2.INTER_AREA) >= 128
    return small


def whole_mask(small: Array, shape: tuple[int, ...]) -> Array:
    """Bring a small mask (h, w) bool to the shape of its frame."""
    whole: Array = cv2.resize(small * np.uint8(255), shape[::-1], interpolation=cv2.INTER_LINEAR) >= 128
    return whole


def widened(mask: Array, radius: int) -> Array:
    """Widen a mask (h, w) bool by so many px."""
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))
    wide: Array = cv2.dilate(mask.astype(np.uint8), disc) > 0
    return wide


def packed(mask: Array) -> bytes:
    """Pack a mask (h, w) bool, to keep one for each frame of a clip."""
    return cv2.imencode(".png", mask * np.uint8(255))[1].tobytes()


def unpacked(mask: bytes) -> Array:
    """Return the mask that was packed, (h, w) bool."""
    picture = cv2.imdecode(np.frombuffer(mask, np.uint8), cv2.IMREAD_GRAYSCALE)
    assert picture is not None  # it was written here
    return np.asarray(picture > 0)
