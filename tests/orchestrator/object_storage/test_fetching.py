"""A folder is made of what is published, also while that changes."""

from __future__ import annotations

import os
import random
from collections.abc import Callable
from pathlib import Path

import pytest
from memory_store import MemoryStore

from orchestrator.object_storage.fetching import fetch, fetch_files
from orchestrator.object_storage.ledger import Ledger, read_standing
from orchestrator.object_storage.manifest import OBJECTS, Part
from orchestrator.object_storage.store import MissingObjectError, StoreError
from orchestrator.object_storage.uploads import digest_of


class Published(MemoryStore):
    """The store of a run that publishes while it is read, and deletes at once what counts no more."""

    def __init__(self) -> None:
        super().__init__()
        self.reads = 0
        self.meanwhile: Callable[[], None] = lambda: None
        self._ledger = Ledger(self, read_standing(self), "me", "memory")
        self._number = 0

    def add(self, files: dict[str, list[bytes]], gone: tuple[str, ...] = ()) -> None:
        """Publish files, each part of them as an object, and delete others."""
        parts = {name: tuple(self._part(content) for content in pieces) for name, pieces in files.items()}
        self._ledger.add(parts, gone)
        named = {part.key for parts in read_standing(self).files.values() for part in parts}
        for key in set(self.keys(OBJECTS)) - named:
            del self.objects[key]

    def get(self, key: str, begin: int = 0, size: int | None = None) -> bytes:
        """Read, after what the run does meanwhile."""
        if key.startswith(OBJECTS):
            self.reads += 1
            self.meanwhile()
        return super().get(key, begin, size)

    def close(self) -> None:
        self._ledger.close()

    def _part(self, content: bytes) -> Part:
        self._number += 1
        key = f"{OBJECTS}/1.{self._number}/it"
        self.objects[key] = content
        return Part(key, 0, len(content), digest_of(iter([content])))


def files_in(folder: Path) -> dict[str, bytes]:
    paths = (path for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths}


@pytest.fixture
def one_at_a_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("orchestrator.object_storage.fetching._REQUESTS_AT_ONCE", 1)


@pytest.mark.usefixtures("one_at_a_time")
def test_a_run_that_replaces_files_while_it_is_fetched_is_fetched(tmp_path: Path) -> None:
    published = Published()
    tables = {f"gate/layers-{number}.parquet": [b"%d" % number] for number in range(20)}
    published.add(tables | {"status.json": [b"0"], "gate/.snapshots/0/layer": [b"first"]})
    done = [0]

    def go_on() -> None:
        done[0] += 1
        if done[0] <= 20:
            published.add(
                {"status.json": [b"%d" % done[0]], f"gate/.snapshots/{done[0]}/layer": [b"later"]},
                (f"gate/.snapshots/{done[0] - 1}/layer",),
            )

    published.meanwhile = go_on
    assert fetch(published, tmp_path / "found") == 22
    expected = {name: content for name, (content,) in tables.items()}
    expected |= {"status.json": b"20", "gate/.snapshots/20/layer": b"later"}
    assert files_in(tmp_path / "found") == expected
    assert [path.name for path in (tmp_path / "found/gate/.snapshots").iterdir()] == ["20"]
    assert published.reads < 30
    published.close()


@pytest.mark.usefixtures("one_at_a_time")
@pytest.mark.parametrize("seed", range(20))
def test_a_folder_is_what_counted_at_one_moment(seed: int, tmp_path: Path) -> None:
    dice, published = random.Random(seed), Published()
    states = []

    def change() -> None:
        files = {
            f"{dice.choice('abc')}/{number}": [
                dice.randbytes(dice.randint(1, 9)) if dice.random() < 0.5 else b"same"
                for _ in range(dice.randint(0, 3))
            ]
            for number in range(3)
        }
        there = sorted(read_standing(published).files.keys() - files.keys())
        published.add(files, tuple(name for name in there if dice.random() < 0.5))
        states.append(
            {
                name: b"".join(published.objects[part.key] for part in parts)
                for name, parts in read_standing(published).files.items()
            }
        )

    change()
    published.meanwhile = lambda: change() if dice.random() < 0.1 else None
    fetch(published, tmp_path / "found")
    assert files_in(tmp_path / "found") in states
    published.close()


@pytest.mark.usefixtures("one_at_a_time")
def test_a_run_that_is_faster_than_its_reader_is_an_error(tmp_path: Path) -> None:
    published = Published()
    published.add({"status.json": [b"0"]})
    published.meanwhile = lambda: published.add({"status.json": [os.urandom(8)]})
    with pytest.raises(StoreError, match="replaced faster than it can be read"):
        fetch(published, tmp_path / "found")
    assert not list(tmp_path.iterdir())
    published.close()


def test_a_folder_beside_the_one_that_is_made_stays(tmp_path: Path) -> None:
    published = Published()
    published.add({"run.json": [b"{}"]})
    (tmp_path / "found.part").mkdir()
    (tmp_path / "found.part/note").write_text("of somebody")
    fetch(published, tmp_path / "found")
    assert (tmp_path / "found.part/note").read_text() == "of somebody"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["found", "found.part"]
    published.close()


def test_a_folder_that_cannot_be_made_leaves_nothing(tmp_path: Path) -> None:
    missing = {"run.json": (Part(f"{OBJECTS}/1.1/none", 0, 2, "00"),)}
    with pytest.raises(MissingObjectError):
        fetch_files(MemoryStore(), missing, tmp_path / "found")
    assert not list(tmp_path.iterdir())
