"""Where objects are in the frames around each one: a mask that leaves something out is often whole in others.

An object is found some frames after it begins to move, and its masks lose a limb and find it again.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import chain, islice

import cv2
import numpy as np

from mlbs_actors.messages import BACKGROUND, Array
from mlbs_actors.record.recorded_stream import RecordedFrame
from orchestrator.make.masks import small_mask

__all__ = ["AROUND", "mask_at", "masks_around"]

#: Frames before and after one whose masks are joined: an object is found about so long after its start.
AROUND = 12


@dataclass(frozen=True, slots=True)
class _Mask:
    """A frame's index, its mask, (h, w) uint8, and the homography from its pixels to the frame before."""

    index: int
    mask: Array
    back: Array


def masks_around(frames: Iterable[RecordedFrame], width: int) -> Iterator[tuple[int, Array]]:
    """Join the masks of the frames around each one, carried into it by the camera's motion.

    Parameters
    ----------
    frames : iterable of RecordedFrame
        Of one stream, in order.
    width : int
        Masks are made no wider, px.

    Yields
    ------
    int
        Index of each frame.
    (h, w) bool
        Where an object is in it, or in one of the :data:`AROUND` before and after it.
    """
    window = deque[_Mask]()
    ahead = 0  # how many of them come after the frame at hand
    for frame in chain(frames, [None] * AROUND):
        if frame is not None:
            window.append(_mask_of(frame, width))
            ahead += 1
            if ahead <= AROUND:
                continue
        elif not ahead:
            return
        ahead -= 1
        here = len(window) - 1 - ahead
        yield window[here].index, _joined(window, here)
        if here == AROUND:
            window.popleft()


def mask_at(index: int, masks: Iterator[tuple[int, Array]]) -> Array:
    """Take the mask of a frame; those of frames before it, which could not be read again, are passed over."""
    return next(mask for other, mask in masks if other == index)


def _mask_of(frame: RecordedFrame, width: int) -> _Mask:
    mask = small_mask(frame.labels() != BACKGROUND, width)
    back = np.eye(3) if frame.camera is None else np.reshape(frame.camera, (3, 3))
    scale = np.diag([mask.shape[1] / frame.width, mask.shape[0] / frame.height, 1.0])
    return _Mask(frame.index, mask.astype(np.uint8), scale @ back @ np.linalg.inv(scale))


def _joined(window: deque[_Mask], here: int) -> Array:
    joined = window[here].mask.copy()
    size = joined.shape[1], joined.shape[0]
    later = [(one, one.back) for one in islice(window, here + 1, None)]
    earlier = [(window[number], np.linalg.inv(window[number + 1].back)) for number in range(here - 1, -1, -1)]
    for way in (later, earlier):
        to_here = np.eye(3)
        for one, step in way:
            to_here = to_here @ step
            if one.mask.shape == joined.shape:
                joined |= cv2.warpPerspective(one.mask, to_here, size, flags=cv2.INTER_NEAREST)
    return joined > 0
