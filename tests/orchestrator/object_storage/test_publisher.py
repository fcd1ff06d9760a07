"""Publishing a folder that changes: what is written, and what becomes of it when the store is away."""

from __future__ import annotations

import importlib.util
import os
import shutil
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from filelock import FileLock
from memory_store import MemoryStore

from mlbs_actors.errors import SinkError
from orchestrator.object_storage import publisher as publisher_module
from orchestrator.object_storage.address import StoreAddress
from orchestrator.object_storage.fetching import fetch
from orchestrator.object_storage.held_files import HeldFiles, LostFolderError
from orchestrator.object_storage.ledger import Ledger, read_standing
from orchestrator.object_storage.manifest import OBJECTS
from orchestrator.object_storage.publisher import Publisher
from orchestrator.object_storage.store import Content, StoreError, open_store
from orchestrator.storage import commit_log


class Bench:
    """A folder with one stream, and its publisher."""

    def __init__(self, disk: Path) -> None:
        self.store = MemoryStore()
        self.run = disk / "run"
        self.stream = self.run / "gate"
        self.stream.mkdir(parents=True)
        (self.stream / ".generation").write_text("0\n")
        self.disk = disk
        self.said: list[str] = []
        self.clock = 0.0
        self.ledger = Ledger(self.store, read_standing(self.store), "me", "s3://b/run")
        self.publisher = Publisher(
            self.store,
            self.ledger,
            HeldFiles(self.run, disk / "held"),
            "s3://b/run",
            self.said.append,
            {},
            lambda: self.clock,
        )

    def published(self) -> list[str]:
        """Publish, and return the keys that were written for it."""
        self.store.requests.clear()
        self.publisher.publish()
        return [request.removeprefix("put ") for request in self.store.requests if request[:4] == "put "]

    def found(self, name: str) -> dict[str, bytes]:
        fetch(self.store, self.disk / name)
        paths = (path for path in (self.disk / name).rglob("*") if path.is_file())
        return {path.relative_to(self.disk / name).as_posix(): path.read_bytes() for path in paths}


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    bench = Bench(tmp_path)
    yield bench
    bench.ledger.close()


def test_small_files_of_a_folder_share_an_object_and_tables_have_their_own(bench: Bench) -> None:
    (bench.stream / "masks").mkdir()
    for index in range(5):
        (bench.stream / "masks" / f"{index}.png").write_bytes(bytes([index]) * (index * 700))
    (bench.stream / "layers-00000000.parquet").write_bytes(b"table")
    (bench.run / "run.json").write_text("{}")
    (bench.stream / "objects.csv").write_text("id\n")
    (bench.stream / "overlay.mp4").write_bytes(bytes(300_000))
    assert sorted(bench.published()) == [
        f"{OBJECTS}/1.1.tar",
        f"{OBJECTS}/1.1/gate/layers-00000000.parquet",
        f"{OBJECTS}/1.1/gate/masks.tar",
        f"{OBJECTS}/1.1/gate/overlay.mp4",
    ]
    files = bench.found("first")
    assert files["gate/masks/0.png"] == b""
    assert files["gate/masks/4.png"] == bytes([4]) * 2800
    assert len(files) == 10
    assert bench.published() == []
    (bench.stream / "objects.csv").write_text("id\n3\n")
    assert bench.published() == [f"{OBJECTS}/1.3/gate/objects.csv"]
    assert bench.found("second") == files | {"gate/objects.csv": b"id\n3\n"}


def test_a_growing_list_is_written_in_few_parts_and_about_log_n_times(bench: Bench) -> None:
    events, written = bench.stream / "events.jsonl", 0
    for number in range(64):
        with events.open("ab") as file:
            file.write(b"%063d\n" % number)
        (key, *_) = [key for key in bench.published() if "events" in key or key.endswith(".tar")]
        written += len(bench.store.objects[key])
        assert len(read_standing(bench.store).files["gate/events.jsonl"]) <= 7
        assert bench.found(f"{number}")["gate/events.jsonl"] == events.read_bytes()
    assert written <= 8 * events.stat().st_size


def test_a_list_that_was_cut_off_and_went_on_is_written_anew(bench: Bench) -> None:
    events = bench.stream / "events.jsonl"
    events.write_bytes(b"one\ntwo\n")
    bench.published()
    with events.open("r+b") as file:
        file.truncate(4)
        file.seek(4)
        file.write(b"three\nfour\n")
    bench.published()
    assert bench.found("it")["gate/events.jsonl"] == b"one\nthree\nfour\n"


def test_drafts_locks_and_packets_stay_here(bench: Bench) -> None:
    (bench.stream / ".packets").mkdir()
    (bench.stream / ".packets" / "1.mkv").write_bytes(b"")
    (bench.stream / ".a.png.1234.part").write_bytes(b"")
    (bench.stream / "made" / ".blur.k3x.part").mkdir(parents=True)
    (bench.stream / "made" / ".blur.k3x.part" / "blur.mp4").write_bytes(b"half a video")
    (bench.run / ".lock").write_bytes(b"")
    (bench.run / ".live").mkdir()
    (bench.stream / ".objects").write_bytes(b"state")
    bench.published()
    assert sorted(bench.found("it")) == ["gate/.generation", "gate/.objects"]


def test_deleted_files_go_a_minute_after_the_manifest_that_does_not_name_them(bench: Bench) -> None:
    video = bench.stream / "overlay.mp4"
    video.write_bytes(bytes(300_000))
    (key,) = [key for key in bench.published() if key.endswith(".mp4")]
    video.unlink()
    bench.published()
    assert "gate/overlay.mp4" not in read_standing(bench.store).files
    assert key in bench.store.objects
    bench.clock += 61
    bench.published()
    assert key not in bench.store.objects


def test_a_store_that_is_away_for_a_while_loses_nothing(bench: Bench) -> None:
    masks = bench.stream / "masks"
    masks.mkdir()
    (masks / "0.png").write_bytes(b"0")
    bench.published()
    bench.store.go_away()
    for index in range(1, 4):
        (masks / f"{index}.png").write_bytes(b"%d" % index)
        with pytest.raises(StoreError):
            bench.publisher.publish()
        assert bench.publisher.figures["waiting_bytes"] > 0
    (masks / "0.png").unlink()
    bench.store.be_there()
    bench.publisher.publish()
    assert {name for name in bench.found("it") if "masks" in name} == {
        f"gate/masks/{i}.png" for i in (1, 2, 3)
    }
    assert bench.publisher.figures["waiting_bytes"] == 0


def test_a_run_at_its_end_waits_for_the_store(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(publisher_module, "retry_seconds", lambda failures: 0.01)
    failures: list[str] = []

    def fail(request: str) -> None:
        if len(failures) < 5:
            failures.append(request)
            raise StoreError("no route to the store")

    bench.store.before = fail
    (bench.run / "report.html").write_text("the end")
    bench.publisher.start()
    bench.publisher.finish(60)
    assert bench.found("it")["report.html"] == b"the end"
    assert read_standing(bench.store).ended
    assert bench.said == [
        "Nothing can be published to s3://b/run: no route to the store. The run goes on; its results wait on "
        "this machine.",
        "s3://b/run can be written again; all results are there.",
    ]


def test_what_cannot_be_read_any_more_is_taken_anew(bench: Bench) -> None:
    note = bench.stream / "overlay.note"
    note.write_bytes(b"a sentence that is written over")
    bench.store.go_away()
    with pytest.raises(StoreError):
        bench.publisher.publish()
    os.truncate(note, 3)
    bench.store.be_there()
    with pytest.raises(OSError, match="shorter than it was"):
        bench.publisher.publish()
    bench.publisher.publish()
    assert bench.found("it")["gate/overlay.note"] == b"a s"


@pytest.mark.parametrize("lost", ["", "run.json", "gate", "gate/.generation"])
def test_a_folder_that_has_lost_its_run_takes_nothing_from_the_store(bench: Bench, lost: str) -> None:
    (bench.run / "run.json").write_text("{}")
    (bench.stream / "overlay.mp4").write_bytes(bytes(300_000))
    bench.published()
    before = dict(bench.store.objects)
    path = bench.run / lost
    if path.is_dir():
        shutil.rmtree(path)
    else:
        path.unlink()
    bench.publisher.start()
    with pytest.raises(SinkError, match=r"has lost (run\.json|gate), so nothing more is published"):
        bench.publisher.finish(20)
    assert bench.store.objects == before


def test_a_stream_that_was_deleted_and_begun_anew_takes_nothing_from_the_store(bench: Bench) -> None:
    (bench.stream / ".generation").write_text("2\n")
    (bench.stream / "overlay.mp4").write_bytes(bytes(300_000))
    bench.published()
    before = dict(bench.store.objects)
    shutil.rmtree(bench.stream)
    bench.stream.mkdir()
    (bench.stream / ".generation").write_text("0\n")
    with pytest.raises(LostFolderError):
        bench.publisher.publish()
    assert bench.store.objects == before


def test_a_stream_that_got_another_name_is_published_under_it(bench: Bench) -> None:
    (bench.stream / "overlay.mp4").write_bytes(bytes(300_000))
    bench.published()
    bench.stream.rename(bench.run / "door")
    bench.published()
    assert sorted(bench.found("it")) == ["door/.generation", "door/overlay.mp4"]


def test_a_file_that_goes_while_the_folder_is_looked_at_takes_no_other_with_it(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    (bench.run / "a.html").write_text("goes")
    (bench.run / "run.json").write_text("{}")
    link = os.link

    def lose(source: Path, target: Path) -> None:
        if source.name == "a.html":
            source.unlink()
        link(source, target)

    monkeypatch.setattr(os, "link", lose)
    bench.published()
    assert sorted(bench.found("it")) == ["gate/.generation", "run.json"]


def test_published_is_the_moment_of_the_state_that_is_in_the_store(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = [1_000.0]
    monkeypatch.setattr(time, "time", lambda: now[0])
    assert bench.publisher.figures["published"] is None
    bench.store.go_away()
    with pytest.raises(StoreError):
        bench.publisher.publish()
    bench.store.be_there()
    now[0] = 2_000.0
    (bench.stream / "later.png").write_bytes(b"later")

    def stop(*asked: object) -> None:
        raise OSError("no disk")

    monkeypatch.setattr(HeldFiles, "take", stop)
    with pytest.raises(OSError, match="no disk"):
        bench.publisher.publish()
    assert "gate/later.png" not in read_standing(bench.store).files
    assert bench.publisher.figures["published"] == "1970-01-01T00:16:40+00:00"


def test_a_run_that_is_ended_at_once_begins_no_more_requests_and_leaves_no_thread_to_wait_for(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(publisher_module, "_ABANDON_SECONDS", 0.0)
    for number in range(24):
        (bench.stream / f"layers-{number:08d}.parquet").write_bytes(b"%d" % number)
    before = {*threading.enumerate()}
    begun, served, keys = threading.Semaphore(0), threading.Event(), list[str]()

    def put(key: str, content: Content) -> None:
        keys.append(key)
        begun.release()
        served.wait()

    monkeypatch.setattr(bench.store, "put", put)
    bench.publisher.start()
    for _ in range(8):
        assert begun.acquire(timeout=60)
    bench.publisher.abandon()
    threads = {*threading.enumerate()} - before
    assert len(threads) == 9
    assert all(thread.daemon for thread in threads)
    served.set()
    for thread in threads:
        thread.join(60)
    assert len(keys) == 8
    assert not read_standing(bench.store).files
    assert not bench.said


def test_a_stream_that_is_busy_is_tried_soon_without_a_word(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(commit_log, "_BRIEF_SECONDS", 0.0)
    failed, go_on = threading.Semaphore(0), threading.Semaphore(0)

    def soon(failures: int) -> float:
        failed.release()
        go_on.acquire(timeout=60)
        return 0.0

    monkeypatch.setattr(publisher_module, "retry_seconds", soon)
    figures = bench.publisher.figures
    with FileLock(bench.stream / ".lock"):
        bench.publisher.start()
        for _ in range(publisher_module._BUSY_FAILURES - 1):
            assert failed.acquire(timeout=60)
            assert not bench.said
            assert bench.publisher.figures == figures
            go_on.release()
        assert failed.acquire(timeout=60)
        (said,) = bench.said
        assert "Another process is writing to" in said
    go_on.release(2)
    bench.publisher.finish(60)
    assert len(bench.said) == 2


@pytest.mark.skipif(importlib.util.find_spec("obstore") is None, reason="needs the extra object-storage")
def test_a_large_file_that_cannot_be_read_is_taken_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = open_store(StoreAddress(f"file://{tmp_path}/store"))
    video = tmp_path / "run" / "video.mp4"
    video.parent.mkdir()
    video.write_bytes(bytes(10 << 20))
    ledger = Ledger(store, read_standing(store), "me", "memory")
    held = HeldFiles(tmp_path / "run", tmp_path / "held")
    publisher = Publisher(store, ledger, held, "memory", lambda text: None, {})
    put = store.put

    def cut_before(key: str, content: Content) -> None:
        os.truncate(video, 9 << 20)
        put(key, content)

    monkeypatch.setattr(store, "put", cut_before)
    with pytest.raises(OSError, match="shorter than it was"):
        publisher.publish()
    publisher.publish()
    fetch(store, tmp_path / "found")
    assert (tmp_path / "found/video.mp4").read_bytes() == bytes(9 << 20)
    ledger.close()
