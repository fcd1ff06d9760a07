"""Frames and maps in memory that a stream's processes share; messages contain only references to them.

Through Ray's object store every frame and map would cost several messages between each process and the node's
daemon: with four layers, more than the calls themselves. Here a message is copied once into a *slot*, and
read there by all receivers.

A slot holds arrays and their layout. Those of a message are its pickled description and its own arrays in the
order of its fields, which may be read alone.

The coordinator owns all slots of its stream. With each request it acquires a slot for the answer, and it
releases the slot when nobody can read it any more. The memory is anonymous (``memfd_create``) and opened
through its owner's ``/proc`` entry: it is freed with the last process that maps it, however that ends, and
data outlive the process that wrote them.
"""

from __future__ import annotations

import copyreg
import io
import mmap
import os
import pickle
import struct
import weakref
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import count
from typing import Any, Generic, Literal, TypeVar

import numpy as np

from mlbs_actors.errors import ActorLostError, LayerError
from mlbs_actors.messages import Array
from mlbs_actors.pickling import pickled_by_values

__all__ = ["Shared", "SharedMemory", "Slot", "SlotKind", "SlotPool"]

Message = TypeVar("Message")

#: Prefix of the name of a slot's memory; its kind follows.
_NAME = "mlbs-"

#: Purpose of a slot; messages of a kind have similar sizes.
SlotKind = Literal["frame", "evidence", "posterior", "segmentation", "appearance", "state"]

#: Alignment of arrays, bytes, for vector instructions.
_ALIGNMENT = 64
#: Least memory of a slot, bytes; it grows by doubling.
_LEAST_BYTES = 1 << 16
#: A generation that no message has.
_NO_GENERATION = 0
#: At the start of a slot: the generation that was written, and the number of arrays.
_HEADER = struct.Struct("<2q")
#: Then for each array: its offset, the character of its type, its number of dimensions, and its shape.
_PLACE = struct.Struct("<6q")
_MOST_DIMENSIONS = 3
_TYPES = {ord(one): np.dtype(one) for one in "?bBhHiIlLqQefd"}

#: Numbers of the memories that this process owns.
_memories = count(1)


@pickled_by_values
@dataclass(frozen=True, slots=True)
class Slot:
    """Memory acquired for one message.

    Attributes
    ----------
    kind : SlotKind
    owner : int
        Process id of its owner.
    descriptor : int
        The owner's file descriptor of the memory.
    generation : int
        Number of slots that the owner had acquired by then, unique to the message.
    memory : int
        Number of the memory in its owner, where another one may get the descriptor later.
    """

    kind: SlotKind
    owner: int
    descriptor: int
    generation: int
    memory: int


@pickled_by_values
@dataclass(frozen=True, slots=True)
class Shared(Generic[Message]):
    """Reference to a message in a slot.

    Attributes
    ----------
    slot : Slot
    size : int
        Bytes used.
    """

    slot: Slot
    size: int


class SlotPool:
    """The slots of one stream, in the process that owns them.

    The slot released last is reused first: its memory is in the processor's caches. When the pool is dropped,
    its memory stays only where it is mapped.
    """

    def __init__(self) -> None:
        self._free: dict[SlotKind, list[Slot]] = {}
        self._generations = count(1)
        self._descriptors: list[int] = []
        weakref.finalize(self, _close_all, self._descriptors).atexit = False

    def acquire(self, kind: SlotKind) -> Slot:
        """Reuse a free slot, or create one."""
        free, generation = self._free.setdefault(kind, []), next(self._generations)
        if free:
            last = free.pop()
            return Slot(kind, last.owner, last.descriptor, generation, last.memory)
        descriptor = os.memfd_create(f"{_NAME}{kind}")
        self._descriptors.append(descriptor)
        return Slot(kind, os.getpid(), descriptor, generation, next(_memories))

    def release(self, slots: Sequence[Slot]) -> None:
        """Release the slots of a frame whose messages nobody reads any more.

        Slots acquired again in the same order serve the same purpose again, in the process that has already
        mapped them.
        """
        for slot in reversed(slots):
            self._free[slot.kind].append(slot)


def _close_all(descriptors: Sequence[int]) -> None:
    for descriptor in descriptors:
        os.close(descriptor)


class SharedMemory:
    """A process's mappings of the slots of one stream."""

    def __init__(self) -> None:
        # By owner and number: writable and read-only view.
        self._maps: dict[tuple[int, int], tuple[mmap.mmap, memoryview]] = {}
        self._reductions = {**copyreg.dispatch_table, np.ndarray: _reduced_array}

    def share(self, message: Message, slot: Slot) -> Shared[Message]:
        """Copy a message into a slot.

        Parameters
        ----------
        message : object
            Picklable; its arrays become C-contiguous.
        slot : Slot
            Acquired for this message.

        Returns
        -------
        Shared
            For the receivers.

        Raises
        ------
        ActorLostError
            If the slot's owner is gone.
        """
        buffers: list[pickle.PickleBuffer] = []
        description = io.BytesIO()
        pickler = pickle.Pickler(description, protocol=5, buffer_callback=buffers.append)
        pickler.dispatch_table = self._reductions
        pickler.dump(message)
        arrays = [_storable(buffer) for buffer in buffers]
        size = self.put([np.frombuffer(description.getbuffer(), np.uint8), *arrays], slot)
        return Shared(slot, size)

    def load(self, shared: Shared[Message]) -> Message:
        """Load a message; its arrays are read-only views, valid until the slot is released.

        Raises
        ------
        ActorLostError
            If the slot's owner is gone.
        LayerError
            If the slot has been reused since.
        """
        description, *arrays = self.read(shared.slot, shared.size)
        message: Message = pickle.loads(description.data, buffers=arrays)
        return message

    def put(self, arrays: Sequence[Array], slot: Slot) -> int:
        """Copy arrays of up to three dimensions into a slot; return their size in bytes, for :meth:`read`."""
        assert all(map(_is_storable, arrays))
        places, end = [], _HEADER.size + len(arrays) * _PLACE.size
        for array in arrays:
            begin = -(-end // _ALIGNMENT) * _ALIGNMENT
            places.append(begin)
            end = begin + array.nbytes
        memory = self._mapped(slot, end, grow=True)[0]
        _HEADER.pack_into(memory, 0, _NO_GENERATION, 0)  # invalidate first: late readers must fail
        row = _HEADER.size
        for array, begin in zip(arrays, places, strict=True):
            shape = (*array.shape, 0, 0, 0)[:_MOST_DIMENSIONS]
            _PLACE.pack_into(memory, row, begin, ord(array.dtype.char), array.ndim, *shape)
            np.ndarray(array.shape, array.dtype, memory, begin)[...] = array
            row += _PLACE.size
        _HEADER.pack_into(memory, 0, slot.generation, len(arrays))
        return end

    def read(self, slot: Slot, size: int) -> list[Array]:
        """Read arrays written by :meth:`put`; views, and errors, as of :meth:`load`."""
        whole, memory = self._mapped(slot, size, grow=False)
        generation, arrays = _HEADER.unpack_from(whole)
        if generation != slot.generation:
            raise LayerError("A message was read after its memory had been reused; start the stream again.")
        places = _PLACE.iter_unpack(memory[_HEADER.size : _HEADER.size + arrays * _PLACE.size])
        return [
            np.ndarray(shape[:dimensions], _TYPES[kind], memory, begin)
            for begin, kind, dimensions, *shape in places
        ]

    def _mapped(self, slot: Slot, size: int, *, grow: bool) -> tuple[mmap.mmap, memoryview]:
        """Return the writable and the read-only view of a slot's memory."""
        key = (slot.owner, slot.memory)
        known = self._maps.get(key)
        if known is not None and len(known[0]) >= size:
            return known
        try:
            descriptor = os.open(f"/proc/{slot.owner}/fd/{slot.descriptor}", os.O_RDWR | os.O_CLOEXEC)
        except OSError as error:
            raise ActorLostError(
                "A process of a stream cannot reach the memory that its coordinator shares: "
                f"{error.strerror}. If that happens again and again, run all of Ray as one user."
            ) from None
        try:
            if grow and os.fstat(descriptor).st_size < size:
                os.ftruncate(descriptor, max(_LEAST_BYTES, 1 << (size - 1).bit_length()))
            whole = mmap.mmap(descriptor, 0)
        finally:
            os.close(descriptor)
        self._maps[key] = whole, memoryview(whole).toreadonly()
        return self._maps[key]


def _reduced_array(array: Array) -> Any:
    """Reduce an array for pickling: one that fits into a slot goes there as it is."""
    if _is_storable(array):
        return np.asarray, (pickle.PickleBuffer(np.asarray(array, order="C").data),)
    return array.__reduce_ex__(5)


def _storable(buffer: pickle.PickleBuffer) -> Array:
    """Return a pickled buffer as a slot stores it: as bytes if it is no storable array."""
    array = np.asarray(buffer)
    return array if _is_storable(array) else np.asarray(buffer.raw())


def _is_storable(array: Array) -> bool:
    native = array.dtype.isnative and ord(array.dtype.char) in _TYPES
    return native and array.ndim <= _MOST_DIMENSIONS
