"""Masks completed by the background: a leg or a shadow that a mask leaves out differs from what is behind it.

A first background is made of small frames, in which nothing near an object counts as background. Where a
frame differs from it, in one piece with a mask or where the object is in the frames around it, the mask is
completed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from mlbs_actors.messages import Array
from orchestrator.make.masks import small_mask, widened
from orchestrator.make.plate import CoveredFrame, fill_background

__all__ = ["KnownObjects", "completed_masks"]

#: Of the picture's width: how far from a mask the rest of it is looked for.
_REACH = 1 / 20
#: What differs from the background by more belongs to what covers it, grey levels, at least …
_DIFFERENT = 18.0
#: … and in multiples of what three quarters of the pixels beside it keep below: up to 7 levels where the
#: background can be placed, 15 to 40 where it cannot, so that next to nothing is added.
_USUAL = 3.0


@dataclass(frozen=True, slots=True)
class KnownObjects:
    """A frame, and what is known of its objects.

    Attributes
    ----------
    frame : (H, W, 3) uint8
        BGR.
    covered : (H, W) bool
        Their masks.
    around : (h, w) bool
        Where they are in the frames around it, at :data:`~orchestrator.make.masks.SMALL_WIDTH`.
    """

    frame: Array
    covered: Array
    around: Array


def completed_masks(frames: Callable[[], Iterable[KnownObjects]]) -> Iterator[Array]:
    """Complete the masks of a clip.

    Parameters
    ----------
    frames : callable
        Returns an iterable over the clip. It is called several times.

    Yields
    ------
    (h, w) bool
        The mask of each frame, in order, at :data:`~orchestrator.make.masks.SMALL_WIDTH`.
    """

    def small() -> Iterator[KnownObjects]:
        for known in frames():
            frame = cv2.resize(known.frame, known.around.shape[::-1], interpolation=cv2.INTER_AREA)
            covered = small_mask(known.covered)
            yield KnownObjects(frame, covered, known.around | covered)

    def looked_at() -> Iterator[CoveredFrame]:
        return ((known.frame, _near(known)) for known in small())

    for known, plate in zip(small(), fill_background(looked_at), strict=True):
        yield _completed(known, plate.picture, _near(known) & ~plate.never_seen)


def _near(known: KnownObjects) -> Array:
    return widened(known.around, max(1, round(_REACH * known.around.shape[1])))


def _completed(known: KnownObjects, background: Array, seen: Array) -> Array:
    """Add what differs from the background, where that was ``seen``, and hangs together with objects."""
    smooth = (cv2.GaussianBlur(one, (0, 0), 1.0) for one in (known.frame, background))
    difference = cv2.absdiff(*smooth).max(axis=2)
    beside = seen & ~known.around
    usual = float(np.percentile(difference[beside], 75)) if beside.any() else np.inf
    differs: Array = (seen & (difference > max(_DIFFERENT, _USUAL * usual))).astype(np.uint8)
    differs = cv2.morphologyEx(differs, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8)) | known.covered
    differs = cv2.morphologyEx(differs, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
    _, parts = cv2.connectedComponents(differs)
    completed: Array = (differs > 0) & np.isin(parts, np.setdiff1d(parts[known.around], 0))
    return completed
