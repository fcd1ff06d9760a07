"""A source that shows nothing twice: what it gave is given again, and what is lost is a row."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import pyarrow.dataset as ds
import pytest
from actor_fakes import CONFIG, FakeParts, picture, rows_in_one_process, wait_until
from driver_fakes import driver_of
from test_recovery import as_rows, started, take
from thread_host import die, pause

from mlbs_actors.actors.ipc.shared_memory import Shared, SharedMemory, SlotPool
from mlbs_actors.actors.node.processes import end
from mlbs_actors.actors.pipeline import Node
from mlbs_actors.actors.stream import live_reader as live_reader_module
from mlbs_actors.actors.stream.live_reader import FrameRing, LiveReaderActor
from mlbs_actors.actors.stream.messages import ReadNext, Reopen
from mlbs_actors.actors.stream.protocol import Snapshot, StreamSpec
from mlbs_actors.errors import SinkError
from mlbs_actors.messages import Array, LayerAppearance, Segmentation
from mlbs_actors.record.commits import read_commits
from mlbs_actors.source import FrameReader, SourceFrame, SourcePosition, SourceSilence, SourceStatus
from mlbs_actors.state_file import capture
from orchestrator.run.stream_state import StreamState
from orchestrator.sinks.record import StreamRecord, has_snapshot, recorded_frames
from orchestrator.storage.snapshot_folder import SnapshotFolder

SAVE = frozenset({"masks", "parquet"})


def row(index: int, image: Array | None = None) -> SourceFrame:
    return SourceFrame(index, image, index / 10, f"{index:05d}", "dropped" if image is None else "ok")


IMAGE = np.zeros((2, 2, 3), np.uint8)


# The ring


def test_a_ring_holds_so_many_pictures_and_the_rows_between_them() -> None:
    ring = FrameRing(2)
    for index in range(9):
        ring.append(row(index, IMAGE if index % 3 == 0 else None))
    assert (ring.first, ring.next) == (1, 9)  # pictures 3 and 6
    assert [ring[index].index for index in range(1, 9)] == list(range(1, 9))
    ring.append(row(9, IMAGE))
    assert ring.first == 4
    ring.forget(7)
    ring.forget(2)
    assert (ring.first, ring[7].index) == (7, 7)
    ring.append(row(10, IMAGE))
    assert ring.first == 7
    ring.begin_at(40)
    assert (ring.first, ring.next) == (40, 40)


# The reader


class Answers:
    """A source that says what it is told to."""

    problem: str | None = None

    def __init__(self, *said: SourceFrame | SourceSilence) -> None:
        self.said = list(said)
        self.closed = False

    def read(self) -> SourceFrame | SourceSilence | None:
        return self.said.pop(0) if self.said else None

    def close(self) -> None:
        self.closed = True


def reader_of(*sources: Answers) -> LiveReaderActor:
    opened = iter(sources)
    return LiveReaderActor(lambda: next(opened))


def asked(reader: LiveReaderActor, *, fresh: bool) -> SourceFrame | SourceSilence | None:
    """What a start of the stream learns when it asks for its next row."""
    slots = SlotPool()
    said = reader.read(ReadNext(slots.acquire("frame"), fresh))
    if not isinstance(said, Shared):
        return said
    frame: SourceFrame = SharedMemory().load(said)
    assert np.array_equal(np.asarray(frame.image), IMAGE)
    return replace(frame, image=None)  # so that frames can be compared


def test_a_second_start_is_given_the_same_rows_again_and_then_new_ones() -> None:
    reader = reader_of(Answers(*(row(index, IMAGE) for index in range(6)), SourceSilence("stalled")))
    reader.go_on(SourcePosition())
    first = [asked(reader, fresh=True) for _ in range(5)]
    reader.forget(2)
    reader.go_on(SourcePosition(2, 0.1, 0.0))
    again = [asked(reader, fresh=True) for _ in range(4)]
    assert again[:3] == first[2:]
    assert again[3] == replace(row(5, IMAGE), image=None)
    assert asked(reader, fresh=True) == SourceSilence("stalled")


def test_without_anything_fresh_a_reader_ends_after_what_it_gave_before() -> None:
    source = Answers(*(row(index, IMAGE) for index in range(6)))
    reader = reader_of(source)
    reader.go_on(SourcePosition())
    given = [asked(reader, fresh=True) for _ in range(3)]
    reader.go_on(SourcePosition(1, 0.0, 0.0))
    assert [asked(reader, fresh=False) for _ in range(4)] == [*given[1:], None, None]
    assert len(source.said) == 3


def test_a_camera_that_is_elsewhere_now_goes_on_after_a_gap_with_consecutive_rows_and_times() -> None:
    before, there = (Answers(*(row(index, IMAGE) for index in range(3))) for _ in range(2))
    reader = reader_of(before)
    reader.go_on(SourcePosition())
    given = [asked(reader, fresh=True) for _ in range(2)]
    assert list(reader._answers(Reopen(lambda: there))) == []
    assert before.closed
    given += [asked(reader, fresh=True) for _ in range(4)]
    frames = [frame for frame in given if isinstance(frame, SourceFrame)]
    assert [frame.index for frame in frames] == list(range(6))
    assert [frame.status for frame in frames] == ["ok", "ok", "gap", "ok", "ok", "ok"]
    times = [frame.pts for frame in frames]
    assert times == sorted(times)
    assert there.said == []


def test_a_camera_that_is_read_there_already_goes_on_without_a_gap() -> None:
    source = Answers(*(row(index, IMAGE) for index in range(4)))

    def opened() -> Answers:
        return source

    reader = LiveReaderActor(opened)
    reader.go_on(SourcePosition())
    given = [asked(reader, fresh=True) for _ in range(2)]
    reader.reopen(opened)
    given += [asked(reader, fresh=True) for _ in range(2)]
    assert not source.closed
    assert [frame.status for frame in given if isinstance(frame, SourceFrame)] == ["ok"] * 4


def test_a_new_reader_goes_on_with_a_gap_and_consecutive_rows_and_times() -> None:
    reader = reader_of(Answers(row(0, IMAGE), row(1), row(2, IMAGE)))
    reader.go_on(SourcePosition(40, 8.0, time.time() - 3.0))
    rows = [asked(reader, fresh=True) for _ in range(4)]
    frames = [frame for frame in rows if isinstance(frame, SourceFrame)]
    assert [(one.index, one.name, one.status) for one in frames] == [
        (40, "00040", "gap"),
        (41, "00041", "ok"),
        (42, "00042", "dropped"),
        (43, "00043", "ok"),
    ]
    assert [frame.pts for frame in frames] == pytest.approx([8.0, 11.0, 11.1, 11.2], abs=0.5)
    assert frames[3].pts - frames[1].pts == pytest.approx(0.2)


def test_a_new_reader_of_a_stream_that_has_not_begun_begins_without_a_gap() -> None:
    reader = reader_of(Answers(row(0, IMAGE)))
    reader.go_on(SourcePosition())
    assert asked(reader, fresh=True) == replace(row(0, IMAGE), image=None)


def test_what_the_ring_does_not_hold_any_more_is_a_gap(monkeypatch: pytest.MonkeyPatch) -> None:
    reader = reader_of(Answers(*(row(index, IMAGE) for index in range(70))))
    reader.go_on(SourcePosition())
    for _ in range(live_reader_module.MOST_PICTURES + 2):
        asked(reader, fresh=True)
    reader.go_on(SourcePosition(1, 0.0, 0.0))
    gap, fresh = asked(reader, fresh=True), asked(reader, fresh=True)
    assert isinstance(gap, SourceFrame)
    assert isinstance(fresh, SourceFrame)
    assert (gap.index, gap.status, gap.pts) == (1, "gap", 0.0)
    assert (fresh.index, fresh.status, fresh.pts) == (2, "ok", 6.6)


# The record


def label(index: int) -> Segmentation:
    flat = np.zeros((8, 8), np.uint8)
    return Segmentation(index, flat.astype(np.uint16), flat, flat.view(np.int8), (), (0.0, 0.0), 0, {})


def give(record: StreamRecord, first: int, last: int) -> int:
    committed = 0
    for index in range(first, last):
        if index % 7 == 6:
            committed = record.gap(index, index / 25, "dropped")
        else:
            committed = record.write(label(index), row(index, IMAGE))
    return committed


def live_record(folder: Path) -> StreamRecord:
    return StreamRecord(folder, "door", SAVE, live=True)


def test_of_a_live_stream_counts_what_a_snapshot_covers(tmp_path: Path) -> None:
    record = live_record(tmp_path / "door")
    assert give(record, 0, 40) == 0
    take(record, 36)
    assert recorded_frames(tmp_path / "door") == 36
    assert give(record, 40, 50) == 36 - 36 // 7
    take(record, 46)
    record.close(whole=False)
    commits = read_commits(tmp_path / "door")
    assert [(one.last, one.snapshot) for one in commits] == [(35, "0/00000036"), (45, "0/00000046")]
    assert len([*(tmp_path / "door/masks").iterdir()]) == 46 - 46 // 7
    again = live_record(tmp_path / "door")
    assert again.opening.resume_from is not None
    assert again.opening.resume_from.rows == 46
    give(again, 46, 75)
    assert again.close(whole=True) == 75 - 75 // 7
    assert recorded_frames(tmp_path / "door") == 75
    frames = ds.dataset(sorted((tmp_path / "door").glob("frames-*.parquet"))).to_table()
    assert frames["frame"].to_pylist() == list(range(75))


def test_a_live_stream_without_its_last_snapshot_keeps_what_was_committed_and_is_not_gone_on_with(
    tmp_path: Path,
) -> None:
    record = live_record(tmp_path / "door")
    give(record, 0, 70)
    take(record, 32)
    damaged = take(record, 64)
    assert has_snapshot(tmp_path / "door")
    (damaged / "two").write_bytes(b"")
    with pytest.raises(SinkError, match="last snapshot is missing or damaged"):
        live_record(tmp_path / "door")
    assert recorded_frames(tmp_path / "door") == 64


def test_a_live_stream_keeps_no_snapshot_whose_rows_are_still_on_their_way(tmp_path: Path) -> None:
    record = live_record(tmp_path / "door")
    give(record, 0, 30)
    assert record.opening.snapshots is not None
    folder = record.opening.snapshots / "00000032"
    folder.mkdir(parents=True)
    capture(SourcePosition(32)).write(folder / "one")
    snapshot = Snapshot(folder, 32, 32, ("one",))
    assert not record.keep(snapshot)
    assert recorded_frames(tmp_path / "door") == 0
    give(record, 30, 33)
    assert record.keep(snapshot)
    assert recorded_frames(tmp_path / "door") == 32


def test_of_snapshots_after_the_same_row_the_last_one_is_gone_back_to(tmp_path: Path) -> None:
    for generation, read in ((9, 43), (10, 44)):
        found = SnapshotFolder(tmp_path, generation, 40)
        folder = found.place / f"{read:08d}"
        folder.mkdir(parents=True)
        capture(SourcePosition(read)).write(folder / "one")
        assert found.keep(Snapshot(folder, 40, 40, ("one",)))
    newest = SnapshotFolder(tmp_path, 11, 40).newest
    assert newest is not None
    assert newest.folder == tmp_path / "10/00000044"


# Streams of actors


@dataclass
class OnceOnly:
    """A camera: every reading shows another picture, whichever process reads; its process may die.

    Attributes
    ----------
    folder : Path
        Holds a file for each picture that was shown.
    pictures : list of (H, W, 3) uint8
    dies_at : int
        Before this picture, once.
    gate : int
        Nothing is shown from this picture on until the folder has a file ``through``.
    """

    folder: Path
    pictures: list[Array]
    dies_at: int = -1
    gate: int = 1_000_000
    problem: str | None = None

    def opened(self) -> FrameReader:
        return self

    def read(self) -> SourceFrame | SourceSilence | None:
        number = len([*self.folder.glob("shown-*")])
        if number >= self.gate and not (self.folder / "through").exists():
            pause(0.02)
            return SourceSilence(None)
        if number >= len(self.pictures):
            return None
        if number == self.dies_at and not (self.folder / "died").exists():
            (self.folder / "died").touch()
            die()
        (self.folder / f"shown-{number}").touch()
        status: SourceStatus = "dropped" if number % 9 == 5 else "ok"
        image = self.pictures[number] if status == "ok" else None
        return SourceFrame(number, image, number / 25, f"{number:05d}", status)

    def close(self) -> None:
        pass


class NotingRecord(StreamRecord):
    """Keeps the pictures that it is given; one that comes again must be the same."""

    def write(
        self, segmentation: Segmentation, frame: SourceFrame, background: LayerAppearance | None = None
    ) -> int:
        path = self._folder.parent / "delivered" / f"{frame.index:05d}.npy"
        assert frame.image is not None
        if path.exists():
            np.testing.assert_array_equal(np.load(path), frame.image)
        np.save(path, frame.image)
        return super().write(segmentation, frame, background)


def delivered(folder: Path) -> list[Array]:
    return [np.load(path) for path in sorted((folder / "delivered").iterdir())]


def live_spec(camera: OnceOnly, folder: Path) -> StreamSpec:
    (folder / "delivered").mkdir(exist_ok=True)
    camera.folder.mkdir(exist_ok=True)
    sink = partial(NotingRecord, folder / "door", "door", SAVE, live=True)
    return StreamSpec("door", CONFIG, camera.opened, sink, snapshot_rows=8, live=True)


def shots(frames: int, dies: str = "", at: int = -1) -> list[Array]:
    return [picture(t, live=[1, 2], dies=dies if t == at else "", value=2) for t in range(frames)]


@pytest.fixture
def parts(tmp_path: Path) -> FakeParts:
    folder = tmp_path / "parts"
    folder.mkdir()
    return FakeParts(folder, deaths=1)


def drive(node: Node, spec: StreamSpec) -> StreamState:
    driver = driver_of([spec], node)
    driver.run()
    return driver.states[0]


def statuses(folder: Path) -> list[str]:
    frames = ds.dataset(sorted((folder / "door").glob("frames-*.parquet"))).to_table()
    assert frames["frame"].to_pylist() == list(range(len(frames)))
    times = frames["pts"].to_pylist()
    assert times == sorted(times)
    return list(frames["status"].to_pylist())


def expect_whole(state: StreamState, parts: FakeParts, folder: Path, shown: int, gaps: int) -> None:
    """Every picture shown is labelled as in one process that is given the same ones, or is a row."""
    told = statuses(folder)
    assert (state.state, state.gaps, told.count("gap")) == ("done", gaps, gaps), state
    assert state.read == state.committed + state.dropped == shown
    assert (told.count("ok"), told.count("dropped")) == (state.committed, state.dropped)
    given = delivered(folder)
    assert len(given) == state.committed
    assert as_rows(folder / "door") == rows_in_one_process(replace(parts, deaths=0), given)


@pytest.mark.usefixtures("host")
@pytest.mark.parametrize(
    ("dies", "at"),
    [("layer", 22), ("layer", 4), ("segmenter", 28), ("coordinator", 1), ("coordinator", 31)],
)
def test_a_live_stream_that_loses_a_process_loses_no_frame(
    parts: FakeParts, tmp_path: Path, dies: str, at: int
) -> None:
    camera = OnceOnly(tmp_path / "camera", shots(44, dies, at))
    with started(parts) as node:
        state = drive(node, live_spec(camera, tmp_path))
    assert state.returns == 1
    expect_whole(state, parts, tmp_path, shown=44, gaps=0)
    told, commits = statuses(tmp_path), read_commits(tmp_path / "door")
    assert {told[: one.last + 1].count("ok") % 8 for one in commits[:-1]} == {0}  # snapshots, not rows


@pytest.mark.usefixtures("host")
def test_a_camera_is_read_elsewhere_though_the_coordinator_is_lost_that_is_told_so(
    parts: FakeParts, tmp_path: Path
) -> None:
    here = OnceOnly(tmp_path / "camera", shots(12))
    there = OnceOnly(tmp_path / "other", shots(20))
    spec = live_spec(here, tmp_path)
    there.folder.mkdir()
    with started(parts) as node:
        stream = node.start(spec)
        while stream.advance().result().read < 8:
            pass
        end([stream._coordinator])
        stream.reopen(there.opened)
        stream.stop(drain=False, returns=True)
        again = node.start(replace(spec, open_reader=there.opened), stream)
        while not (progress := again.advance().result()).done:
            pass
        again.stop(drain=False)
    assert progress.gaps == 1
    assert 20 < progress.read <= 12 + 20


@pytest.mark.usefixtures("host")
@pytest.mark.parametrize("at", [1, 2, 4, 27])
def test_a_live_stream_that_loses_its_reader_goes_on_after_a_gap_with_all_it_was_given(
    parts: FakeParts, tmp_path: Path, at: int
) -> None:
    camera = OnceOnly(tmp_path / "camera", shots(44), dies_at=at)
    with started(parts) as node:
        state = drive(node, live_spec(camera, tmp_path))
    assert state.returns == 1
    expect_whole(state, parts, tmp_path, shown=44, gaps=1)
    assert statuses(tmp_path)[at] == "gap"


@pytest.mark.usefixtures("host")
@pytest.mark.parametrize("lost", ["pool", "sink"])
def test_a_live_stream_whose_pool_or_sink_is_lost_loses_no_frame(
    parts: FakeParts, tmp_path: Path, lost: str
) -> None:
    camera = OnceOnly(tmp_path / "camera", shots(60), gate=45)
    with started(parts) as node:

        def lose() -> None:
            wait_until(lambda: recorded_frames(tmp_path / "door") >= 16)
            end([node._pool if lost == "pool" else node._sinks[0]])
            (camera.folder / "through").touch()

        losing = threading.Thread(target=lose)
        losing.start()
        state = drive(node, live_spec(camera, tmp_path))
        losing.join()
    assert state.returns >= 1
    expect_whole(state, parts, tmp_path, shown=60, gaps=0)


@pytest.mark.usefixtures("host")
def test_a_live_stream_that_was_interrupted_goes_on_with_all_it_was_given(
    parts: FakeParts, tmp_path: Path
) -> None:
    camera = OnceOnly(tmp_path / "camera", shots(44))
    shown = []
    for bursts in (1, 2):
        with started(parts) as node:
            stream = node.start(live_spec(camera, tmp_path))
            for _ in range(bursts):
                stream.advance().result(timeout=200)
            final = stream.stop(drain=True)
            assert final is not None
            assert final.read == final.committed + final.dropped
            shown.append(len([*camera.folder.glob("shown-*")]))
            assert final.read == shown[-1]  # what was read ahead is labelled too
    with started(parts) as node:
        state = drive(node, live_spec(camera, tmp_path))
    expect_whole(state, parts, tmp_path, shown=44, gaps=2)
    told = statuses(tmp_path)
    assert [index for index, status in enumerate(told) if status == "gap"] == [shown[0], shown[1] + 1]


@pytest.mark.usefixtures("host")
def test_a_live_stream_whose_run_was_killed_goes_on_where_it_counts(parts: FakeParts, tmp_path: Path) -> None:
    camera = OnceOnly(tmp_path / "camera", shots(60))
    with started(parts) as node:
        stream = node.start(live_spec(camera, tmp_path))
        while recorded_frames(tmp_path / "door") < 16:
            stream.advance().result(timeout=200)
        stream.stop(drain=False)
    counted, shown = recorded_frames(tmp_path / "door"), len([*camera.folder.glob("shown-*")])
    assert 16 <= counted <= shown < 60
    for path in sorted((tmp_path / "delivered").iterdir()):
        if int(path.stem) >= counted:
            path.unlink()
    with started(parts) as node:
        state = drive(node, live_spec(camera, tmp_path))
    told = statuses(tmp_path)
    gap = told.index("gap")
    lost = shown - gap
    assert counted <= gap <= shown
    expect_whole(state, parts, tmp_path, shown=60 - lost, gaps=1)
