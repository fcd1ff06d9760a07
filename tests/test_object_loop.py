"""An object's frames from note to note, against the same through Python."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from multiprocessing import Pipe
from pathlib import Path
from threading import Timer

import numpy as np
import pytest
from layer_fakes import CAR, SHAPE, WHOLE, frame_of, grid, owned, picture, published, tracks

from mlbs_actors.actors.channels import Channel, ChannelClosedError, framed
from mlbs_actors.actors.layer import LayerWork
from mlbs_actors.actors.layer_notes import (
    FrameNotes,
    SharedFrame,
    read_posterior,
    read_step,
)
from mlbs_actors.actors.object_loop import ObjectLoop
from mlbs_actors.actors.saved_states import SavedLayer, SaveState
from mlbs_actors.actors.shared_memory import SharedMemory, Slot, SlotKind, SlotPool
from mlbs_actors.actors.stream_protocol import SourceFrame
from mlbs_actors.config import Config
from mlbs_actors.errors import LayerError, SolverError
from mlbs_actors.layer import Layer
from mlbs_actors.layer_state import LayerState
from mlbs_actors.messages import BACKGROUND, FrameEvidence, LayerPosterior, Region, Segmentation

#: Two pixels of the small frames are a cell, as of their flow; every term tells.
CONFIG = Config.model_validate(
    {
        "appearance": {"cell_px": 8.0},
        "flow": {"scale": 0.125},
        "posterior": {"motion": 1.0, "photometric": 1.0, "prior": 1.0, "distance": 2.0},
    }
)
OBJECT = 7
FRAMES = 6


def place_at(frame_index: int) -> Region:
    return replace(CAR, x=CAR.x + 3 * frame_index, y=CAR.y - 2 * frame_index)


def evidence_of(frame_index: int) -> FrameEvidence:
    rng, half = np.random.default_rng(frame_index), (SHAPE[0] // 2, SHAPE[1] // 2)
    own = tracks(OBJECT, grid(place_at(frame_index)), frame_index - 1, (-3.0, 2.0))
    own = replace(own, motions=own.motions + rng.normal(0, 0.3, own.motions.shape).astype(np.float32))
    far = tracks(BACKGROUND, grid(WHOLE, 13), frame_index - 1)
    return replace(
        frame_of([far, own], frame_index, (-3.0, 2.0), reliable=True),
        camera=np.array([[1.02, 0.01, -2.0], [-0.02, 0.98, 1.5], [1e-5, -2e-5, 1.0]]),
        unexplained=rng.integers(0, 256, half).astype(np.uint8),
    )


def segmentation_of(frame_index: int) -> Segmentation:
    rng, half = np.random.default_rng(100 + frame_index), (SHAPE[0] // 2, SHAPE[1] // 2)
    shown = published(frame_index, OBJECT * owned(place_at(frame_index)), velocity=(3.0, -2.0))
    return replace(
        shown,
        normaliser=rng.integers(0, 256, half).astype(np.uint8),
        fallback=rng.integers(-128, 128, half).astype(np.int8),
    )


@dataclass(frozen=True)
class Told:
    """A frame's note, and the slot for its answer."""

    note: bytes
    answer: Slot


class Stream:
    """The other end of a layer's channel, and the memory of all frames."""

    def __init__(self) -> None:
        self.slots, self.memory = SlotPool(), SharedMemory()
        self.lent: list[Slot] = []
        (incoming, other_outgoing), (other_incoming, outgoing) = Pipe(duplex=False), Pipe(duplex=False)
        self.own_end = Channel(incoming, outgoing)
        self.layers_end = Channel(other_incoming, other_outgoing)

    def told(self, evidence: FrameEvidence, *, appearance: bool = False, shown: bool = True) -> Told:
        """A frame that the layer is to do."""
        index = evidence.frame_index
        frame = SourceFrame(index, picture(index), 0.1, str(index))
        assert frame.image is not None
        previous = segmentation_of(index - 1) if index else None
        if previous is not None and not shown:
            previous = replace(previous, layers=())
        where = (
            self.memory.share(evidence, self._take("evidence")),
            self.memory.share(frame, self._take("frame")),
            None if previous is None else self.memory.share(previous, self._take("segmentation")),
        )
        answer, wanted = self._take("posterior"), self._take("appearance") if appearance else None
        notes = FrameNotes(SharedFrame(evidence, frame.image, previous, *where))
        return Told(notes.to(OBJECT, answer, wanted), answer)

    def _take(self, kind: SlotKind) -> Slot:
        self.lent.append(self.slots.take(kind))
        return self.lent[-1]

    def answered(self, told: Told) -> LayerPosterior:
        """The answer that comes to the own end."""
        return read_posterior(self.own_end.receive(), self.memory, told.answer)


class Place:
    """Where the layer works: it has read and written the slots of some frames before."""

    def __init__(self, known: Sequence[Told], config: Config = CONFIG) -> None:
        self.memory, self.layer = SharedMemory(), Layer(config, OBJECT, "object")
        loop = ObjectLoop(self.layer, self.memory)
        self.work = LayerWork(SavedLayer(OBJECT, "object", -1), self.layer, self.memory, loop)
        for told in known:
            read_step(told.note, self.memory)
            self.memory.put((np.zeros(30_000, np.uint8),), told.answer)

    def step(self, note: bytes) -> LayerPosterior:
        """Do a frame through Python."""
        step = read_step(note, self.memory)
        return self.work.step(step.evidence, step.image, step.previous)


@pytest.fixture
def stream() -> Iterator[Stream]:
    made = Stream()
    with made.own_end, made.layers_end:
        yield made


def frames(stream: Stream) -> list[Told]:
    return [stream.told(evidence_of(index)) for index in range(FRAMES)]


def values(message: LayerPosterior | LayerState) -> dict[str, object]:
    return {
        one.name: getattr(message, one.name)
        for one in fields(message)
        if one.name not in ("stage_ms", "model")
    }


def assert_same(one: LayerPosterior | LayerState, other: LayerPosterior | LayerState) -> None:
    for name, value in values(one).items():
        np.testing.assert_array_equal(value, values(other)[name], name)


def test_frames_are_done_as_through_python(stream: Stream) -> None:
    notes = frames(stream)
    slow = Place(notes)
    expected = [slow.step(told.note) for told in notes]
    assert all(one.cost.size and one.samples.any() for one in expected[2:])  # it says something

    fast = Place(notes)
    fast.step(notes[0].note)
    for told in notes[1:]:
        stream.own_end.send(told.note)
    stream.own_end.send(SaveState(Path("snapshot")))
    fast.work.go_on(stream.layers_end)
    assert stream.layers_end.receive() == SaveState(Path("snapshot"))  # all that is left to Python
    for told, posterior in zip(notes[1:], expected[1:], strict=True):
        answer = stream.answered(told)
        assert_same(answer, posterior)
        assert list(answer.stage_ms) == list(posterior.stage_ms)
        assert 0 < answer.stage_ms["posterior"] < 1e4
    assert_same(fast.layer.state, slow.layer.state)
    assert fast.layer.state.model.region == slow.layer.state.model.region
    for one, other in zip(fast.layer.state.model.arrays, slow.layer.state.model.arrays, strict=True):
        np.testing.assert_array_equal(one, other)
    following = stream.told(evidence_of(FRAMES)).note
    assert_same(fast.step(following), slow.step(following))


def test_an_object_that_is_not_seen_any_more_is_done_as_through_python(stream: Stream) -> None:
    gone = replace(evidence_of(1), positions=evidence_of(1).positions[:0], motions=evidence_of(1).motions[:0])
    tracks = tuple(one._replace(start=0, end=0) for one in gone.tracks)
    unseen = stream.told(replace(gone, tracks=tracks), shown=False)
    notes = [stream.told(evidence_of(0)), unseen]
    slow, fast = Place(notes), Place(notes)
    for told in notes:
        expected = slow.step(told.note)
    fast.step(notes[0].note)
    stream.own_end.send(notes[1].note)
    stream.own_end.send(None)
    fast.work.go_on(stream.layers_end)
    assert_same(stream.answered(notes[1]), expected)


@pytest.mark.parametrize(
    "kind",
    ["appearance", "frame after next", "new epoch", "unknown memory", "no frame yet", "coarser evidence"],
)
def test_what_is_not_a_plain_next_frame_is_left_to_python(stream: Stream, kind: str) -> None:
    notes = frames(stream)[:2]
    following = notes[1].note
    if kind == "appearance":
        following = stream.told(evidence_of(1), appearance=True).note
    elif kind == "frame after next":
        following = stream.told(evidence_of(2)).note
    elif kind == "new epoch":
        following = stream.told(replace(evidence_of(1), epoch=1)).note
    elif kind == "coarser evidence":
        notes[1] = stream.told(replace(evidence_of(1), unexplained=np.zeros((30, 40), np.uint8)))
        following = notes[1].note
    place = Place(notes if kind != "unknown memory" else [])
    if kind != "no frame yet":
        place.step(notes[0].note)
    state = place.layer.state
    stream.own_end.send(following)
    place.work.go_on(stream.layers_end)
    assert stream.layers_end.receive() == following
    assert place.layer.state.last_frame == state.last_frame
    assert not stream.own_end.has_note()
    if kind == "frame after next":
        with pytest.raises(LayerError, match="follows frame 1 but frame 0 was last"):
            place.step(following)
    elif kind != "no frame yet":
        place.step(following)


def test_where_flow_is_not_told_for_each_cell_no_note_is_taken(stream: Stream) -> None:
    notes = frames(stream)[:2]
    place = Place(notes, CONFIG.model_copy(update={"appearance": Config().appearance}))
    place.step(notes[0].note)
    assert place.layer.state.cell == 1
    stream.own_end.send(notes[1].note)
    place.work.go_on(stream.layers_end)  # else it would wait for another one
    assert not stream.own_end.has_note()


@pytest.mark.parametrize("first", [2, 100])
def test_a_note_may_come_in_pieces(stream: Stream, first: int) -> None:
    notes = frames(stream)[:2]
    slow, fast = Place(notes), Place(notes)
    for told in notes:
        expected = slow.step(told.note)
    fast.step(notes[0].note)
    whole, (_, outgoing) = framed(notes[1].note), stream.own_end.ends
    os.write(outgoing, whole[:first])
    later = Timer(0.2, os.write, (outgoing, whole[first:] + framed(None)))
    later.start()
    fast.work.go_on(stream.layers_end)
    later.join()
    assert_same(stream.answered(notes[1]), expected)


def test_memory_that_was_lent_again_is_left_to_python(stream: Stream) -> None:
    notes = frames(stream)[:2]
    place = Place(notes)
    place.step(notes[0].note)
    (evidence, *_) = [one for one in stream.lent if one.kind == "evidence"][1:]
    stream.memory.put((np.zeros(8),), replace(evidence, turn=evidence.turn + 100))
    stream.own_end.send(notes[1].note)
    place.work.go_on(stream.layers_end)
    with pytest.raises(LayerError, match="lent again"):
        place.step(stream.layers_end.receive())


def test_a_layer_that_moves_is_told_which_slots_its_process_has_met(stream: Stream) -> None:
    notes = frames(stream)
    place = Place(notes)
    place.step(notes[0].note)
    moving = place.work.hand_over(SlotPool().take("state"))
    told = {(one.kind, one.descriptor) for one in moving.slots}
    kinds = ("frame", "evidence", "segmentation")
    assert told == {(one.kind, one.descriptor) for one in stream.lent if one.kind in kinds}


@pytest.mark.parametrize("room", ["too small", "unknown"])
def test_an_answer_without_room_is_given_all_the_same(stream: Stream, room: str) -> None:
    notes = frames(stream)[:3]
    slow, fast = Place(notes), Place([])
    expected = [slow.step(told.note) for told in notes]
    for told in notes:
        read_step(told.note, fast.memory)
        if room == "too small":
            os.ftruncate(told.answer.descriptor, 512)
            fast.memory.put((np.zeros(8),), told.answer)
    fast.step(notes[0].note)
    stream.own_end.send(notes[1].note)
    stream.own_end.send(notes[2].note)
    fast.work.go_on(stream.layers_end)
    assert_same(stream.answered(notes[1]), expected[1])
    fast.work.go_on(stream.layers_end)
    assert_same(stream.answered(notes[2]), expected[2])


def test_a_field_that_cannot_be_solved_ends_the_layer(stream: Stream) -> None:
    notes = frames(stream)[:1]
    broken = replace(evidence_of(1), motions=np.full_like(evidence_of(1).motions, np.nan))
    notes += [stream.told(broken), stream.told(evidence_of(2))]
    place = Place(notes)
    place.step(notes[0].note)
    stream.own_end.send(notes[1].note)
    with pytest.raises(SolverError, match="finite"):
        place.work.go_on(stream.layers_end)
    assert not stream.own_end.has_note()
    with pytest.raises(LayerError, match="a frame that failed was last"):
        place.step(notes[2].note)


def test_a_channel_that_is_closed_is_told_of_by_python(stream: Stream) -> None:
    notes = frames(stream)[:1]
    place = Place(notes)
    place.step(notes[0].note)
    stream.own_end.close()
    place.work.go_on(stream.layers_end)
    with pytest.raises(ChannelClosedError):
        stream.layers_end.receive()
