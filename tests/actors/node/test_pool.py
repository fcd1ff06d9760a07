"""The pool of layer processes, and the processes that wait for a stream."""

from __future__ import annotations

import asyncio
import os
import signal
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from actor_fakes import (
    CONFIG,
    FakeParts,
    FakeReader,
    Memory,
    crowd,
    picture,
    rows,
    rows_in_one_process,
    run_to_end,
    spec,
    still_evidence,
    wait_until,
)
from ray.exceptions import RayActorError
from thread_host import hang, process_id

from mlbs_actors.actors.ipc.channels import connect
from mlbs_actors.actors.ipc.shared_memory import SharedMemory, SlotPool
from mlbs_actors.actors.node.host import Handle
from mlbs_actors.actors.node.memory import LAYER_BYTES, STREAM_BYTES, NodeMemory
from mlbs_actors.actors.node.pool import PoolActor, PoolCensus, PoolPolicy
from mlbs_actors.actors.node.processes import end, get, here, identity, kill, spawn, wait
from mlbs_actors.actors.pipeline import Node
from mlbs_actors.actors.stream.messages import LayerStart, LayerStep
from mlbs_actors.actors.stream.saved_states import SavedLayer
from mlbs_actors.errors import ActorLostError, LayerError
from mlbs_actors.messages import LayerEvidence
from mlbs_actors.state_file import capture


def test_released_processes_become_other_layers_and_idle_ones_beyond_the_spare_are_ended(
    own_node: Node, parts: FakeParts, tmp_path: Path
) -> None:
    one_after_the_other = [picture(t, live=[1 + t // 3]) for t in range(30)]
    stream = own_node.start(spec("changing", FakeReader([*one_after_the_other], tmp_path)))
    run_to_end(stream)
    layers, others = 1 + 10, 2  # the background and ten objects; coordinator and segmenter
    assert len(parts.processes()) - others < layers
    wait_until(lambda: own_node.census() == PoolCensus(idle=1, busy=0))


def test_each_layer_gets_a_process_beside_the_frames(own_node: Node, tmp_path: Path) -> None:
    stream = own_node.start(spec("two", FakeReader([picture(t, live=[1]) for t in range(5000)], tmp_path)))

    def have_processes() -> bool:
        stream.advance().result(timeout=200)
        return own_node.census() == PoolCensus(idle=0, busy=2)

    wait_until(have_processes)
    stream.stop(drain=False)
    assert own_node.census().busy == 0


def has_died(actor: Handle) -> bool:
    try:
        get(actor.__ray_ready__.remote())
    except RayActorError:
        return True
    return False


def test_a_birth_takes_another_process_when_an_idle_one_has_died_unnoticed(
    host: str, parts: FakeParts
) -> None:
    pool = spawn(PoolActor, parts, PoolPolicy(spare=1), node=here())
    run = get(pool.begin.remote(1))
    first, _ = get(pool.acquire.remote(run, CONFIG))
    get(pool.release.remote(run, identity(first), None))
    kill(first)
    wait_until(lambda: has_died(first))
    second, _ = get(pool.acquire.remote(run, CONFIG))
    assert get(second.__ray_ready__.remote())
    assert second != first
    end([pool])


def test_a_layer_takes_a_process_that_comes_back_before_its_own_has_started(
    host: str, parts: FakeParts
) -> None:
    hanging = FakeParts(parts.folder, hanging_starts=range(1, 1000))
    pool = spawn(PoolActor, hanging, PoolPolicy(spare=0), node=here())
    run = get(pool.begin.remote(1))
    first, _ = get(pool.acquire.remote(run, CONFIG))
    asked = [pool.acquire.remote(run, CONFIG) for _ in range(3)]
    assert not wait(asked, timeout=2.0)[0]
    assert get(pool.census.remote()) == PoolCensus(idle=2, busy=1)  # that start at once
    get(pool.release.remote(run, identity(first), first.release.remote(run)))
    [came], left = wait(asked, timeout=180.0)
    assert get(came)[0] == first
    get(pool.end.remote(run))
    for reference in left:
        with pytest.raises(LayerError, match="has ended"):
            get(reference, 180.0)
    get(pool.close.remote())
    end([pool])


def test_a_layer_process_that_cannot_start_fails_its_stream_with_the_reason(
    host: str, parts: FakeParts, tmp_path: Path
) -> None:
    node = Node(parts=FakeParts(parts.folder, cannot_start=True), policy=PoolPolicy(spare=0))
    stream = node.start(spec("poor", FakeReader([picture(t, live=[1]) for t in range(5000)], tmp_path)))
    with pytest.raises(ActorLostError, match=r"No process could be started for a layer: .*no memory left"):
        run_to_end(stream)
    stream.stop(drain=False)
    node.close()


def test_a_layer_process_that_hangs_at_its_start_is_replaced(host: str, parts: FakeParts) -> None:
    hanging = FakeParts(parts.folder, hanging_starts=range(1))
    start_seconds = 8.0 if host == "ray" else 0.5
    pool = spawn(
        PoolActor, hanging, PoolPolicy(spare=0, start_seconds=start_seconds, short_seconds=0.1), node=here()
    )
    run = get(pool.begin.remote(1))
    get(pool.acquire.remote(run, CONFIG))
    assert len([*parts.folder.glob("start-*")]) == 2
    assert get(pool.census.remote()) == PoolCensus(idle=0, busy=1)
    get(pool.close.remote())
    end([pool])


def test_a_stopped_stream_s_processes_serve_the_next_and_those_that_hang_are_ended(
    host: str, parts: FakeParts
) -> None:
    policy = PoolPolicy(spare=0, release_seconds=10.0 if host == "ray" else 3.0, idle_seconds=600.0)
    pool = spawn(PoolActor, parts, policy, node=here())
    run = get(pool.begin.remote(1))
    kept, hanging = (get(pool.acquire.remote(run, CONFIG))[0] for layer in (1, 2))
    if host == "ray":
        os.kill(get(hanging.__ray_call__.remote(_pid)), signal.SIGSTOP)
    else:
        hanging.__ray_call__.remote(_hang)
    get(pool.end.remote(run))
    assert get(pool.census.remote()) == PoolCensus(idle=1, busy=0)
    with pytest.raises(RayActorError):
        get(hanging.__ray_ready__.remote())
    again = get(pool.begin.remote(2))
    same, address = get(pool.acquire.remote(again, CONFIG))
    assert same == kept
    # What the first stream's coordinator has asked for before may still come.
    get(kept.release.remote(run))
    get(kept.serve.remote(run))
    evidence = still_evidence(
        [LayerEvidence(3, "object", -1, np.zeros((1, 2), np.float32), np.zeros((1, 2), np.float32))], 0
    )
    slots, memory = SlotPool(), SharedMemory()
    told = memory.share(evidence, slots.acquire("evidence"))
    born = memory.share(capture(Memory(4)), slots.acquire("state"))
    served = kept.serve.remote(again)
    with connect(address) as channel:
        channel.send(LayerStart(SavedLayer(3, "object", -1), born))
        channel.send(LayerStep(told, None, slots.acquire("posterior"), None))
        assert memory.load(channel.receive()).layer == 3
    get(served)
    end([pool])


def _pid(actor: object) -> int:
    return process_id()


def _hang(actor: object) -> None:
    hang()


def test_a_stream_that_has_ended_gets_no_more_processes(host: str, parts: FakeParts) -> None:
    policy = PoolPolicy(spare=0, release_seconds=60.0)

    # In this process, where it is certain that the stream ends while the process is starting.
    async def end_while_a_process_starts() -> PoolCensus:
        pool = PoolActor(parts, policy)
        run = await pool.begin(1)
        late = asyncio.ensure_future(pool.acquire(run, CONFIG))
        await asyncio.sleep(0)
        assert await pool.census() == PoolCensus(idle=1, busy=0)
        await pool.end(run)
        with pytest.raises(LayerError, match="has ended"):
            await late
        census = await pool.census()
        await pool.close()
        return census

    assert asyncio.run(end_while_a_process_starts()) == PoolCensus(idle=1, busy=0)


def test_a_process_that_nobody_wants_any_more_ends_when_it_has_started(host: str, parts: FakeParts) -> None:
    hanging = FakeParts(parts.folder, hanging_starts=range(1))
    pool = spawn(PoolActor, hanging, PoolPolicy(spare=0, idle_seconds=0.1, short_seconds=0.1), node=here())
    run = get(pool.begin.remote(1))
    asked = pool.acquire.remote(run, CONFIG)
    wait_until(lambda: get(pool.census.remote()).idle == 1)
    get(pool.end.remote(run))
    with pytest.raises(LayerError, match="has ended"):
        get(asked, 180.0)
    hanging.let_start()
    wait_until(lambda: get(pool.census.remote()) == PoolCensus(idle=0, busy=0))
    get(pool.close.remote())
    end([pool])


# ---- memory


@dataclass(frozen=True)
class Room:
    """A node's memory for so many processes, of those that have started."""

    folder: Path
    processes: int

    def __call__(self) -> NodeMemory:
        free = LAYER_BYTES * (self.processes - len([*self.folder.glob("start-*")]))
        return NodeMemory(0, free + NodeMemory(0, 0).available - NodeMemory(0, 0).free)


def test_objects_beyond_the_memory_have_no_process_of_their_own_and_the_same_labels(
    host: str, parts: FakeParts, tmp_path: Path
) -> None:
    node = Node(parts=parts, policy=PoolPolicy(short_seconds=0.1, memory=Room(parts.folder, 2)))
    pictures = [picture(t, live=range(1, 6)) for t in range(200)]
    stream = node.start(spec("crowd", FakeReader([*pictures], tmp_path, slow_seconds=0.01)))
    steps = [stream.advance().result(timeout=200)]
    while not steps[-1].done:
        steps.append(stream.advance().result(timeout=200))
    stream.stop(drain=False)
    assert rows(tmp_path) == rows_in_one_process(parts, pictures)
    assert len([*parts.folder.glob("start-*")]) == 2
    assert max(step.without_process for step in steps) == 4  # of the background and five objects
    node.close()


def test_memory_is_kept_for_the_streams_that_are_still_to_begin(host: str, parts: FakeParts) -> None:
    # For a process beside one stream that is still to begin, but not beside two.
    room = Room(parts.folder, 1 + STREAM_BYTES // LAYER_BYTES + 1)
    policy = PoolPolicy(short_seconds=0.1, streams=3, memory=room)
    pool = spawn(PoolActor, parts, policy, node=here())
    first, second = get(pool.begin.remote(1)), get(pool.begin.remote(2))
    assert get(pool.acquire.remote(first, CONFIG)) is None
    assert get(pool.acquire.remote(second, CONFIG)) is not None
    end([pool])


def test_a_layer_gets_the_process_that_another_gives_back_where_the_memory_holds_no_more(
    host: str, parts: FakeParts
) -> None:
    policy = PoolPolicy(short_seconds=60.0, memory=Room(parts.folder, 1))
    pool = spawn(PoolActor, parts, policy, node=here())
    run = get(pool.begin.remote(1))
    first, _ = get(pool.acquire.remote(run, CONFIG))
    later = pool.acquire.remote(run, CONFIG)
    assert not wait([later], timeout=0.5)[0]
    get(pool.release.remote(run, identity(first), first.release.remote(run)))
    assert get(later, 180.0)[0] == first
    end([pool])


# ---- processes that wait for a stream


def test_a_stream_starts_in_processes_that_were_warm_before(
    own_node: Node, parts: FakeParts, tmp_path: Path
) -> None:
    first = own_node.start(spec("first", FakeReader([*crowd(60, 1)], tmp_path / "first")))
    for _ in range(5):
        first.advance().result(timeout=200)
    wait_until(own_node.prepare)
    warm = parts.processes()
    pictures = crowd(12, 1)
    second = own_node.start(spec("second", FakeReader([*pictures], tmp_path / "second")))
    own = {get(handle.__ray_call__.remote(_pid)) for handle in (second._coordinator, second._links.segmenter)}
    assert len(own) == 2
    assert own <= warm
    run_to_end(second)
    assert rows(tmp_path / "second") == rows_in_one_process(parts, pictures)
    first.stop(drain=False)


def test_processes_for_the_next_stream_are_started_one_after_the_other(
    own_node: Node, parts: FakeParts
) -> None:
    seen = set()

    def ready() -> bool:
        seen.add(len(parts.processes()))
        return own_node.prepare()

    wait_until(ready)
    assert seen == {0, 1, 2}
