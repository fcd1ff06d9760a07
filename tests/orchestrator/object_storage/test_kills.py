"""A run that is killed at any request to the store goes on elsewhere: the same bytes as without a kill."""

from __future__ import annotations

import os
import random
import tarfile
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest
from memory_store import KilledError, MemoryStore
from record_fakes import bare_snapshot, frame, segmentation
from segment_fakes import Camera

from mlbs_actors.record.commits import read_commits
from mlbs_actors.record.record_tables import read_rows
from orchestrator.object_storage.fetching import fetch, fetch_files
from orchestrator.object_storage.held_files import HeldFiles
from orchestrator.object_storage.ledger import Ledger, await_holder, read_standing
from orchestrator.object_storage.manifest import OBJECTS
from orchestrator.object_storage.publisher import Publisher
from orchestrator.run.retention import Retention
from orchestrator.run.retention_limits import Keep
from orchestrator.sinks.record import StreamRecord

TABLES = frozenset({"masks", "parquet"})
FRAMES = 40


@pytest.fixture(autouse=True)
def _quick_disk(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "fsync", lambda descriptor: None)


class Node:
    """A machine with an empty disk, on which a run goes on with what is published."""

    def __init__(self, store: MemoryStore, disk: Path, name: str) -> None:
        found = await_holder(store, name, "memory", lambda text: None, sleep=lambda seconds: None)
        self.run = disk / "run"
        self._ledger = Ledger(store, found, name, "memory")
        try:
            fetch_files(store, found.files, self.run)
            held = HeldFiles(self.run, disk / "held", found.files)
            self.publisher = Publisher(store, self._ledger, held, "memory", lambda text: None, {})
        except BaseException:
            self.stop()
            raise

    def stop(self) -> None:
        self._ledger.close()


def film(node: Node) -> None:
    """A file of some frames, published now and then."""
    record = StreamRecord(node.run / "film", "film", TABLES)
    before = record.opening.resume_from
    for index in range(0 if before is None else before.rows, FRAMES):
        record.write(segmentation(index, 3), frame(index))
        if index in (15, 31):
            record.keep(bare_snapshot(record, index + 1))
        if index in (10, 33, 34):
            node.publisher.publish()
    record.close(whole=True)


def camera(node: Node) -> None:
    """A camera that sends four frames a second, in segments of ten seconds, of which old ones are deleted."""
    gate = Camera(node.run / "gate", TABLES, rate=4)
    retention = Retention(node.run, lambda: {None: Keep(15)}, print, lambda: gate.now)
    for end in (25, 60, 85, 130):
        if end > gate.rows:
            gate.send(end)
            retention.apply()
            node.publisher.publish()
    gate.record.close(whole=True)
    retention.apply()


def masks(stream: Path) -> dict[str, bytes]:
    found = {path.name: path.read_bytes() for path in stream.glob("masks/*")}
    for path in stream.glob("*/masks.tar"):
        with tarfile.open(path) as archive:
            for entry in archive:
                content = archive.extractfile(entry)
                assert content is not None
                found[entry.name] = content.read()
    return found


def result(store: MemoryStore, folder: Path) -> tuple[object, ...]:
    """What somebody finds who fetches the run: that which does not depend on when it was killed."""
    fetch(store, folder)
    (stream,) = (path for path in folder.iterdir() if path.is_dir())
    commits = [(one.first, one.last, one.segment) for one in read_commits(stream)]
    # What the list of objects says of deleted segments depends on when it was written last.
    names = ["events.jsonl"] if commits[0][0] else ["events.jsonl", "objects.csv", "objects.json"]
    return commits, masks(stream), [*read_rows(stream)], [(stream / name).read_bytes() for name in names]


def garbage(store: MemoryStore) -> set[str]:
    """Objects that nothing names."""
    named = {part.key for parts in read_standing(store).files.values() for part in parts}
    return set(store.keys(OBJECTS)) - named


def run_on(store: MemoryStore, disk: Path, name: str, work: Callable[[Node], None]) -> None:
    node = Node(store, disk, name)
    status = node.run / "status.json"
    try:
        if not status.exists():
            work(node)
            status.write_text("ended")
        node.publisher.publish(last=True)
    finally:
        node.stop()


@pytest.mark.parametrize("work", [film, camera], ids=["a file", "a camera in segments"])
@pytest.mark.parametrize("acted", [False, True], ids=["before", "after"])
@pytest.mark.parametrize("every", [pytest.param(True, marks=pytest.mark.long, id="every"), False])
def test_a_run_killed_at_any_request_goes_on_elsewhere_with_the_same_bytes(
    work: Callable[[Node], None], acted: bool, every: bool, tmp_path: Path
) -> None:
    store = MemoryStore()
    run_on(store, tmp_path / "whole", "a", work)
    expected, count = result(store, tmp_path / "expected"), len(store.requests)
    assert not garbage(store)
    assert count > 30
    numbers = range(1, count + 1) if every else random.Random(acted).sample(range(1, count + 1), 6)
    for number in numbers:
        store, place = MemoryStore(), tmp_path / f"{number}"
        store.kill_at(number, acted=acted)
        try:
            run_on(store, place / "first", "a", work)
        except KilledError:
            assert number <= len(store.requests) + 1
        store.be_there()
        run_on(store, place / "second", "b", work)
        assert result(store, place / "found") == expected, f"killed at request {number}"
        assert not garbage(store), f"killed at request {number}"


def test_a_run_killed_twice_goes_on(tmp_path: Path) -> None:
    store = MemoryStore()
    run_on(store, tmp_path / "whole", "a", film)
    expected = result(store, tmp_path / "expected")
    store = MemoryStore()
    for name, number in (("b", 21), ("c", 25)):
        store.kill_at(number, acted=True)
        with pytest.raises(KilledError):
            run_on(store, tmp_path / name, name, film)
        store.be_there()
    run_on(store, tmp_path / "d", "d", film)
    assert result(store, tmp_path / "found") == expected


def test_what_is_published_is_what_is_in_the_folder(tmp_path: Path) -> None:
    store = MemoryStore()
    run_on(store, tmp_path / "a", "a", film)
    fetch(store, tmp_path / "b")

    def files(folder: Path) -> Sequence[tuple[str, bytes]]:
        paths = sorted(path for path in folder.rglob("*") if path.is_file() and path.name != ".lock")
        return [(path.relative_to(folder).as_posix(), path.read_bytes()) for path in paths]

    assert files(tmp_path / "b") == files(tmp_path / "a" / "run")
