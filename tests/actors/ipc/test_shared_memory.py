"""Messages in memory that processes share: what is read is what was written, and a late reader is told so."""

from __future__ import annotations

import subprocess
import sys
import textwrap
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from mlbs_actors.actors.ipc.shared_memory import Shared, SharedMemory, Slot, SlotPool
from mlbs_actors.errors import ActorLostError, LayerError
from mlbs_actors.messages import Array, LayerEvidence
from mlbs_actors.source import SourceFrame
from mlbs_actors.state_file import capture


@dataclass(frozen=True, slots=True)
class State:
    turned: Array


def noise(height: int, width: int, seed: int = 0) -> Array:
    return np.random.default_rng(seed).integers(0, 256, (height, width, 3), dtype=np.uint8)


def test_a_message_is_read_as_it_was_written_and_its_arrays_are_read_only() -> None:
    slots, writer, reader = SlotPool(), SharedMemory(), SharedMemory()
    written = SourceFrame(7, noise(31, 17), 0.28, "img 7", original=noise(62, 34, 1))
    read = reader.load(writer.share(written, slots.acquire("frame")))
    assert (read.index, read.pts, read.name, read.status) == (7, 0.28, "img 7", "ok")
    for one, other in ((read.image, written.image), (read.original, written.original)):
        assert one is not None
        assert np.array_equal(one, np.asarray(other))
        assert one.ctypes.data % 64 == 0
        with pytest.raises(ValueError, match="read-only"):
            one[0, 0] = 0


def test_arrays_of_every_kind_come_back_with_type_and_shape_row_by_row() -> None:
    slots, memory = SlotPool(), SharedMemory()
    arrays = [
        np.zeros((0, 2), np.float32),
        np.array(3.5),
        np.arange(24, dtype=np.int16).reshape(1, 2, 3, 4),
        np.arange(4) + 1j,
        np.arange(4.0).astype(">f8"),
        np.ones((3, 4), np.bool_),
        np.arange(6, dtype=np.float16).reshape(1, 2, 3),
        np.asfortranarray(np.arange(12.0).reshape(3, 4)),
        np.arange(20, dtype=np.uint16)[::3],  # not contiguous
        np.array([None, "word"]),
    ]
    read = memory.load(memory.share(arrays, slots.acquire("evidence")))
    for one, other in zip(read, arrays, strict=True):
        assert one.dtype == other.dtype
        assert np.array_equal(one, other)
        if not other.dtype.hasobject:  # else it is no view of the memory
            assert one.flags.c_contiguous
            assert not one.flags.writeable


def test_a_state_is_the_same_in_another_process_in_whatever_order_its_arrays_are() -> None:
    slots, memory = SlotPool(), SharedMemory()
    state = State(np.asfortranarray(np.arange(12.0).reshape(3, 4)))
    read = memory.load(memory.share(capture(state), slots.acquire("state"))).state(State)
    assert np.array_equal(read.turned, state.turned)
    assert read.turned.flags.f_contiguous


def test_a_slot_grows_with_its_messages_and_what_was_read_before_stays() -> None:
    slots, writer, reader = SlotPool(), SharedMemory(), SharedMemory()
    small = reader.load(writer.share(noise(8, 8), first := slots.acquire("posterior")))
    kept = small.copy()
    slots.release([first])
    for side in (100, 400, 50):
        slot = slots.acquire("posterior")
        assert slot.descriptor == first.descriptor
        assert np.array_equal(reader.load(writer.share(noise(side, side), slot)), noise(side, side))
        slots.release([slot])
    assert small.shape == kept.shape  # the memory itself has been reused, but is still there


def test_the_slot_that_came_back_last_is_lent_first_and_kinds_do_not_mix() -> None:
    slots = SlotPool()
    one, two = slots.acquire("frame"), slots.acquire("frame")
    slots.release([one])
    slots.release([two])
    assert slots.acquire("evidence").descriptor not in (one.descriptor, two.descriptor)
    assert [slots.acquire("frame").descriptor, slots.acquire("frame").descriptor] == [
        two.descriptor,
        one.descriptor,
    ]


def test_slots_of_a_frame_are_lent_again_in_the_same_order() -> None:
    slots = SlotPool()
    first = [slots.acquire("posterior") for _ in range(4)]
    slots.release(first)
    again = [slots.acquire("posterior") for _ in range(4)]
    assert [one.descriptor for one in again] == [one.descriptor for one in first]


def test_no_two_messages_of_an_owner_have_the_same_generation() -> None:
    slots = SlotPool()
    taken = [slots.acquire("frame"), slots.acquire("frame"), slots.acquire("evidence")]
    slots.release(taken[:1])
    taken.append(slots.acquire("frame"))
    assert len({one.generation for one in taken}) == len(taken)
    assert min(one.generation for one in taken) > 0


def test_a_message_that_is_read_too_late_is_refused() -> None:
    slots, memory = SlotPool(), SharedMemory()
    early = memory.share(noise(4, 4), slots.acquire("frame"))
    slots.release([early.slot])
    memory.share(noise(4, 4, 1), slots.acquire("frame"))
    with pytest.raises(LayerError, match="reused"):
        memory.load(early)


def test_a_message_whose_owner_is_gone_is_a_lost_process() -> None:
    gone: Shared[SourceFrame] = Shared(
        Slot("frame", 2**22 + 1, 3, 1, 1), 10
    )  # beyond the greatest process id
    with pytest.raises(ActorLostError, match="cannot reach the memory"):
        SharedMemory().load(gone)


def test_what_a_process_wrote_is_read_in_others_and_outlives_it() -> None:
    slots, memory = SlotPool(), SharedMemory()
    slot = slots.acquire("segmentation")
    program = textwrap.dedent(
        f"""
        import numpy as np
        from mlbs_actors.actors.ipc.shared_memory import SharedMemory, Slot
        evidence = np.arange(100_000, dtype=np.int32)
        print(SharedMemory().share(evidence, {slot!r}).size)
        """
    )
    written = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    shared: Shared[Array] = Shared(slot, int(written.stdout))
    read = memory.load(shared)
    assert np.array_equal(read, np.arange(100_000))


def test_views_of_dropped_memory_stay_readable() -> None:
    slots, memory = SlotPool(), SharedMemory()
    own = LayerEvidence(3, "object", -1, np.ones((5, 2), np.float32), np.zeros((5, 2), np.float32))
    read = memory.load(memory.share(own, slots.acquire("evidence")))
    del memory
    assert read.positions.sum() == 10


def test_a_dropped_pool_leaves_its_memory_only_where_it_is_mapped() -> None:
    slots, memory = SlotPool(), SharedMemory()
    slot = slots.acquire("frame")
    shared = memory.share(np.arange(100_000), slot)
    del slots
    assert np.array_equal(memory.load(shared), np.arange(100_000))
    with pytest.raises(ActorLostError, match="cannot reach the memory"):
        SharedMemory().load(shared)


def test_the_memory_is_anonymous() -> None:
    slots = SlotPool()
    slot = slots.acquire("frame")
    assert str(Path(f"/proc/self/fd/{slot.descriptor}").readlink()).startswith("/memfd:mlbs-frame")
