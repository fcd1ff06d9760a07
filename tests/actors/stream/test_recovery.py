"""A stream goes on where its record ends, with the same bytes: after kills, losses, hangs and damage."""

from __future__ import annotations

import itertools
import pickle
import threading
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.dataset as ds
import pytest
from actor_fakes import (
    CONFIG,
    ON_RAY,
    SHAPE,
    FakeParts,
    FakeReader,
    crowd,
    picture,
    rows_in_one_process,
    wait_until,
)
from driver_fakes import driver_of
from PIL import Image

from mlbs_actors.actors.node.pool import PoolPolicy
from mlbs_actors.actors.node.processes import end
from mlbs_actors.actors.parts import CoordinatorPart
from mlbs_actors.actors.pipeline import Node
from mlbs_actors.actors.stream.protocol import Snapshot, StreamSpec
from mlbs_actors.config import Config
from mlbs_actors.errors import SinkError
from mlbs_actors.messages import Array, FrameEvidence, LayerAppearance, LayerSummary, Region, Segmentation
from mlbs_actors.record.commits import Commit, read_commits
from mlbs_actors.source import SourceFrame
from mlbs_actors.state_file import capture
from mlbs_actors.stored_motion import StoredMotion
from orchestrator.run import driven_stream
from orchestrator.run.recovery import MOST_RETURNS, Returns
from orchestrator.run.resumption import ended_before
from orchestrator.run.run_folder import RunFolder
from orchestrator.run.status_file import StatusFile
from orchestrator.run.stream_state import StreamState
from orchestrator.sinks.record import GROUP_FRAMES, StreamRecord, ends_group, recorded_frames
from orchestrator.storage import commit_log, durable_files
from orchestrator.storage.commit_log import CommitLog

SAVE = frozenset({"masks", "parquet"})


def result(index: int) -> Segmentation:
    shape = (12, 16)
    labels = np.zeros(shape, np.uint16)
    labels[2:5, index % 10 : index % 10 + 4] = 1 + index % 3
    row = LayerSummary(1 + index % 3, "object", Region(index % 10, 2, 4, 3), 12, (1.5, 3.0), (0.0, 0.0), 0.5)
    flat = np.zeros(shape, np.uint8)
    return Segmentation(index, labels, flat, flat.view(np.int8), (row,), (0.0, 0.0), 0, {"cut": 1.0})


def frame(index: int) -> SourceFrame:
    return SourceFrame(index, np.zeros((12, 16, 3), np.uint8), index / 25, f"{index:05d}")


def give(record: StreamRecord, last: int) -> None:
    """Give the rows from where the record goes on; every seventh frame could not be decoded."""
    before = record.opening.resume_from
    for index in range(0 if before is None else before.rows, last):
        if index % 7 == 6:
            record.gap(index, index / 25, "quarantined")
        else:
            record.write(
                result(index), SourceFrame(index, np.zeros((12, 16, 3), np.uint8), index / 25, f"{index:05d}")
            )


def content(folder: Path) -> tuple[dict[str, bytes], list[list[dict[str, object]]]]:
    """All that counts: the masks, and the rows of both tables without the times."""
    masks = {path.name: path.read_bytes() for path in sorted((folder / "masks").glob("*.png"))}
    tables: list[list[dict[str, object]]] = []
    for table in ("layers", "frames"):
        parts = ds.dataset(sorted(folder.glob(f"{table}-*.parquet"))).to_table().to_pylist()
        tables.append(
            [{key: value for key, value in row.items() if not key.startswith("ms_")} for row in parts]
        )
    return masks, tables


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An undisturbed record of 75 frames."""
    folder = tmp_path_factory.mktemp("whole") / "yard"
    record = StreamRecord(folder, "yard", SAVE)
    give(record, 75)
    assert record.close(whole=True) == 65
    return folder


# ---- the record


class Killed(BaseException):
    """What no code of the record may catch."""


def test_a_record_killed_between_any_two_steps_of_a_commit_goes_on_to_the_same_content(
    tmp_path: Path, whole: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sync, rename, append = durable_files._sync, Path.replace, durable_files.append_line
    left = 0

    def step() -> None:
        nonlocal left
        left -= 1
        if left == 0:
            raise Killed

    def torn(path: Path, line: str) -> None:
        with path.open("a") as log:
            log.write(line[: len(line) // 2])
        step()
        path.write_bytes(path.read_bytes()[: -(len(line) // 2)])
        append(path, line)

    def sync_or_die(path: Path) -> None:
        step()
        sync(path)

    def rename_or_die(path: Path, to: Path) -> Path:
        step()
        return rename(path, to)

    monkeypatch.setattr(durable_files, "_sync", sync_or_die)
    monkeypatch.setattr(Path, "replace", rename_or_die)
    monkeypatch.setattr(commit_log, "append_line", torn)
    kills = 0
    for number in range(1, 200, 5):
        folder = tmp_path / f"killed-{number}"
        left = number
        try:
            record = StreamRecord(folder, "yard", SAVE)
            give(record, 75)
            record.close(whole=True)
        except Killed:
            kills += 1
        left = 0
        counted = recorded_frames(folder)
        again = StreamRecord(folder, "yard", SAVE)
        give(again, 75)
        assert again.close(whole=True) == 65
        assert content(folder) == content(whole), number
        assert counted in (0, 8, 32, 64, 75)
        commits = read_commits(folder)
        assert [(one.first, one.last) for one in commits] == [(0, 7), (8, 31), (32, 63), (64, 74)]
        assert not [*folder.rglob("*.part")]
    assert kills > 25


def test_a_record_closed_in_the_middle_goes_on_with_the_rows_it_has(tmp_path: Path, whole: Path) -> None:
    for last in (5, 40, 70):
        record = StreamRecord(tmp_path / "yard", "yard", SAVE)
        give(record, last)
        record.close(whole=False)
        assert recorded_frames(tmp_path / "yard") == last
    record = StreamRecord(tmp_path / "yard", "yard", SAVE)
    give(record, 75)
    assert record.close(whole=True) == 65
    assert content(tmp_path / "yard") == content(whole)
    assert [one.generation for one in read_commits(tmp_path / "yard")] == [0, 1, 1, 1, 2, 2, 3]


def test_provisional_label_maps_are_there_until_the_stream_goes_on(tmp_path: Path, whole: Path) -> None:
    record = StreamRecord(tmp_path / "yard", "yard", SAVE)
    give(record, 40)
    record.provisional()
    record.write(result(3), frame(40))
    record.close(whole=False)
    assert recorded_frames(tmp_path / "yard") == 41
    assert read_commits(tmp_path / "yard")[-1] == Commit(0, 40, 40, None, provisional=True)
    record = StreamRecord(tmp_path / "yard", "yard", SAVE)
    assert recorded_frames(tmp_path / "yard") == 40
    give(record, 75)
    record.close(whole=True)
    assert content(tmp_path / "yard") == content(whole)


def test_cut_outs_and_plates_of_a_resumed_record_are_those_of_a_whole_one(tmp_path: Path) -> None:
    save = frozenset({"cutouts", "background"})
    grey = np.full((12, 16, 3), 90, np.uint8)
    plain = LayerAppearance(0, 0, Region(0, 0, 16, 12), grey, np.ones((12, 16), bool))

    def give_pictures(record: StreamRecord, first: int, last: int) -> None:
        for index in range(first, last):
            record.write(result(index), frame(index), plain if ends_group(index) else None)

    def pictures(folder: Path) -> dict[str, bytes]:
        return {f"{path.parent.name}/{path.name}": path.read_bytes() for path in folder.glob("*/*.png")}

    whole = StreamRecord(tmp_path / "whole", "yard", save)
    give_pictures(whole, 0, 40)
    whole.close(whole=True)
    record = StreamRecord(tmp_path / "yard", "yard", save)
    give_pictures(record, 0, 33)
    record.provisional()
    record.write(result(34), frame(33))  # without the frames that follow it had another object
    record.close(whole=False)
    assert "cutouts/00033-2.png" in pictures(tmp_path / "yard")
    StreamRecord(tmp_path / "yard", "yard", save)  # killed before its first commit
    record = StreamRecord(tmp_path / "yard", "yard", save)
    give_pictures(record, 0, 40)
    record.close(whole=True)
    assert pictures(tmp_path / "yard") == pictures(tmp_path / "whole")
    assert sum(name.startswith("background/") for name in pictures(tmp_path / "yard")) == 2


def test_streams_that_ended_and_cameras_without_a_snapshot_are_left_as_they_are(tmp_path: Path) -> None:
    folder = RunFolder(tmp_path)
    names = ("done", "cut", "killed", "failed", "camera", "full", "saved", "new")
    specs = [
        StreamSpec(
            name,
            CONFIG,
            partial(StreamRecord, tmp_path, name, SAVE),  # type: ignore[arg-type]
            partial(StreamRecord, tmp_path, name, SAVE),
            line=line,
            live=name in ("camera", "full", "saved", "new"),
        )
        for line, name in enumerate(names, 1)
    ]
    states = [
        StreamState("done", "done", read=9, committed=9, line=7),
        StreamState("cut", "partial", read=9, committed=8, interrupted=True),
        StreamState("killed", "running", read=9, committed=8),
        StreamState("failed", "failed", read=9),
        StreamState("camera", "reconnecting", read=40, committed=8, dropped=3, gaps=1),
        StreamState("full", "done", read=32, committed=32),
        StreamState("saved", "running", read=40, committed=28, dropped=3, gaps=1),
        StreamState("new", "starting"),
    ]
    StatusFile(tmp_path / "status.json").finish(states, 1)
    for name in ("camera", "full", "saved"):
        record = StreamRecord(tmp_path / name, name, frozenset())
        for index in range(32):
            if index < 4:
                record.gap(index, index / 25, "gap" if index == 0 else "dropped")
            else:
                record.write(result(index), frame(index))
            if name == "saved" and index == 20:
                take(record, 20)
        record.close(whole=False)
    left = ended_before(folder, specs)
    assert list(left) == ["done", "camera", "full"]
    assert left["done"] == StreamState("done", "done", read=9, committed=9, line=1)
    camera = left["camera"]
    assert (camera.state, camera.read, camera.committed, camera.dropped) == ("partial", 40, 28, 3)
    assert "has no snapshot to continue from" in (camera.error or "")
    assert left["full"].state == "done"


def test_a_process_of_a_killed_run_that_lives_on_can_commit_nothing(tmp_path: Path, whole: Path) -> None:
    old = StreamRecord(tmp_path / "yard", "yard", SAVE)
    give(old, GROUP_FRAMES + 7)
    new = StreamRecord(tmp_path / "yard", "yard", SAVE)
    with pytest.raises(SinkError, match=r"cannot be written|has been started again"):
        old.close(whole=False)
    give(new, 75)
    new.close(whole=True)
    assert content(tmp_path / "yard") == content(whole)
    assert {one.generation for one in read_commits(tmp_path / "yard")} == {0, 1}


def test_a_turn_that_is_not_given_back_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(commit_log, "_LOCK_SECONDS", 0.1)
    first = CommitLog(tmp_path)
    with first.exclusive(), pytest.raises(SinkError, match="Another process is writing"):
        CommitLog(tmp_path)


def test_lines_after_a_damaged_one_do_not_count(tmp_path: Path) -> None:
    log = CommitLog(tmp_path)
    with log.exclusive():
        for last in (31, 63, 95):
            log.add(last, None, provisional=False)
    path = tmp_path / "commits.jsonl"
    lines = path.read_text().splitlines(keepends=True)
    for damaged, rows in (
        (lines[0] + "{" + lines[2], 32),
        (lines[0] + lines[2], 32),
        (lines[0] + lines[1][:-1], 32),
    ):
        path.write_text(damaged)
        assert recorded_frames(tmp_path) == rows
        assert CommitLog(tmp_path).rows == rows
        assert path.read_text() == lines[0]


# ---- snapshots in the record


@dataclass(frozen=True)
class Part:
    rows: int


def take(record: StreamRecord, rows: int) -> Path:
    """Put a snapshot after so many rows into the record's folder."""
    assert record.opening.snapshots is not None
    folder = record.opening.snapshots / f"{rows:08d}"
    folder.mkdir(parents=True)
    snapshot = Snapshot(folder, rows, rows - rows // 7, ("one", "two"))
    capture(Part(rows)).write(folder / "one")
    assert not record.keep(snapshot)
    capture(Part(rows)).write(folder / "two")
    assert record.keep(snapshot)
    return folder


def with_snapshots(folder: Path) -> list[Path]:
    """A record of 64 committed rows, and snapshots after 32, 48, 64 and 72 of the 70 it was given."""
    record = StreamRecord(folder, "yard", SAVE)
    paths = []
    for index, rows in enumerate((32, 48, 64, 72)):
        if index == 2:
            give(record, 70)
        paths.append(take(record, rows))
    return paths


def test_a_stream_goes_back_to_the_newest_snapshot_that_its_commits_reach(
    tmp_path: Path, whole: Path
) -> None:
    with_snapshots(tmp_path / "yard")
    record = StreamRecord(tmp_path / "yard", "yard", SAVE)
    assert record.opening.resume_from is not None
    assert (record.opening.resume_from.rows, record.opening.resume_from.label_maps) == (64, 55)
    give(record, 75)
    assert record.close(whole=True) == 65
    assert content(tmp_path / "yard") == content(whole)
    assert not (tmp_path / "yard/snapshots").exists()


def test_the_newest_two_snapshots_are_kept_and_a_commit_names_the_newest(tmp_path: Path) -> None:
    record = StreamRecord(tmp_path / "yard", "yard", SAVE)
    for rows in (8, 16, 24):
        take(record, rows)
    give(record, GROUP_FRAMES)
    assert [one.snapshot for one in read_commits(tmp_path / "yard")] == ["0/00000008", "0/00000024"]
    assert sorted(path.name for path in (tmp_path / "yard/snapshots/0").iterdir()) == ["00000016", "00000024"]


@pytest.mark.parametrize("damage", ["flip", "cut", "pickle", "missing", "list"])
def test_a_damaged_snapshot_is_passed_over_for_the_one_before(tmp_path: Path, damage: str) -> None:
    paths = with_snapshots(tmp_path / "yard")
    victim = paths[2] / ("parts" if damage == "list" else "two")
    data = bytearray(victim.read_bytes())
    data[len(data) // 2] ^= 4
    if damage == "missing":
        victim.unlink()
    else:
        victim.write_bytes({"cut": bytes(data[:20]), "pickle": pickle.dumps(Path)}.get(damage, bytes(data)))
    before = StreamRecord(tmp_path / "yard", "yard", SAVE).opening.resume_from
    assert before is not None
    assert before.rows == 48


def test_without_a_whole_snapshot_a_stream_goes_back_to_its_start(tmp_path: Path, whole: Path) -> None:
    for path in with_snapshots(tmp_path / "yard"):
        (path / "one").unlink()
    record = StreamRecord(tmp_path / "yard", "yard", SAVE)
    assert record.opening.resume_from is None
    give(record, 75)
    assert record.close(whole=True) == 65
    assert content(tmp_path / "yard") == content(whole)


# ---- how often


def test_a_stream_goes_back_as_often_as_it_gets_on_and_a_few_times_in_vain() -> None:
    returns = Returns()
    for committed in range(32, 3200, 32):
        after = returns.after_loss(committed)
        assert after is not None
        returns = after
        assert not returns.last_try
    for number in range(1, MOST_RETURNS):
        after = returns.after_loss(committed)
        assert after is not None
        returns = after
        assert returns.last_try == (number == MOST_RETURNS - 1)
    assert returns.after_loss(committed) is None


# ---- streams of actors


@pytest.fixture
def parts(tmp_path: Path) -> FakeParts:
    folder = tmp_path / "parts"
    folder.mkdir()
    return FakeParts(folder, deaths=1)


@contextmanager
def started(parts: FakeParts) -> Iterator[Node]:
    node = Node(parts=parts, policy=PoolPolicy(spare=1, idle_seconds=0.5))
    yield node
    node.close()


def spec(name: str, reader: FakeReader, folder: Path, snapshot_rows: int = 4) -> StreamSpec:
    reader.folder.mkdir(parents=True, exist_ok=True)
    open_sink = partial(StreamRecord, folder / name, name, frozenset({"masks"}))
    return StreamSpec(
        name, CONFIG, reader.opened, open_sink, snapshot_rows=snapshot_rows, snapshot_seconds=0.0
    )


def drive(node: Node, *specs: StreamSpec) -> dict[str, StreamState]:
    driver = driver_of(specs, node, at_once=4)
    driver.run()
    return {state.name: state for state in driver.states}


def label_maps(folder: Path) -> list[Array]:
    return [np.asarray(Image.open(path)) for path in sorted((folder / "masks").glob("*.png"))]


def expected(parts: FakeParts, pictures: list[Array]) -> list[str]:
    """The rows of the same stream in one process, with nobody dying."""
    return rows_in_one_process(replace(parts, deaths=0), pictures)


def as_rows(folder: Path) -> list[str]:

    return [
        f"{t} {t} {zlib.crc32(labels.astype(np.uint16).tobytes())}"
        for t, labels in enumerate(label_maps(folder))
    ]


def fatal(frames: int, at: int, dies: str) -> list[Array]:
    return [picture(t, live=[1, 2], dies=dies if t == at else "", value=2) for t in range(frames)]


@pytest.mark.parametrize(
    ("host", "dies", "at"),
    [
        ("threads", "layer", 37),
        ("threads", "segmenter", 21),
        ("threads", "coordinator", 2),
        pytest.param("ray", "layer", 37, marks=(*ON_RAY, pytest.mark.long)),
        pytest.param("ray", "segmenter", 21, marks=(*ON_RAY, pytest.mark.long)),
        pytest.param("ray", "coordinator", 2, marks=(*ON_RAY, pytest.mark.long)),
    ],
    indirect=["host"],
)
def test_a_stream_that_loses_a_process_goes_on_with_the_same_bytes_and_the_others_are_untouched(
    host: str, parts: FakeParts, tmp_path: Path, dies: str, at: int
) -> None:
    pictures = fatal(44, at, dies)
    with started(parts) as node:
        states = drive(
            node,
            spec("bad", FakeReader([*pictures], tmp_path / "r1"), tmp_path),
            spec("good", FakeReader([*crowd(30, 2)], tmp_path / "r2"), tmp_path),
        )
    assert {name: (one.state, one.committed, one.returns) for name, one in states.items()} == {
        "bad": ("done", 44, 1),
        "good": ("done", 30, 0),
    }
    assert as_rows(tmp_path / "bad") == expected(parts, pictures)
    assert as_rows(tmp_path / "good") == expected(parts, crowd(30, 2))
    commits = read_commits(tmp_path / "bad")
    assert commits[-1].last == 43
    if at > 32:
        assert commits[1].snapshot is not None
    assert label_maps(tmp_path / "bad")[0].shape == SHAPE
    assert not (tmp_path / "bad/snapshots").exists()


@pytest.mark.usefixtures("host")
def test_layers_that_have_no_process_yet_are_in_the_snapshots_too(parts: FakeParts, tmp_path: Path) -> None:
    pictures = [picture(t) for t in range(4)] + fatal(44, 37, "segmenter")[4:]
    only_the_background = replace(parts, hanging_starts=range(1, 1000))
    node = Node(parts=only_the_background, policy=PoolPolicy(spare=0))
    states = drive(node, spec("crowded", FakeReader([*pictures], tmp_path / "r"), tmp_path))
    assert (states["crowded"].committed, states["crowded"].returns) == (44, 1)
    assert as_rows(tmp_path / "crowded") == expected(parts, pictures)
    assert read_commits(tmp_path / "crowded")[1].snapshot is not None
    assert node.census().busy == 0
    node.close()


@dataclass(frozen=True)
class FollowingParts(FakeParts):
    """Notes at each frame which frames' stored motion could be asked for."""

    def coordinator(
        self, config: Config, ignored: Array | None = None, motion: StoredMotion | None = None
    ) -> CoordinatorPart:
        assert motion is not None
        part = super().coordinator(config, ignored, motion)
        step = part.step

        def noted(frame_index: int, *given: Any) -> list[FrameEvidence]:
            stems = " ".join(one.stem for one in motion.followed)
            with (self.folder / "followed").open("a") as lines:
                lines.write(f"{frame_index}: {stems}\n")
            return step(frame_index, *given)

        part.step = noted  # type: ignore[method-assign, assignment]
        return part


@pytest.mark.usefixtures("host")
def test_a_stream_with_stored_motion_goes_on_with_the_frames_that_it_followed_before(
    parts: FakeParts, tmp_path: Path
) -> None:
    for way in ("forward", "backward"):
        (tmp_path / "flow" / way / "bad").mkdir(parents=True)
    with started(FollowingParts(parts.folder, deaths=1)) as node:
        bad = spec("bad", FakeReader([*fatal(44, 37, "coordinator")], tmp_path / "r"), tmp_path)
        states = drive(node, replace(bad, motion=StoredMotion("bad", tmp_path / "flow")))
    assert (states["bad"].committed, states["bad"].returns) == (44, 1)
    noted = [line.partition(": ") for line in (parts.folder / "followed").read_text().splitlines()]
    indices = [int(index) for index, _, _ in noted]
    assert any(later <= earlier for earlier, later in itertools.pairwise(indices))  # it went back
    for index, _, stems in noted:
        assert stems.split() == [f"{one:05d}" for one in range(int(index) + 1)]


@pytest.mark.usefixtures("host")
def test_snapshots_of_a_quick_stream_wait_for_their_time(parts: FakeParts, tmp_path: Path) -> None:
    never_dies = replace(parts, deaths=0)
    named = {}
    with started(never_dies) as node:
        for name, seconds in (("hourly", 3600.0), ("always", 0.0)):
            one = replace(
                spec(name, FakeReader([*crowd(100, 0)], tmp_path / f"r {name}"), tmp_path),
                snapshot_seconds=seconds,
            )
            assert drive(node, one)[name].committed == 100
            named[name] = {commit.snapshot for commit in read_commits(tmp_path / name)} - {None}
    assert len(named["hourly"]) == 1
    assert len(named["always"]) > 1


@pytest.mark.usefixtures("host")
def test_a_part_that_dies_at_the_same_frame_every_time_fails_its_stream_after_a_few_returns(
    parts: FakeParts, tmp_path: Path
) -> None:
    pictures = fatal(30, 11, "segmenter")
    always = replace(parts, deaths=1000)
    with started(always) as node:
        states = drive(node, spec("bad", FakeReader([*pictures], tmp_path / "r"), tmp_path))
    assert states["bad"].state == "failed"
    assert "lost the process of its segmenter" in (states["bad"].error or "")
    # Each frame that a try has committed beyond the last one makes the count begin anew.
    assert MOST_RETURNS <= states["bad"].returns <= 11 * MOST_RETURNS
    assert as_rows(tmp_path / "bad") == expected(parts, pictures)[:11]


@pytest.mark.usefixtures("host")
def test_a_reader_that_dies_at_the_same_frame_every_time_ends_its_stream_with_the_frames_before(
    parts: FakeParts, tmp_path: Path
) -> None:
    pictures = crowd(30, 2)
    reader = FakeReader([*pictures], tmp_path / "r", dies_at=13)
    with started(parts) as node:
        states = drive(node, spec("cut", reader, tmp_path))
    assert (states["cut"].state, states["cut"].committed) == ("partial", 13)
    assert "died after 13 frames" in (states["cut"].error or "")
    assert as_rows(tmp_path / "cut") == expected(parts, pictures[:13])


@pytest.mark.long
@pytest.mark.usefixtures("host")
def test_a_part_that_hangs_is_taken_for_lost(
    parts: FakeParts, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(driven_stream, "STALL_SECONDS", 15.0)
    pictures = fatal(30, 19, "layer")
    with started(replace(parts, hang=True)) as node:
        states = drive(node, spec("slow", FakeReader([*pictures], tmp_path / "r"), tmp_path))
    assert (states["slow"].state, states["slow"].committed) == ("done", 30)
    assert states["slow"].returns >= 1
    assert as_rows(tmp_path / "slow") == expected(parts, pictures)


@pytest.mark.usefixtures("host")
@pytest.mark.parametrize("role", ["pool", "sink"])
def test_a_lost_pool_or_sink_takes_every_stream_back_and_all_go_on(
    parts: FakeParts, tmp_path: Path, role: str
) -> None:
    pictures = [picture(t, live=[1, 2]) for t in range(60)]
    readers = {name: FakeReader([*pictures], tmp_path / f"r-{name}", gates=range(45, 46)) for name in "ab"}
    with started(parts) as node:

        def lose() -> None:
            wait_until(lambda: all(recorded_frames(tmp_path / name) >= 32 for name in "ab"))
            end([node._pool if role == "pool" else node._sinks[0]])
            for reader in readers.values():
                reader.let_through(45)

        losing = threading.Thread(target=lose)
        losing.start()
        states = drive(node, *(spec(name, reader, tmp_path) for name, reader in readers.items()))
        losing.join()
    assert {(one.state, one.committed) for one in states.values()} == {("done", 60)}
    assert all(one.returns for one in states.values())
    for name in "ab":
        assert as_rows(tmp_path / name) == expected(parts, pictures)


@pytest.mark.usefixtures("host")
def test_the_label_maps_of_all_starts_are_counted_together(parts: FakeParts, tmp_path: Path) -> None:
    pictures = [picture(t, live=[1]) for t in range(200)]
    given: list[Array | None] = [*pictures]
    for number in range(0, 300, 3):
        given.insert(number, None)
    one = replace(spec("stopped", FakeReader(given, tmp_path / "r"), tmp_path), max_frames=150)
    with started(parts) as node:
        stream = node.start(one)
        while stream.advance().result(timeout=200).committed < 40:
            continue
        stream.stop(drain=True)
        interrupted = node.start(one).stop(drain=True)  # before it has read on
        state = drive(node, one)["stopped"]
    assert interrupted is not None
    assert 0 < interrupted.committed < 150
    assert (state.committed, state.quarantined, state.length) == (150, 75, 225)
    assert as_rows(tmp_path / "stopped") == expected(parts, pictures[:150])


@pytest.mark.usefixtures("host")
def test_a_stream_that_has_more_label_maps_than_are_wanted_by_now_reads_no_more(
    parts: FakeParts, tmp_path: Path
) -> None:
    pictures: list[Array | None] = [picture(t, live=[1]) for t in range(200)]
    one = spec("stopped", FakeReader(pictures, tmp_path / "r"), tmp_path)
    with started(parts) as node:
        stream = node.start(one)
        while stream.advance().result(timeout=200).committed < 40:
            continue
        interrupted = stream.stop(drain=True)
        state = drive(node, replace(one, max_frames=20))["stopped"]
    assert interrupted is not None
    assert 40 <= interrupted.committed < 200
    # It may be fewer: of the last ones, those that were labelled early are read again or not at all.
    assert state.state == "done"
    assert 20 <= state.committed <= interrupted.committed


@pytest.mark.usefixtures("host")
def test_a_drained_stream_goes_on_where_it_was_interrupted_though_frames_were_held(
    parts: FakeParts, tmp_path: Path
) -> None:
    pictures = crowd(40, 3)
    with started(parts) as node:
        for _ in range(3):
            stream = node.start(spec("stopped", FakeReader([*pictures], tmp_path / "r"), tmp_path))
            stream.advance().result(timeout=200)
            final = stream.stop(drain=True)
            assert final is not None
        states = drive(node, spec("stopped", FakeReader([*pictures], tmp_path / "r"), tmp_path))
    assert (states["stopped"].state, states["stopped"].committed) == ("done", 40)
    assert as_rows(tmp_path / "stopped") == expected(parts, pictures)
    # What the starts between them read was committed before, unless a snapshot was there to go on from.
    generations = [one.generation for one in read_commits(tmp_path / "stopped")]
    assert (generations[0], generations[-1]) == (0, 3)
    assert generations == sorted(generations)
