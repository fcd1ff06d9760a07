"""How lengths grow with the frame: they are stated in px of a 640×480 frame."""

from __future__ import annotations

import math

__all__ = ["detail", "length_scale"]

#: Beyond so many sides of the reference frame a frame is large.
LARGE = 1.3


def length_scale(height: int, width: int) -> float:
    """How many px of an ``height`` × ``width`` frame make one px of the 640×480 reference frame.

    The side of a square of the same area counts in full up to ``LARGE`` sides of the reference frame (about
    960×540), and beyond that with a power of 0.4: what is filmed at 1920×1080 is filmed for its detail.
    """
    side = math.sqrt(height * width / (640 * 480))
    return side if side <= LARGE else LARGE * (side / LARGE) ** 0.4


def detail(height: int, width: int) -> float:
    """By how much things are smaller, in proportion, that a frame of this size is to show; 1 if not large."""
    return math.sqrt(height * width / (640 * 480)) / length_scale(height, width)
