"""What masks miss of objects, roughly, for what is to be covered: by where they are in the frames around.

An object is found some frames after it begins to move, may be lost and found again, and its masks lose a limb
now and then.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np

from mlbs_actors.messages import Array
from mlbs_actors.record.recorded_stream import RecordedFrame
from orchestrator.make.footage import Footage, Shot
from orchestrator.make.masks_around import AROUND, masks_around, small_mask

__all__ = ["covered_shots"]

#: Width of the masks that are joined, px, at most.
_WIDTH = 320
#: Of the picture's width: how far from an object's mask the joined masks count.
_REACH = 1 / 25


def covered_shots(footage: Footage, doing: str) -> Iterator[tuple[Shot, Array]]:
    """Yield the shots of the footage, each with where a chosen object is or may be.

    Parameters
    ----------
    footage : Footage
    doing : str
        As for :meth:`.footage.Footage.shots`.

    Yields
    ------
    Shot
    (H, W) bool
        The masks of the chosen objects, and near them those of the :data:`~.masks_around.AROUND` frames
        before and after; of an object that comes within so many frames, has just come or gone, all of these.
        Nothing of other objects.
    """
    changing = _changing(footage.recorded())
    joined = masks_around(footage.recorded(), _WIDTH)
    for shot in footage.shots(doing):
        around = next(mask for index, mask in joined if index == shot.frame.index)
        chosen, others = shot.masks()
        known = small_mask(chosen, _WIDTH)
        if (written := changing.get(shot.frame.index)) is not None:
            known |= _read(written)
        reach = max(1, round(_REACH * known.shape[1]))
        disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1))
        near = cv2.dilate(known.view(np.uint8), disc).view(np.bool_)
        missed = ((around & near) | known).astype(np.uint8) * np.uint8(255)
        whole = cv2.resize(missed, chosen.shape[::-1], interpolation=cv2.INTER_LINEAR) >= 128
        yield shot, (whole | chosen) & ~others


@dataclass(slots=True)
class _Change:
    """The frames around one in which an object comes or goes."""

    layer: int
    comes: bool
    frames: list[RecordedFrame]
    ahead: int = AROUND  # frames that are still to come


def _changing(frames: Iterable[RecordedFrame]) -> dict[int, bytes]:
    """Return where objects are likely to be in the frames around which they come or go, as PNG pictures.

    The first masks of an object are the least whole, so those after them count as much as those before.
    """
    found: dict[int, bytes] = {}
    before = deque[RecordedFrame](maxlen=AROUND)
    present: set[int] = set()
    changes: list[_Change] = []
    for frame in frames:
        now = {one.layer for one in frame.objects}
        changes += [_Change(layer, layer in now, [*before]) for layer in sorted(now ^ present)]
        for change in changes:
            change.frames.append(frame)
            change.ahead -= 1
        for change in changes:
            if not change.ahead:
                _add(found, change)
        changes = [change for change in changes if change.ahead]
        before.append(frame)
        present = now
    for change in changes:
        _add(found, change)
    return found


def _add(found: dict[int, bytes], change: _Change) -> None:
    alone = [_alone(frame, change.layer) for frame in change.frames]
    counted = {frame.index for frame in alone if change.comes or not frame.objects}
    for index, mask in masks_around(alone, _WIDTH):
        if index in counted:
            known = _read(found[index]) if index in found else False
            found[index] = cv2.imencode(".png", (mask | known) * np.uint8(255))[1].tobytes()


def _alone(frame: RecordedFrame, layer: int) -> RecordedFrame:
    pairs = [pair for pair in zip(frame.objects, frame.codes, strict=True) if pair[0].layer == layer]
    return replace(frame, objects=tuple(one for one, _ in pairs), codes=tuple(code for _, code in pairs))


def _read(written: bytes) -> Array:
    mask = cv2.imdecode(np.frombuffer(written, np.uint8), cv2.IMREAD_GRAYSCALE)
    assert mask is not None  # it was written here
    return np.asarray(mask > 0)
