"""Frames that show nothing new of the scene: blank ones, and repetitions of the last picture.

Black and white frames, a lens that is covered, a decoder that repeats what it had: there is no motion in
them, and flow that is searched all the same finds some. Nor is there in what a fixed camera sees of an empty
place, but for noise, and to look at that takes as long as to look at a crowd.

Insects on paper, lights in the night and birds in the sky make even pictures as well. A blank one has lost
what there was in the last one.
"""

from __future__ import annotations

import cv2
import numpy as np

from mlbs_actors.messages import Array

__all__ = ["is_blank", "is_still", "repeats"]

#: A picture is even if its grey levels lie within so many of each other, but for a share of its cells.
EVEN_RANGE, EVEN_REST = 8, 0.02
#: Such cells are no structure if they are so few, or at most this share of those in the last picture.
LEAST_STRUCTURE, LEFT_STRUCTURE = 0.001, 0.25
#: Largest and mean difference of a repetition, grey levels: what a codec makes of the same picture.
REPEATED_MOST, REPEATED_MEAN = 3, 0.25
#: Largest mean difference over a square of cells that noise makes, grey levels, and the square's side, cells.
NOISE_MOST, NOISE_SIDE = 2.5, 5


def is_blank(gray: Array, before: Array) -> bool:
    """Whether a picture shows nothing of the scene.

    Parameters
    ----------
    gray : (h, w) uint8
    before : (h, w) uint8 or (0, 0) uint8
        The last picture that showed something; empty if there is none.

    Returns
    -------
    bool
        Whether it is of one brightness, but for few of its cells, and the last picture was not like that.
    """
    level, rest = _evenness(gray)
    if rest > EVEN_REST:
        return False
    if before.size == 0:
        return rest <= LEAST_STRUCTURE
    last_level, last_rest = _evenness(before)
    if last_rest <= EVEN_REST and abs(level - last_level) <= EVEN_RANGE:
        return False  # the place is even: it shows what is left of it
    return rest <= max(LEAST_STRUCTURE, LEFT_STRUCTURE * last_rest)


def _evenness(gray: Array) -> tuple[int, float]:
    """Return the lowest of the ``EVEN_RANGE`` grey levels of most cells, and the share of all other cells."""
    counts = cv2.calcHist([gray], [0], None, [256], [0, 256]).reshape(-1)  # float32, exact up to 16.7 million
    below = np.concatenate([[0], np.cumsum(counts)])
    inside = below[EVEN_RANGE:] - below[:-EVEN_RANGE]
    return int(inside.argmax()), 1.0 - float(inside.max()) / gray.size


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
