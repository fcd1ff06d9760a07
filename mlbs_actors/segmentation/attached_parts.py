"""Which layers are parts of one object: limbs, a head, a turned body (§7).

A limb that moves by itself for long enough is a layer of its own, with its own motion and colours, which is
how it is segmented best. But it is not another object. A layer that appears in contact with a larger one, or
touches it widely in its first frames, is its part, and has its id in what is published, until the two have
been apart for some frames: then it is an object from there on. Where the larger one vanishes and most of the
object is still there in a part, say because a dancer has turned over, the part goes on as that object. Layers
that have met later, such as people who pass each other, are two objects however closely they touch.

Not in the paper, where each layer is an object.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace

import cv2
import numpy as np

from mlbs_actors.messages import Array, LayerSummary, Region, Segmentation

__all__ = ["PartsState", "find_parts", "join_parts"]

#: Label maps are looked at with so many rows or columns, whichever are fewer.
_ROWS = 240
#: Layers as near as this are in contact, in those rows.
_REACH = 4
#: A layer's outline in contact with an object, of a part that appears, and as long as it is one.
_LEAST_CONTACT = 0.1
#: The same of a layer that becomes a part within its first frames.
_WIDE_CONTACT = 0.3
#: A layer becomes a part within so many frames after the one that it appears in, or never.
_FIRST_FRAMES = 4
#: Largest area of a part that appears, relative to the layer that it touches.
_LARGEST_PART = 0.7
#: A part is an object after more frames than this without contact.
_MOST_APART = 6
#: A part of at least this share of its object's usual area goes on as the object when the rest has vanished.
_MOST_OF_IT = 0.5
#: Weight of a frame in the usual area.
_AREA_WEIGHT = 0.1


@dataclass(frozen=True, slots=True)
class PartsState:
    """The layers that have owned pixels, and what they are parts of; one in each row.

    A layer that sleeps keeps its row: when it wakes, it is what it was.

    Attributes
    ----------
    layers : (k,) int64
        Ascending.
    appeared : (k,) int64
        Frame in which each first owned pixels.
    part_of : (k,) int64
        Layer that it is a part of, 0 if it is an object of its own.
    apart : (k,) int64
        Frames since a part was last in contact with its object.
    usual : (k,) float64
        Usual area of the object that it is, or is a part of, in rows and columns that are looked at.
    live : (k,) int64
        Newest frame in which it was live.
    """

    layers: Array
    appeared: Array
    part_of: Array
    apart: Array
    usual: Array
    live: Array

    @staticmethod
    def empty() -> PartsState:
        """Before the first layer."""
        none = np.zeros(0, np.int64)
        return PartsState(none, none, none, none, np.zeros(0), none)

    def objects(self) -> dict[int, int]:
        """Return layer → the layer that it is a part of, of all parts."""
        rows = zip(self.layers.tolist(), self.part_of.tolist(), strict=True)
        return {layer: whole for layer, whole in rows if whole}

    def ages(self, frame_index: int) -> dict[int, int]:
        """Return layer → the frames since it first owned pixels."""
        return dict(zip(self.layers.tolist(), (frame_index - self.appeared).tolist(), strict=True))


@dataclass(slots=True)
class _Layer:
    """One row of the state."""

    appeared: int
    part_of: int = 0
    apart: int = 0
    usual: float = 0.0
    live: int = 0


def find_parts(
    state: PartsState,
    labels: Array,
    frame_index: int,
    live: Collection[int],
    remembered: int,
    apart: Collection[tuple[int, int]] = frozenset(),
) -> PartsState:
    """Decide which layers of a label map are parts of which others.

    Parameters
    ----------
    state : PartsState
        Of the frame before.
    labels : (H, W) uint16
        Layer of every pixel, 0 = background.
    frame_index : int
    live : collection of int
        Layers of one object each that are awake.
    remembered : int
        Frames for which a layer can sleep and wake again.
    apart : collection of (int, int)
        Pairs of layers, the lower one first, that are two things.

    Returns
    -------
    PartsState
    """
    step = max(1, round(min(labels.shape) / _ROWS))
    coarse = np.ascontiguousarray(labels[::step, ::step])
    areas = _areas(coarse)
    columns = (state.layers, state.appeared, state.part_of, state.apart, state.usual, state.live)
    rows = zip(*(one.tolist() for one in columns), strict=True)
    layers = {layer: _Layer(*row) for layer, *row in rows}
    layers = {
        layer: one for layer, one in layers.items() if layer in live or frame_index - one.live <= remembered
    }
    present = [layer for layer in np.flatnonzero(areas).tolist() if layer in live]
    new = {layer: _Layer(frame_index) for layer in present if layer not in layers}
    layers |= new
    for layer in layers.keys() & live:
        layers[layer].live = frame_index
    for layer in present:
        own = layers[layer]
        if own.part_of and _pair(layer, _oldest(own.part_of, layers, present)) in apart:
            for other, one in layers.items():  # its usual area was that of both
                if own.part_of in (other, one.part_of):
                    one.usual = 0.0
            own.part_of = 0
        if own.part_of:
            contact = sum(
                share
                for other, share in _contacts(coarse, layer, present).items()
                if own.part_of in (other, layers[other].part_of)
            )
            attached = contact >= _LEAST_CONTACT or _is_the_rest(layer, layers, areas, present)
            own.apart = 0 if attached else own.apart + 1
            if own.apart > _MOST_APART:
                own.part_of = 0
        elif frame_index - own.appeared <= _FIRST_FRAMES:
            contacts: dict[int, float] = {}
            for other, share in _contacts(coarse, layer, present).items():
                whole = layers[other].part_of or other
                older = (layers[other].appeared, -areas[other]) < (own.appeared, -areas[layer])
                two = _pair(layer, other) in apart or _pair(layer, whole) in apart
                if older and not two and whole != layer and areas[layer] <= _LARGEST_PART * areas[other]:
                    contacts[whole] = contacts.get(whole, 0.0) + share
            best = max(contacts, key=lambda one: contacts[one], default=0)
            if best and contacts[best] >= (_LEAST_CONTACT if layer in new else _WIDE_CONTACT):
                own.part_of, own.apart = best, 0
                for one in layers.values():
                    if one.part_of == layer:
                        one.part_of = best
    _update_usual_areas(layers, areas, present)
    ordered = sorted(layers.items())
    return PartsState(
        np.array([layer for layer, _ in ordered], np.int64),
        np.array([one.appeared for _, one in ordered], np.int64),
        np.array([one.part_of for _, one in ordered], np.int64),
        np.array([one.apart for _, one in ordered], np.int64),
        np.array([one.usual for _, one in ordered]),
        np.array([one.live for _, one in ordered], np.int64),
    )


def _areas(labels: Array) -> Array:
    """Count the pixels of each layer up to the last one in a map, (k,) int64."""
    count = int(labels.max()) + 1
    histogram = cv2.calcHist([labels], [0], None, [count], [0, count])
    return histogram.reshape(-1).astype(np.int64)


def _pair(one: int, other: int) -> tuple[int, int]:
    return min(one, other), max(one, other)


def _oldest(whole: int, layers: Mapping[int, _Layer], present: Collection[int]) -> int:
    """Return the layer of an object that is there, or of its parts the one that appeared first."""
    if whole in present:
        return whole
    parts = [one for one in present if layers[one].part_of == whole]
    return min(parts, key=lambda one: (layers[one].appeared, one))


def _is_the_rest(part: int, layers: Mapping[int, _Layer], areas: Array, present: Collection[int]) -> bool:
    """Whether a part is most of an object whose own layer has vanished."""
    whole = layers[part].part_of
    largest = max(
        (one for one in present if layers[one].part_of == whole), key=lambda one: (areas[one], -one)
    )
    return whole not in present and largest == part and areas[part] >= _MOST_OF_IT * layers[part].usual


def _update_usual_areas(layers: Mapping[int, _Layer], areas: Array, present: Collection[int]) -> None:
    """Take the present areas into account, but not of parts that are about to be objects of their own."""
    totals: dict[int, int] = {}
    for layer in present:
        whole = layers[layer].part_of or layer
        totals[whole] = totals.get(whole, 0) + int(areas[layer])
    for layer in present:
        own = layers[layer]
        if own.apart == 0:
            total = totals[own.part_of or layer]
            own.usual += (_AREA_WEIGHT if own.usual else 1.0) * (total - own.usual)


def _contacts(coarse: Array, layer: int, present: Collection[int]) -> dict[int, float]:
    """Return the share of a layer's outline that is as near as ``_REACH`` to each other layer near it."""
    x, y, width, height = cv2.boundingRect((coarse == layer).astype(np.uint8))
    top, left = max(y - _REACH - 1, 0), max(x - _REACH - 1, 0)
    window = coarse[top : y + height + _REACH + 1, left : x + width + _REACH + 1]
    own = (window == layer).astype(np.uint8)
    outline = cv2.dilate(own, np.ones((3, 3), np.uint8)) > own
    near = np.ones((2 * _REACH + 1, 2 * _REACH + 1), np.uint8)
    shares = {}
    for other in np.unique(window).tolist():
        if other != layer and other in present:
            beside = cv2.dilate((window == other).astype(np.uint8), near) > 0
            share = float((outline & beside).sum()) / max(int(outline.sum()), 1)
            if share > 0:
                shares[other] = share
    return shares


def join_parts(segmentation: Segmentation) -> Segmentation:
    """Give the parts of an object its id: what is published.

    Parameters
    ----------
    segmentation : Segmentation
        Of layers.

    Returns
    -------
    Segmentation
        Of objects. Box and area are those of all parts together, other values the mean of their pixels. An
        object rests if all its parts do.
    """
    layers = segmentation.layers
    if not any(one.part_of for one in layers):
        return segmentation
    renamed = np.arange(max(one.layer for one in layers) + 1, dtype=segmentation.labels.dtype)
    members: dict[int, list[LayerSummary]] = {}
    for one in layers:
        renamed[one.layer] = one.object
        members.setdefault(one.object, []).append(one)
    labels = renamed[segmentation.labels]
    labels.setflags(write=False)
    joined = tuple(_joined(whole, parts) for whole, parts in sorted(members.items()))
    return replace(segmentation, labels=labels, layers=joined)


def _joined(whole: int, parts: list[LayerSummary]) -> LayerSummary:
    area = sum(one.area for one in parts)
    left = min(one.region.x for one in parts)
    top = min(one.region.y for one in parts)
    right = max(one.region.x + one.region.width for one in parts)
    bottom = max(one.region.y + one.region.height for one in parts)

    def mean(values: list[float]) -> float:
        return sum(one.area * value for one, value in zip(parts, values, strict=True)) / area

    return LayerSummary(
        layer=whole,
        kind=parts[0].kind,
        region=Region(left, top, right - left, bottom - top),
        area=area,
        centroid=(mean([one.centroid[0] for one in parts]), mean([one.centroid[1] for one in parts])),
        velocity=(mean([one.velocity[0] for one in parts]), mean([one.velocity[1] for one in parts])),
        confidence=mean([one.confidence for one in parts]),
        state="resting" if all(one.state == "resting" for one in parts) else "moving",
        score=mean([one.score for one in parts]),
    )
