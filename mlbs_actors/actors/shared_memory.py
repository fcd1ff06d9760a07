"""Frames and maps in memory that a stream's processes share; what goes through Ray is only where they are.

Through Ray's object store every frame and map would cost several messages between each process and the node's
daemon: with four layers, more than the calls themselves. Here a message is copied once into a *slot*, and
whoever is told of it reads it where it is.

The coordinator owns all slots of its stream. With each note it lends the slot for the answer, and it takes
a slot back when nobody can read it any more. The memory is anonymous (``memfd_create``) and found through
its owner's ``/proc`` entry: it is gone with the last process that holds it, however that ends, and what a
process has written outlives that process.
"""

from __future__ import annotations

import copyreg
import io
import mmap
import os
import pickle
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Generic, Literal, TypeVar

import numpy as np

from mlbs_actors.errors import ActorLostError, LayerError
from mlbs_actors.messages import Array
from mlbs_actors.pickling import pickled_by_values

__all__ = ["Shared", "SharedMemory", "Slot", "SlotKind", "SlotPool"]

Message = TypeVar("Message")

#: What a slot is for; messages of a kind are about as large as each other.
SlotKind = Literal["frame", "evidence", "posterior", "segmentation", "appearance", "state"]

#: Arrays begin at multiples of this, bytes: what vector instructions like.
_ALIGNMENT = 64
#: Least memory of a slot, bytes; it grows by doubling.
_LEAST_BYTES = 1 << 16
#: At the begin of a slot: the turn in which its message was written.
_HEADER = struct.Struct("<Q")


@pickled_by_values
@dataclass(frozen=True, slots=True)
class Slot:
    """Memory that is lent for one message.

    Attributes
    ----------
    kind : SlotKind
    owner : int
        Process id of its owner.
    descriptor : int
        The owner's file descriptor of the memory.
    turn : int
        How often it has been lent.
    """

    kind: SlotKind
    owner: int
    descriptor: int
    turn: int


@pickled_by_values
@dataclass(frozen=True, slots=True)
class Shared(Generic[Message]):
    """Where a message is.

    Attributes
    ----------
    slot : Slot
    lengths : tuple of int
        Bytes of its description and of each of its arrays.
    """

    slot: Slot
    lengths: tuple[int, ...]


class SlotPool:
    """The slots of one stream, in the process that lends them.

    Those that came back last are lent first: their memory is in the processor's caches.
    """

    def __init__(self) -> None:
        self._free: dict[SlotKind, list[Slot]] = {}

    def take(self, kind: SlotKind) -> Slot:
        """Lend a slot."""
        free = self._free.setdefault(kind, [])
        if free:
            last = free.pop()
            return Slot(kind, last.owner, last.descriptor, last.turn + 1)
        return Slot(kind, os.getpid(), os.memfd_create(f"mlbs-{kind}"), 1)

    def give_back(self, slots: Sequence[Slot]) -> None:
        """Take slots back whose messages nobody reads any more."""
        for slot in slots:
            self._free[slot.kind].append(slot)


class SharedMemory:
    """A process's own view of the slots of one stream."""

    def __init__(self) -> None:
        self._maps: dict[tuple[int, int], mmap.mmap] = {}
        self._reductions = {**copyreg.dispatch_table, np.ndarray: _reduced_array}

    def share(self, message: Message, slot: Slot) -> Shared[Message]:
        """Copy a message into a slot.

        Parameters
        ----------
        message : object
            Picklable; its contiguous arrays are copied as they are.
        slot : Slot
            Lent for this message.

        Returns
        -------
        Shared
            To be told to those who are to read it.

        Raises
        ------
        ActorLostError
            If the slot's owner is gone.
        """
        arrays: list[pickle.PickleBuffer] = []
        description = io.BytesIO()
        pickler = pickle.Pickler(description, protocol=5, buffer_callback=arrays.append)
        pickler.dispatch_table = self._reductions
        pickler.dump(message)
        pieces = [description.getbuffer(), *(array.raw() for array in arrays)]
        lengths = tuple(piece.nbytes for piece in pieces)
        ends = _ends(lengths)
        memory = memoryview(self._mapped(slot, ends[-1], grow=True))
        for piece, end in zip(pieces, ends, strict=True):
            memory[end - piece.nbytes : end] = piece
        _HEADER.pack_into(memory, 0, slot.turn)
        return Shared(slot, lengths)

    def taken(self, shared: Shared[Message]) -> Message:
        """Read a message; its arrays are read-only views, valid until the slot's owner takes it back.

        Raises
        ------
        ActorLostError
            If the slot's owner is gone.
        LayerError
            If the slot has been lent to another message since.
        """
        ends = _ends(shared.lengths)
        memory = memoryview(self._mapped(shared.slot, ends[-1], grow=False)).toreadonly()
        if _HEADER.unpack_from(memory)[0] != shared.slot.turn:
            raise LayerError(
                "A message was read after its memory had been lent again; start the stream again."
            )
        pieces = [memory[end - length : end] for length, end in zip(shared.lengths, ends, strict=True)]
        message: Message = pickle.loads(pieces[0], buffers=pieces[1:])
        return message

    def _mapped(self, slot: Slot, size: int, *, grow: bool) -> mmap.mmap:
        key = (slot.owner, slot.descriptor)
        known = self._maps.get(key)
        if known is not None and len(known) >= size:
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
            self._maps[key] = mmap.mmap(descriptor, 0)
        finally:
            os.close(descriptor)
        return self._maps[key]


def _reduced_array(array: Array) -> Any:
    """How an array is pickled: NumPy's own way runs through Python functions for each array that is read."""
    if array.flags.c_contiguous and array.dtype.isbuiltin == 1 and not array.dtype.hasobject:
        return np.ndarray, (array.shape, array.dtype.str, pickle.PickleBuffer(array.data))
    return array.__reduce_ex__(5)


def _ends(lengths: Sequence[int]) -> list[int]:
    """Where the pieces of a message end in a slot; each begins at a multiple of the alignment."""
    ends, place = [], _HEADER.size
    for length in lengths:
        place = -(-place // _ALIGNMENT) * _ALIGNMENT + length
        ends.append(place)
    return ends
