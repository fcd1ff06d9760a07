"""Frames that show nothing new of the scene: blank ones, and repetitions of the last picture.

Black and white frames, a lens that is covered, a decoder that repeats what it had: there is no motion in
them, and flow that is searched all the same finds some. Nor is there in what a fixed camera sees of an empty
place, but for noise, and to look at that takes as long as to look at a crowd.
"""

from __future__ import annotations

import cv2
import numpy as np

from mlbs_actors.messages import Array

__all__ = ["is_blank", "is_still", "repeats"]

#: A picture whose grey levels lie within so many of each other, but for a share of its cells, shows nothing.
BLANK_RANGE, BLANK_REST = 8, 0.02
#: Largest and mean difference of a repetition, grey levels: what a codec makes of the same picture.
REPEATED_MOST, REPEATED_MEAN = 3, 0.25
#: Largest mean difference over a square of cells that noise makes, grey levels, and the square's side, cells.
NOISE_MOST, NOISE_SIDE = 2.5, 5


def is_blank(gray: Array) -> bool:
    """Whether a picture (h, w) uint8 is of one brightness, but for a few of its cells."""
    counts = np.bincount(gray.reshape(-1), minlength=256)
    below = np.concatenate([[0], np.cumsum(counts)])
    inside = below[BLANK_RANGE:] - below[:-BLANK_RANGE]
    return bool(inside.max() >= (1.0 - BLANK_REST) * gray.size)


def repeats(gray: Array, before: Array) -> bool:
    """Whether a picture (h, w) uint8 is the one before again."""
    if gray.shape != before.shape:
        return False
    difference = cv2.absdiff(gray, before)
    return bool(difference.max() <= REPEATED_MOST and difference.mean() <= REPEATED_MEAN)


def is_still(gray: Array, before: Array) -> bool:
    """Whether a picture (h, w) uint8 differs from an earlier one by noise alone.

    Compared with the last picture that was not still, slow changes add up until they show.
    """
    if gray.shape != before.shape:
        return False
    difference = cv2.subtract(gray, before, dtype=cv2.CV_32F)
    return bool(np.abs(cv2.blur(difference, (NOISE_SIDE, NOISE_SIDE))).max() <= NOISE_MOST)
