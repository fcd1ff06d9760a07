"""An object's frames from note to note in one compiled loop, in the process that the object has for itself.

Such a process wakes for a millisecond a frame, when the other processes have pushed all of its memory out of
the caches. Whatever runs there then comes from memory, line by line; and of all that Python runs through to
read a note, to find the arrays, to call a kernel and to answer, hardly anything is the frame's own. So once
the object has done a frame there, this loop takes the notes of :mod:`mlbs_actors.actors.layer_notes`. It
reads the pipe, finds the arrays in the slots (:mod:`mlbs_actors.actors.shared_memory`), does the frame as
:class:`~mlbs_actors.object_frame.ObjectView` does, and answers. What is not a plain next frame it leaves as
it came: that goes the way through Python, whose results are the same.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import types

from mlbs_actors.actors.channels import LENGTH, Channel, framed
from mlbs_actors.actors.kernel_slots import (
    WORD,
    after_places,
    array_bytes,
    array_shape,
    copy,
    find_slot,
    padded,
    put_array,
    sign,
    signature,
)
from mlbs_actors.actors.layer_notes import (
    ANSWER_AT,
    APPEARANCE_AT,
    EVIDENCE_AT,
    IMAGE_AT,
    POSTERIOR,
    PREVIOUS_AT,
    STEP,
    SUMMARY,
    TIME,
    TRACKS,
    answer_slot,
    blank_posterior,
    kind_number,
    write_posterior,
)
from mlbs_actors.actors.object_frame_call import address_of_frame, called_at
from mlbs_actors.actors.shared_memory import SharedMemory
from mlbs_actors.compilation import compiled
from mlbs_actors.flattened import flattened
from mlbs_actors.flow import flow_size
from mlbs_actors.gabp import check_solved
from mlbs_actors.layer import OUTSIDE_COST, Layer
from mlbs_actors.messages import Array
from mlbs_actors.object_frame import ObjectView

__all__ = ["ObjectLoop"]

#: What the loop holds of the notes at once, bytes: many of them.
_ROOM = 1 << 13
#: Words of a note: what comes before the tracks, a layer's tracks, a summary; and of a posterior's.
_HEAD, _TRACKS, _SUMMARY = STEP.size // WORD, TRACKS.size // WORD, SUMMARY.size // WORD
_FIGURES = (POSTERIOR.size + TIME.size) // WORD
#: Arrays of these messages, the first two's descriptions among them.
_EVIDENCE_ARRAYS, _PUBLISHED_ARRAYS, _POSTERIOR_ARRAYS = 7, 4, 4
#: Bytes before a note.
_PREFIX = LENGTH.size

#: Why the loop ends: what comes next is not its own; the last frame could not be answered; or its motion
#: field could not be solved.
_LEFT, _UNANSWERED, _UNSOLVED = range(3)

_read: Any = types.ExternalFunction("read", types.intp(types.intc, types.voidptr, types.uintp))
_write: Any = types.ExternalFunction("write", types.intp(types.intc, types.voidptr, types.uintp))
_clock: Any = types.ExternalFunction("clock_gettime", types.intc(types.intc, types.voidptr))
_MONOTONIC = 1


class ObjectLoop:
    """Does an object's frames, as long as they come one after the other and nothing else does.

    Parameters
    ----------
    layer : Layer
        An object.
    memory : SharedMemory
        Of the process.
    """

    def __init__(self, layer: Layer, memory: SharedMemory) -> None:
        self._layer = layer
        self._memory = memory

    @property
    def suits(self) -> bool:
        """Whether the flow of the last frame's size is told for each of the object's cells.

        So it is of 640×480 and of most other frames of 4:3. Else it is resized, which the loop cannot do.
        """
        view, flow = self._layer.view, self._layer.config.flow
        assert isinstance(view, ObjectView)
        return flow_size(view.shape, flow) == tuple(-(-length // view.side) for length in view.shape)

    def run(self, channel: Channel) -> int:
        """Take the notes that come, after a frame that was done in this process.

        Returns
        -------
        int
            The last frame that was done.

        Raises
        ------
        ChannelClosedError
            If an answer cannot be sent.
        SolverError
            As :func:`~mlbs_actors.gabp.check_solved` does.
        """
        layer, view = self._layer, self._layer.view
        assert isinstance(view, ObjectView)
        count = len(channel.unread)
        received = np.zeros(max(count, _ROOM), np.uint8)
        received[:count] = np.frombuffer(channel.unread, np.uint8)
        ended, count, frame, kept, trust, residual, milliseconds = _frames(
            *view.constants,
            (layer.layer, view.side, kind_number(layer.kind), view.shape, view.tolerance),
            channel.ends,
            received,
            count,
            np.frombuffer(framed(blank_posterior("posterior")), np.uint8).copy(),
            self._memory.places(),
            layer.state.last_frame,
            view.kept(layer.state),
            address_of_frame(),
        )
        channel.unread = received[:count].tobytes()
        layer.state = view.state(frame, *kept)
        if ended == _UNSOLVED:
            check_solved(residual, view.tolerance)
        if ended == _UNANSWERED:
            posterior = layer.posterior(trust, {"posterior": milliseconds})
            channel.send(write_posterior(posterior, self._memory, answer_slot(channel.receive())))
        return int(frame)


@compiled(nogil=True)
def _frames(
    parameters: tuple[float, ...], numbers: tuple[Any, ...], tables: tuple[Array, ...],
    who: tuple[int, int, int, tuple[int, int], float], ends: tuple[int, int], received: Array, count: int,
    answer: Array, slots: Array, last_frame: int, kept: tuple[Any, ...], frame_address: int,
) -> tuple[int, int, int, tuple[Any, ...], float, float, float]:  # fmt: skip
    """Read notes and answer them.

    Parameters
    ----------
    parameters, numbers, tables : tuple
        As for :func:`~mlbs_actors.object_frame.object_frame`.
    who : (layer, side, kind, (H, W), tolerance)
        The object's id, its cells' side, px, the number of its kind, size of its frames, px, and what is
        demanded of its motion field.
    ends : (int, int)
        File descriptors to read from and to write to.
    received : (n,) uint8
        Room for notes, of which ``count`` bytes have been read.
    answer : (m,) uint8
        A posterior's note without its numbers.
    slots : (k, 4) int64
        :meth:`~mlbs_actors.actors.shared_memory.SharedMemory.places`.
    last_frame, kept
        The object's state: its last frame, and :meth:`~mlbs_actors.object_frame.ObjectView.kept`.
    frame_address : int
        :func:`~mlbs_actors.actors.object_frame_call.address_of_frame`.

    Returns
    -------
    ended : int
        Why: ``_LEFT``, ``_UNANSWERED`` or ``_UNSOLVED``.
    count, last_frame, kept
        As above; what is still in ``received`` is not answered.
    confidence, residual, milliseconds : float
        Of the last frame.
    """
    layer, side, kind, (height, width), tolerance = who
    words, clock = np.zeros(_HEAD + _TRACKS + _SUMMARY, np.int64), np.zeros(2, np.int64)
    figures = np.zeros(_FIGURES, np.int64)
    rows, columns = -(-height // side), -(-width // side)
    ended, trust, residual, milliseconds = _LEFT, 0.0, 0.0, 0.0
    while True:
        count, end = _await_note(ends[0], received, count)
        _clock(_MONOTONIC, clock.ctypes)
        begun = 1e3 * clock[0] + 1e-6 * clock[1]
        if not _is_next(received, end, words, layer, last_frame, height, width):
            break
        evidence = _written(slots, words, EVIDENCE_AT, _EVIDENCE_ARRAYS)
        picture = _written(slots, words, IMAGE_AT, 0)
        published = _written(slots, words, PREVIOUS_AT, _PUBLISHED_ARRAYS)
        if evidence == 0 or picture == 0 or published == 0:
            break
        unexplained = array_bytes(evidence, 4, 1).reshape(array_shape(evidence, 4))
        if unexplained.shape != (rows, columns):
            break
        grid = array_shape(evidence, 2)
        region, model, last = kept
        given = (
            parameters,
            numbers,
            tables,
            (np.uint16(layer), side, words[_HEAD + 3], words[_HEAD + 4], np.bool_(1)),
            (
                array_bytes(picture, 1, 1).reshape((height, width, 3)),
                array_bytes(evidence, 5, 4).view(np.float32).reshape((-1, 2)),
                array_bytes(evidence, 6, 4).view(np.float32).reshape((-1, 2)),
                array_bytes(evidence, 1, 8).view(np.float64).reshape((3, 3)),
                array_bytes(evidence, 2, 2).view(np.uint16).reshape((grid[0], grid[1], 2)),
                array_bytes(evidence, 3, 1).view(np.bool_).reshape(grid),
                unexplained,
                unexplained,
            ),
            (
                array_bytes(published, 1, 2).view(np.uint16).reshape((height, width)),
                array_bytes(published, 2, 1).reshape(array_shape(published, 2)),
                array_bytes(published, 3, 1).view(np.int8).reshape(array_shape(published, 3)),
            ),
            _told(words, end),
            region,
            model,
            last,
        )
        region, model, last, trust, residual = called_at(frame_address, given)
        last_frame, kept = words[0], (region, model, last)
        if not residual <= tolerance:
            ended = _UNSOLVED
            break
        slot, size = _put(slots, words, last)
        _clock(_MONOTONIC, clock.ctypes)
        milliseconds = 1e3 * clock[0] + 1e-6 * clock[1] - begun
        if slot != 0:
            sign(slot, words[ANSWER_AT + 2], _POSTERIOR_ARRAYS)
        x, y, wide, high = region
        figures[0], figures[1], figures[2], figures[3], figures[4] = layer, last_frame, kind, x, y
        figures[5], figures[6], figures[7], figures[8], figures[9] = wide, high, side, OUTSIDE_COST, size
        figures[10] = 1  # stage
        figures.view(np.float64)[11], figures.view(np.float64)[12] = trust, milliseconds
        copy(figures.view(np.uint8), 0, WORD * figures.size, answer, _PREFIX)
        # A pipe takes so little whole or not at all.
        if slot == 0 or _write(ends[1], answer.ctypes, answer.size) != answer.size:
            ended = _UNANSWERED
            break
        count -= end
        copy(received, end, count, received, 0)
    return ended, count, last_frame, kept, trust, residual, milliseconds


@compiled()
def _await_note(incoming: int, received: Array, count: int) -> tuple[int, int]:
    """Read until the first note is there; how much there is, and where it ends: 0 if none comes."""
    end = _end_of_note(received, count)
    while end == 0:
        got = _read(incoming, received[count:].ctypes, received.size - count)
        if got <= 0:  # at its end, or interrupted by a signal: Python waits on
            break
        count += got
        end = _end_of_note(received, count)
    return count, end


@compiled()
def _end_of_note(received: Array, count: int) -> int:
    """Where the first note ends in what was received, 0 if not all of it is there."""
    if count < _PREFIX:
        return 0
    end = np.int64(_PREFIX)
    for one in range(4):
        end += np.int64(received[one]) << np.int64(8 * one)
    # One without room could not be waited for.
    return int(end) if end <= count or end > received.size else 0


@compiled()
def _is_next(
    received: Array, end: int, words: Array, layer: int, last_frame: int, height: int, width: int
) -> bool:
    """Read a note; whether it tells of the object's next frame, and asks for no more than the posterior."""
    length = end - _PREFIX
    plain = WORD * (_HEAD + _TRACKS)
    if received[_PREFIX - 1] or (length != plain and length != plain + WORD * _SUMMARY):
        return False
    copy(received, _PREFIX, length, words.view(np.uint8), 0)
    frame, epoch, before, appearance = words[0], words[1], words[4], words[APPEARANCE_AT]
    follows = before == last_frame and words[_HEAD + 2] == last_frame and frame > epoch
    same = words[2] == height and words[3] == width and words[5] == 1 and words[_HEAD] == layer
    return bool(follows and same and appearance < 0)


@compiled()
def _told(words: Array, end: int) -> Array:
    """As :func:`~mlbs_actors.object_regions.told_of`."""
    told = np.zeros(7)
    at = _HEAD + _TRACKS
    if end > _PREFIX + WORD * at:
        told[0] = words[at + 6]
        for one in range(4):
            told[1 + one] = words[at + 2 + one]
        told[5], told[6] = words.view(np.float64)[at + 9], words.view(np.float64)[at + 10]
    return told


@compiled()
def _written(slots: Array, words: Array, at: int, arrays: int) -> int:
    """Address of the slot that a note tells of from a word on; 0 if it is not known, or holds something else.

    It is to hold so many arrays; 0 for any number.
    """
    slot = find_slot(slots, words[at], words[at + 1], words[at + 3])
    if slot == 0:
        return 0
    turn, count = signature(slot)
    return slot if turn == words[at + 2] and (arrays == 0 or count == arrays) else 0


@compiled()
def _put(slots: Array, words: Array, last: tuple[Array, ...]) -> tuple[int, int]:
    """Write a posterior into the slot that a note lends; its address and the size, 0 if there is no room."""
    _, _, cost, log_ratio, samples, velocity = last
    begin = after_places(_POSTERIOR_ARRAYS)
    end = begin + 3 * padded(cost.size) + 4 * velocity.size
    slot = find_slot(slots, words[ANSWER_AT], words[ANSWER_AT + 1], end)
    if slot == 0:
        return 0, 0
    sign(slot, 0, 0)  # who reads too late is told so from now on
    maps = (flattened(cost), flattened(log_ratio.view(np.uint8)), flattened(samples))
    kinds, shape = (ord("B"), ord("b"), ord("B")), (cost.shape[0], cost.shape[1])
    for number in range(3):
        put_array(slot, number, begin, maps[number], kinds[number], 2, shape)
        begin += padded(cost.size)
    put_array(slot, 3, begin, velocity.view(np.uint8), ord("f"), 1, (velocity.size, 0))
    return slot, end
