"""What a stream's segmenter and the process of a layer write to each other for each frame.

A process with one layer wakes for a millisecond a frame, when the other processes have pushed all of its
memory out of the caches. To unpickle the frame's messages there, and to pickle the answer, would take a
third of that: not for what they hold, but for all that pickling runs through. So the layer is told in plain
numbers what concerns it, and reads the arrays alone, in the order of the messages' fields. No two fields of a
message may be the same array: a pickle would hold it once.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Any

from mlbs_actors.actors.shared_memory import Shared, SharedMemory, Slot
from mlbs_actors.actors.stream_protocol import SourceFrame
from mlbs_actors.messages import (
    BACKGROUND,
    Array,
    FrameEvidence,
    LayerKind,
    LayerPosterior,
    LayerSummary,
    LayerTracks,
    Region,
    Segmentation,
)

__all__ = [
    "ANSWER_AT",
    "APPEARANCE_AT",
    "EVIDENCE_AT",
    "IMAGE_AT",
    "POSTERIOR",
    "PREVIOUS_AT",
    "STEP",
    "SUMMARY",
    "TIME",
    "TRACKS",
    "FrameNotes",
    "LayerStep",
    "SharedFrame",
    "answer_slot",
    "blank_posterior",
    "kind_number",
    "read_posterior",
    "read_step",
    "write_posterior",
]

_KINDS: tuple[LayerKind, ...] = ("background", "object", "other")

#: Index and epoch of the frame, its shape, the index of the frame before, the number of tracks.
#: Owner, descriptor, turn and size of the evidence, the picture and the label map before.
#: Owner, descriptor and turn of the slots for posterior and appearance. -1 for none.
#: Tracks and summaries follow.
STEP = struct.Struct("<6q12q6q")
#: Which of these numbers are the first of evidence, picture, label map, and of the two slots.
EVIDENCE_AT, IMAGE_AT, PREVIOUS_AT, ANSWER_AT, APPEARANCE_AT = 6, 10, 14, 18, 21
#: Layer, kind, frame before, start, end.
TRACKS = struct.Struct("<5q")
#: Layer, kind, region, area; centroid, velocity, confidence.
SUMMARY = struct.Struct("<7q5d")
#: Layer, frame, kind, region, cell, outside cost, size of what is in the slot, number of stages; confidence.
#: The stages' times and names follow.
POSTERIOR = struct.Struct("<11qd")
TIME = struct.Struct("<d")

_NOWHERE = (-1, -1, -1, -1)


@dataclass(frozen=True, slots=True)
class SharedFrame:
    """A frame as its segmenter has it, and where its layers find it.

    Attributes
    ----------
    evidence : FrameEvidence
    image : (H, W, 3) uint8
    previous : Segmentation or None
        Published result of the frame before.
    where_evidence, where_image, where_previous : Shared
        The same; ``where_previous`` None if there is none.
    """

    evidence: FrameEvidence
    image: Array
    previous: Segmentation | None
    where_evidence: Shared[FrameEvidence]
    where_image: Shared[SourceFrame]
    where_previous: Shared[Segmentation] | None


@dataclass(frozen=True, slots=True)
class LayerStep:
    """A frame that a layer is to do.

    Attributes
    ----------
    evidence : FrameEvidence
        Without what layers do not ask for: ``retired``, ``latency_frames`` and ``stage_ms``. An object is
        told of its own tracks only.
    image : (H, W, 3) uint8
    previous : Segmentation, optional
        Of the frame before, without ``camera_motion``, ``latency_frames`` and ``stage_ms``. An object is told
        of its own summary only.
    answer : Slot
        For the posterior.
    appearance : Slot, optional
        For what the layer remembers after that; None if nobody wants it.
    """

    evidence: FrameEvidence
    image: Array
    previous: Segmentation | None
    answer: Slot
    appearance: Slot | None


class FrameNotes:
    """The notes that tell the layers of a frame."""

    def __init__(self, frame: SharedFrame) -> None:
        evidence, previous = frame.evidence, frame.previous
        before = -1 if previous is None else previous.frame_index
        self._frame = (evidence.frame_index, evidence.epoch, *evidence.shape, before)
        self._where = (
            *_place(frame.where_evidence),
            *_place(frame.where_image),
            *_place(frame.where_previous),
        )
        self._tracks = {
            one.layer: TRACKS.pack(one.layer, _KINDS.index(one.kind), *one[2:]) for one in evidence.tracks
        }
        summaries = () if previous is None else previous.layers
        self._summaries = {one.layer: _packed_summary(one) for one in summaries}

    def to(self, layer: int, answer: Slot, appearance: Slot | None = None) -> bytes:
        """Return the note to a layer of the evidence, for :func:`read_step`."""
        if layer == BACKGROUND:  # which is evaluated where the objects are
            tracks, summaries = [*self._tracks.values()], [*self._summaries.values()]
        else:
            tracks = [self._tracks[layer]]
            summaries = [self._summaries[layer]] if layer in self._summaries else []
        slots = (*_lent(answer), *_lent(appearance))
        head = STEP.pack(*self._frame, len(tracks), *self._where, *slots)
        return b"".join((head, *tracks, *summaries))


def read_step(note: bytes, memory: SharedMemory) -> LayerStep:
    """Read a note of :class:`FrameNotes`; raises as :meth:`SharedMemory.taken` does."""
    numbers = STEP.unpack_from(note)
    index, epoch, height, width, before, tracks = numbers[:EVIDENCE_AT]
    middle = STEP.size + tracks * TRACKS.size
    told = TRACKS.iter_unpack(note[STEP.size : middle])
    *where, size = numbers[EVIDENCE_AT:IMAGE_AT]
    arrays = memory.read(Slot("evidence", *where), size)
    camera, flow, reliable, unexplained, positions, motions = arrays[1:]
    evidence = FrameEvidence(
        frame_index=index,
        shape=(height, width),
        camera=camera,
        flow=flow,
        flow_reliable=reliable,
        unexplained=unexplained,
        tracks=tuple(LayerTracks(layer, _KINDS[kind], *rest) for layer, kind, *rest in told),
        positions=positions,
        motions=motions,
        retired=(),
        latency_frames=0,
        epoch=epoch,
    )
    *where, size = numbers[IMAGE_AT:PREVIOUS_AT]
    image = memory.read(Slot("frame", *where), size)[1]
    previous = None
    *where, size = numbers[PREVIOUS_AT:ANSWER_AT]
    if where[0] >= 0:
        labels, normaliser, fallback = memory.read(Slot("segmentation", *where), size)[1:]
        layers = tuple(map(_summary, SUMMARY.iter_unpack(note[middle:])))
        previous = Segmentation(before, labels, normaliser, fallback, layers, (0.0, 0.0), 0)
    lent = numbers[APPEARANCE_AT:]
    appearance = Slot("appearance", *lent) if lent[0] >= 0 else None
    answer = Slot("posterior", *numbers[ANSWER_AT:APPEARANCE_AT])
    return LayerStep(evidence, image, previous, answer, appearance)


def write_posterior(posterior: LayerPosterior, memory: SharedMemory, slot: Slot) -> bytes:
    """Put a posterior's arrays into a slot; return the note of it, for :func:`read_posterior`."""
    one, times = posterior, posterior.stage_ms
    size = memory.put((one.cost, one.log_ratio, one.samples, one.velocity), slot)
    kind, box = _KINDS.index(one.kind), _box(one.region)
    head = POSTERIOR.pack(
        one.layer, one.frame_index, kind, *box, one.cell, one.outside_cost, size, len(times), one.confidence
    )
    return b"".join((head, *map(TIME.pack, times.values()), "\n".join(times).encode()))


def blank_posterior(stage: str) -> bytes:
    """A note as :func:`write_posterior` returns it, of a posterior with one stage, without its numbers."""
    return bytes(POSTERIOR.size + TIME.size) + stage.encode()


def answer_slot(step: bytes) -> Slot:
    """The slot for the posterior that a note of :class:`FrameNotes` lends."""
    return Slot("posterior", *STEP.unpack_from(step)[ANSWER_AT:APPEARANCE_AT])


def kind_number(kind: LayerKind) -> int:
    """What a kind of layer is in a note."""
    return _KINDS.index(kind)


def read_posterior(note: bytes, memory: SharedMemory, slot: Slot) -> LayerPosterior:
    """Read the posterior that is in a slot; raises as :meth:`SharedMemory.taken` does."""
    layer, index, kind, x, y, width, height, cell, outside, size, stages, confidence = POSTERIOR.unpack_from(
        note
    )
    cost, log_ratio, samples, velocity = memory.read(slot, size)
    end = POSTERIOR.size + stages * TIME.size
    times = (time for (time,) in TIME.iter_unpack(note[POSTERIOR.size : end]))
    return LayerPosterior(
        layer=layer,
        frame_index=index,
        kind=_KINDS[kind],
        region=Region(x, y, width, height),
        cell=cell,
        cost=cost,
        log_ratio=log_ratio,
        samples=samples,
        outside_cost=outside,
        confidence=confidence,
        velocity=velocity,
        stage_ms=dict(zip(note[end:].decode().splitlines(), times, strict=True)),
    )


def _place(shared: Shared[Any] | None) -> tuple[int, int, int, int]:
    return _NOWHERE if shared is None else (*_lent(shared.slot), shared.size)


def _lent(slot: Slot | None) -> tuple[int, int, int]:
    return _NOWHERE[:3] if slot is None else (slot.owner, slot.descriptor, slot.turn)


def _box(region: Region) -> tuple[int, int, int, int]:
    return region.x, region.y, region.width, region.height


def _packed_summary(one: LayerSummary) -> bytes:
    kind = _KINDS.index(one.kind)
    return SUMMARY.pack(
        one.layer, kind, *_box(one.region), one.area, *one.centroid, *one.velocity, one.confidence
    )


def _summary(numbers: tuple[Any, ...]) -> LayerSummary:
    layer, kind, x, y, width, height, area, cx, cy, vx, vy, confidence = numbers
    return LayerSummary(
        layer, _KINDS[kind], Region(x, y, width, height), area, (cx, cy), (vx, vy), confidence
    )
