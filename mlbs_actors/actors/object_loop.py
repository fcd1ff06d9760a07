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
from numba.extending import intrinsic
from numba.np.arrayobj import populate_array

from mlbs_actors.actors.channels import Channel, framed
from mlbs_actors.actors.layer_notes import answer_slot, blank_posterior, kind_number, write_posterior
from mlbs_actors.actors.shared_memory import SharedMemory
from mlbs_actors.compilation import compiled
from mlbs_actors.gabp import check_solved
from mlbs_actors.layer import OUTSIDE_COST, Layer
from mlbs_actors.messages import Array
from mlbs_actors.object_frame import ObjectView, object_frame

__all__ = ["ObjectLoop"]

#: What the loop holds of the notes at once, bytes: many of them.
_ROOM = 1 << 13
#: Words of a note (``layer_notes``): what comes before the tracks, the layer's tracks, its summary.
_HEAD, _TRACKS, _SUMMARY = 24, 5, 12
#: Bytes before a note (``channels``).
_PREFIX = 5
#: Words before the places of a slot's arrays, and of a place (``shared_memory``).
_SLOT_HEAD, _PLACE = 2, 6
_WORD, _ALIGNMENT = 8, 64
_POSTERIOR_ARRAYS = 4

#: Why the loop ends: what comes next is not its own; the last frame could not be answered; or its motion
#: field could not be solved.
_LEFT, _UNANSWERED, _UNSOLVED = range(3)

_read: Any = types.ExternalFunction("read", types.intp(types.intc, types.voidptr, types.uintp))
_write: Any = types.ExternalFunction("write", types.intp(types.intc, types.voidptr, types.uintp))
_clock: Any = types.ExternalFunction("clock_gettime", types.intc(types.intc, types.voidptr))
_MONOTONIC = 1

_populate: Any = populate_array

#: Decorator of a function that only kernels can call, as in ``lanes``.
_in_kernels: Any = intrinsic(prefer_literal=True)


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
            As :meth:`~mlbs_actors.layer.Layer.step` does.
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
        )
        channel.unread = received[:count].tobytes()
        layer.state = view.state(frame, *kept)
        if ended == _UNSOLVED:
            check_solved(residual, view.tolerance)
        if ended == _UNANSWERED:
            posterior = layer.posterior(trust, {"posterior": milliseconds})
            channel.send(write_posterior(posterior, self._memory, answer_slot(channel.receive())))
        return int(frame)


@_in_kernels
def _memory_at(typing: Any, address: Any, size: Any, writable: Any) -> Any:
    """So many bytes from an address on, which somebody else holds."""
    array = types.Array(types.uint8, 1, "C", readonly=not writable.literal_value)

    def build(context: Any, builder: Any, called: Any, values: Any) -> Any:
        made = context.make_array(array)(context, builder)
        one = context.get_constant(types.intp, 1)
        data = builder.inttoptr(values[0], made.data.type)
        _populate(made, data=data, shape=[values[1]], strides=[one], itemsize=one, meminfo=None)
        return made._getvalue()

    return array(types.int64, types.int64, writable), build


@compiled(nogil=True)
def _frames(
    parameters: tuple[float, ...], numbers: tuple[Any, ...], tables: tuple[Array, ...],
    who: tuple[int, int, int, tuple[int, int], float], ends: tuple[int, int], received: Array, count: int,
    answer: Array, slots: Array, last_frame: int, kept: tuple[Any, ...],
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
        The object's state.

    Returns
    -------
    ended : int
    count, last_frame, kept
        As above; what is still in ``received`` is not answered.
    confidence, residual, milliseconds : float
        Of the last frame.
    """
    layer, side, kind, (height, width), tolerance = who
    words, clock = np.zeros(_HEAD + _TRACKS + _SUMMARY, np.int64), np.zeros(2, np.int64)
    figures = np.zeros(13, np.int64)
    rows, columns = -(-height // side), -(-width // side)
    trust, residual, milliseconds = 0.0, 0.0, 0.0
    while True:
        end = _end_of_note(received, count)
        while end == 0:
            got = _read(ends[0], received[count:].ctypes, received.size - count)
            if got <= 0:  # at its end, or interrupted by a signal, which Python handles
                return _LEFT, count, last_frame, kept, trust, residual, milliseconds
            count += got
            end = _end_of_note(received, count)
        _clock(_MONOTONIC, clock.ctypes)
        begun = 1e3 * clock[0] + 1e-6 * clock[1]
        if not _is_next(received, end, words, layer, last_frame, height, width):
            return _LEFT, count, last_frame, kept, trust, residual, milliseconds
        evidence = _written(slots, words[6], words[7], words[8], words[9])
        picture = _written(slots, words[10], words[11], words[12], words[13])
        published = _written(slots, words[14], words[15], words[16], words[17])
        if evidence == 0 or picture == 0 or published == 0:
            return _LEFT, count, last_frame, kept, trust, residual, milliseconds
        unexplained = _array(evidence, 4, 1).reshape(_shape(evidence, 4))
        if unexplained.shape != (rows, columns):  # which are brought to one another elsewhere
            return _LEFT, count, last_frame, kept, trust, residual, milliseconds
        grid = _shape(evidence, 2)
        region, model, last = kept
        region, model, last, trust, residual = object_frame(
            parameters,
            numbers,
            tables,
            (np.uint16(layer), side, words[_HEAD + 3], words[_HEAD + 4], True),
            (
                _array(picture, 1, 1).reshape((height, width, 3)),
                _array(evidence, 5, 4).view(np.float32).reshape((-1, 2)),
                _array(evidence, 6, 4).view(np.float32).reshape((-1, 2)),
                _array(evidence, 1, 8).view(np.float64).reshape((3, 3)),
                _array(evidence, 2, 2).view(np.uint16).reshape((grid[0], grid[1], 2)),
                _array(evidence, 3, 1).view(np.bool_).reshape(grid),
                unexplained,
                unexplained,
            ),
            (
                _array(published, 1, 2).view(np.uint16).reshape((height, width)),
                _array(published, 2, 1).reshape(_shape(published, 2)),
                _array(published, 3, 1).view(np.int8).reshape(_shape(published, 3)),
            ),
            _told(words, end),
            region,
            model,
            last,
        )
        last_frame, kept = words[0], (region, model, last)
        if not residual <= tolerance:
            return _UNSOLVED, count, last_frame, kept, trust, residual, milliseconds
        slot, size = _put(slots, words, last)
        _clock(_MONOTONIC, clock.ctypes)
        milliseconds = 1e3 * clock[0] + 1e-6 * clock[1] - begun
        if slot != 0:
            head = _memory_at(slot, _WORD * _SLOT_HEAD, True).view(np.int64)
            head[0], head[1] = words[20], _POSTERIOR_ARRAYS
        x, y, wide, high = region
        figures[:11] = (layer, last_frame, kind, x, y, wide, high, side, OUTSIDE_COST, size, 1)
        figures.view(np.float64)[11], figures.view(np.float64)[12] = trust, milliseconds
        answer[_PREFIX : _PREFIX + _WORD * figures.size] = figures.view(np.uint8)
        if slot == 0 or _write(ends[1], answer.ctypes, answer.size) != answer.size:
            return _UNANSWERED, count, last_frame, kept, trust, residual, milliseconds
        count -= end
        for at in range(count):
            received[at] = received[end + at]


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
    plain = _WORD * (_HEAD + _TRACKS)
    if received[_PREFIX - 1] or (length != plain and length != plain + _WORD * _SUMMARY):
        return False
    words.view(np.uint8)[:length] = received[_PREFIX:end]
    frame, epoch, before, appearance = words[0], words[1], words[4], words[21]
    follows = before == last_frame and words[_HEAD + 2] == last_frame and frame > epoch
    same = words[2] == height and words[3] == width and words[5] == 1 and words[_HEAD] == layer
    return bool(follows and same and appearance < 0)


@compiled()
def _told(words: Array, end: int) -> Array:
    """As :func:`~mlbs_actors.object_regions.told_of`."""
    told = np.zeros(7)
    at = _HEAD + _TRACKS
    if end > _PREFIX + _WORD * at:
        told[0] = words[at + 6]
        for one in range(4):
            told[1 + one] = words[at + 2 + one]
        told[5:] = words.view(np.float64)[at + 9 : at + 11]
    return told


@compiled()
def _written(slots: Array, owner: int, descriptor: int, turn: int, size: int) -> int:
    """Address of a slot in which is what the note tells of; 0 if that is not known, or it is not there."""
    for one in range(slots.shape[0]):
        if slots[one, 0] == owner and slots[one, 1] == descriptor and slots[one, 3] >= size:
            address = slots[one, 2]
            return address if _memory_at(address, _WORD, False).view(np.int64)[0] == turn else 0
    return 0


@compiled()
def _place(slot: int, number: int) -> Array:
    """Where an array of a slot is, the character of its type, its dimensions, its shape."""
    at = slot + _WORD * (_SLOT_HEAD + _PLACE * number)
    place: Array = _memory_at(at, _WORD * _PLACE, True).view(np.int64)
    return place


@compiled()
def _array(slot: int, number: int, item: int) -> Array:
    """The bytes of an array of a slot, whose items have so many."""
    place = _place(slot, number)
    for one in range(place[2]):
        item *= place[3 + one]
    content: Array = _memory_at(slot + place[0], item, False)
    return content


@compiled()
def _shape(slot: int, number: int) -> tuple[int, int]:
    """The first two dimensions of an array of a slot."""
    place = _place(slot, number)
    return place[3], place[4]


@compiled()
def _put(slots: Array, words: Array, last: tuple[Array, ...]) -> tuple[int, int]:
    """Write a posterior into the slot that a note lends; its address and the size, 0 if there is no room."""
    _, _, cost, log_ratio, samples, velocity = last
    cells, begin = cost.size, _aligned(_WORD * (_SLOT_HEAD + _POSTERIOR_ARRAYS * _PLACE))
    end = begin + 3 * _aligned(cells) + 4 * velocity.size
    for one in range(slots.shape[0]):
        if slots[one, 0] == words[18] and slots[one, 1] == words[19] and slots[one, 3] >= end:
            slot = slots[one, 2]
            room = _memory_at(slot, end, True)
            room[: _WORD * _SLOT_HEAD] = 0  # who reads too late is told so from now on
            maps = (cost.reshape(-1), log_ratio.view(np.uint8).reshape(-1), samples.reshape(-1))
            kinds = (ord("B"), ord("b"), ord("B"))
            for number in range(3):
                place = _place(slot, number)
                place[0], place[1], place[2] = begin, kinds[number], 2
                place[3], place[4], place[5] = cost.shape[0], cost.shape[1], 0
                room[begin : begin + cells] = maps[number]
                begin += _aligned(cells)
            place = _place(slot, 3)
            place[0], place[1], place[2] = begin, ord("f"), 1
            place[3], place[4], place[5] = velocity.size, 0, 0
            room[begin:end] = velocity.view(np.uint8)
            return slot, end
    return 0, 0


@compiled()
def _aligned(size: int) -> int:
    return -(-size // _ALIGNMENT) * _ALIGNMENT
