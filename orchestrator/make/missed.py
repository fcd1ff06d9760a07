"""What masks miss of objects, roughly, for what is to be covered: by where they are in the frames around.

An object is found some frames after it begins to move, may be lost and found again, and its masks lose a limb
now and then.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

from mlbs_actors.messages import Array
from mlbs_actors.record.recorded_stream import RecordedFrame
from orchestrator.make.footage import Footage, Shot
from orchestrator.make.masks import SMALL_WIDTH, packed, small_mask, unpacked, whole_mask, widened
from orchestrator.make.masks_around import AROUND, mask_at, masks_around

__all__ = ["covered_shots"]

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
    joined = masks_around(footage.recorded(), SMALL_WIDTH)
    for shot in footage.shots(doing):
        around = mask_at(shot.frame.index, joined)
        chosen, others = shot.masks()
        known = small_mask(chosen)
        if (written := changing.get(shot.frame.index)) is not None:
            known |= unpacked(written)
        near = widened(known, max(1, round(_REACH * known.shape[1])))
        missed = whole_mask((around & near) | known, chosen.shape)
        yield shot, (missed | chosen) & ~others


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
    for index, mask in masks_around(alone, SMALL_WIDTH):
        if index in counted:
            known = unpacked(found[index]) if index in found else False
            found[index] = packed(mask | known)


def _alone(frame: RecordedFrame, layer: int) -> RecordedFrame:
    pairs = [pair for pair in zip(frame.objects, frame.codes, strict=True) if pair[0].layer == layer]
    return replace(frame, objects=tuple(one for one, _ in pairs), codes=tuple(code for _, code in pairs))
