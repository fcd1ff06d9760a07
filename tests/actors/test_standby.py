"""Processes that take one file after the other."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import pytest
from actor_fakes import FakeParts, FakeReader, crowd, rows, rows_in_one_process, run_to_end, spec, wait_until

from mlbs_actors.actors import standby
from mlbs_actors.actors.node.pool import PoolPolicy
from mlbs_actors.actors.node.processes import get, identity
from mlbs_actors.actors.pipeline import Node, StreamActors
from mlbs_actors.errors import ActorLostError, SourceError


@pytest.fixture(autouse=True)
def none_prepared(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have no process started in advance: whether it is ready in time is a matter of chance."""
    monkeypatch.setattr(standby, "_PREPARED", ())


def of_stream(stream: StreamActors) -> set[str]:
    """The processes of a stream that is one's own, not the node's."""
    return {identity(one) for one in (stream._coordinator, stream._links.segmenter, stream._links.reader)}


def test_files_one_after_the_other_are_in_the_same_processes_with_the_bytes_each_gives_alone(
    own_node: Node, parts: FakeParts, tmp_path: Path
) -> None:
    seen = []
    for number, objects in enumerate((2, 1, 3)):
        pictures = crowd(20 + number, objects)
        stream = own_node.start(spec(f"file {number}", FakeReader([*pictures], tmp_path / str(number))))
        seen.append(of_stream(stream))
        run_to_end(stream)
        assert rows(tmp_path / str(number)) == rows_in_one_process(parts, pictures)
    assert seen[0] == seen[1] == seen[2]


def test_a_process_that_waits_for_a_file_holds_nothing_of_the_one_before(
    own_node: Node, tmp_path: Path
) -> None:
    stream = own_node.start(spec("file", FakeReader([*crowd(20, 2)], tmp_path)))
    run_to_end(stream)
    for process in (stream._coordinator, stream._links.segmenter, stream._links.reader):
        assert get(process.__ray_call__.remote(_members)) == []


def _members(actor: object) -> list[str]:
    return sorted(vars(actor))


@pytest.mark.parametrize("fault", ["raises", "dies", "is damaged"])
def test_the_processes_of_a_file_with_a_fault_take_no_other_one(
    fault: str, own_node: Node, parts: FakeParts, tmp_path: Path
) -> None:
    pictures = crowd(20, 1)
    bad = FakeReader(
        [*pictures],
        tmp_path / "bad",
        raises_at=0 if fault == "raises" else -1,
        dies_at=0 if fault == "dies" else -1,
        problem="It is damaged." if fault == "is damaged" else None,
    )
    stream = own_node.start(spec("bad", bad))
    before = of_stream(stream)
    if fault == "is damaged":
        run_to_end(stream)
    else:
        with pytest.raises(SourceError if fault == "raises" else ActorLostError):
            run_to_end(stream)
        stream.stop(drain=False)
    good = own_node.start(spec("good", FakeReader([*pictures], tmp_path / "good")))
    assert not of_stream(good) & before
    run_to_end(good)
    assert rows(tmp_path / "good") == rows_in_one_process(parts, pictures)


def test_no_more_processes_are_kept_than_streams_run_at_once(
    host: str, parts: FakeParts, tmp_path: Path
) -> None:
    node = Node(parts=parts, policy=PoolPolicy(spare=1, streams=1))
    first, second = (
        node.start(spec(name, FakeReader([*crowd(12, 1)], tmp_path / name))) for name in ("first", "second")
    )
    ours = of_stream(first) | of_stream(second)
    run_to_end(first, second)
    third, fourth = (
        node.start(spec(name, FakeReader([*crowd(12, 1)], tmp_path / name))) for name in ("third", "fourth")
    )
    assert len((of_stream(third) | of_stream(fourth)) & ours) == 3
    run_to_end(third, fourth)
    node.close()


def test_processes_beyond_the_first_end_when_no_file_comes_for_a_while(
    host: str, parts: FakeParts, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(standby, "_IDLE_SECONDS", 0.0)
    node = Node(parts=parts, policy=PoolPolicy(spare=1, streams=2))
    streams = [
        node.start(spec(name, FakeReader([*crowd(12, 1)], tmp_path / name))) for name in ("first", "second")
    ]
    run_to_end(*streams)
    wait_until(node.prepare)
    wait_until(partial(_have_ended, streams, 3))
    node.close()


def _have_ended(streams: list[StreamActors], processes: int) -> bool:
    every = [
        one
        for stream in streams
        for one in (stream._coordinator, stream._links.segmenter, stream._links.reader)
    ]
    ended = 0
    for one in every:
        try:
            get(one.__ray_ready__.remote(), 5.0)
        except Exception:  # whatever says that it is gone
            ended += 1
    return ended == processes
