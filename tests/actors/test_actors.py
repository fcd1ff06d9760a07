"""A stream as actors: the same bytes as in one process, and failures that stay where they are."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import zlib
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import Future
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest
from actor_fakes import (
    CONFIG,
    FakeCamera,
    FakeParts,
    FakeReader,
    FakeSink,
    RaySession,
    crowd,
    is_running,
    on_ray,
    picture,
    rows,
    rows_in_one_process,
    run_to_end,
    spec,
    wait_until,
)

from mlbs_actors import Config, MultilayerSubtractor
from mlbs_actors.actors import pipeline
from mlbs_actors.actors.ipc.shared_memory import Slot, SlotKind, SlotPool
from mlbs_actors.actors.node.burst_limiter import BurstLimiter
from mlbs_actors.actors.node.pool import PoolPolicy
from mlbs_actors.actors.node.processes import end, get, here, spawn
from mlbs_actors.actors.parts import CoordinatorPart
from mlbs_actors.actors.pipeline import Node
from mlbs_actors.actors.stream.messages import GapRow
from mlbs_actors.actors.stream.order import FrameOrder
from mlbs_actors.actors.stream.protocol import RunningStream, StreamProgress
from mlbs_actors.actors.stream.sink import SinkActor
from mlbs_actors.errors import ActorLostError, LayerError, SinkError, SourceError
from mlbs_actors.messages import Array
from mlbs_actors.scenes.synthetic import scene
from mlbs_actors.source import SourceFrame, SourceSilence, SourceStatus
from mlbs_actors.stored_motion import StoredMotion

# ---- the same bytes


def test_layers_born_dormant_and_retired_while_running_give_the_same_bytes_as_in_one_process(
    node: Node, parts: FakeParts, tmp_path: Path
) -> None:
    pictures = crowd(30, most=5)
    [progress] = run_to_end(node.start(spec("crowd", FakeReader([*pictures], tmp_path))))
    assert rows(tmp_path) == rows_in_one_process(parts, pictures)
    counted = replace(progress, cpu_seconds=0.0, memory=0)
    assert counted == StreamProgress(30, 30, 0, 0, 0, True, None, progress.stage_ms, length=30)


def test_layers_that_get_no_process_live_in_the_segmenter_s_with_the_same_bytes(
    host: str, parts: FakeParts, tmp_path: Path
) -> None:
    only_the_background = FakeParts(parts.folder, hanging_starts=range(1, 1000))
    node = Node(parts=only_the_background, policy=PoolPolicy(spare=0))
    pictures = [picture(t) for t in range(4)] + crowd(30, most=5)
    run_to_end(node.start(spec("crowd", FakeReader([*pictures], tmp_path))))
    assert rows(tmp_path) == rows_in_one_process(parts, pictures)
    node.close()


def test_a_layer_moves_to_a_process_of_its_own_as_soon_as_there_is_one_with_the_same_bytes(
    host: str, parts: FakeParts, tmp_path: Path
) -> None:
    late = replace(parts, hanging_starts=range(1, 4))
    node = Node(parts=late, policy=PoolPolicy(spare=0))
    pictures = [picture(t) for t in range(4)] + [picture(t, live=[1, 2, 3]) for t in range(4, 120)]
    stream = node.start(spec("three", FakeReader([*pictures], tmp_path)))
    read = _read_on(stream, 8)
    wait_until(partial(_has_busy, node, 1))
    assert node.census().busy == 1
    late.let_start()
    for busy in (2, 3, 4):  # a process is asked for when the one before has its layer
        wait_until(partial(_has_busy, node, busy))
        read = _read_on(stream, read + 8)
    assert node.census().busy == 4
    final = stream.stop(drain=True)
    assert final is not None
    assert rows(tmp_path) == rows_in_one_process(parts, pictures[: final.read])
    node.close()


def _has_busy(node: Node, least: int) -> bool:
    return node.census().busy >= least


def _read_on(stream: RunningStream, frames: int) -> int:
    """Go on with a stream that has more frames until it has read so many; return how many it has."""
    while (progress := stream.advance().result(timeout=200)).read < frames:
        assert not progress.done
    assert not progress.done
    return progress.read


def test_the_sink_gets_the_background_s_memory_of_just_the_frames_it_wants(
    node: Node, tmp_path: Path
) -> None:
    pictures: list[Array | None] = [*crowd(20, 2)]
    pictures[9] = None  # from here on the engine's frames are counted apart from the source's
    asked = replace(spec("plates", FakeReader(pictures, tmp_path)), wants_background=_seventh)
    run_to_end(node.start(asked))
    # source index, layer, the engine's frame index: each is asked for after its own frame
    assert (tmp_path / "backgrounds").read_text().splitlines() == ["6 0 6", "13 0 12"]


def _seventh(index: int) -> bool:
    return index % 7 == 6


def test_streams_at_once_and_a_video_twice_give_the_bytes_each_gives_in_one_process(
    node: Node, parts: FakeParts, tmp_path: Path
) -> None:
    videos = {"a": crowd(20, 2), "b": crowd(25, 1), "a again": crowd(20, 2)}
    run_to_end(
        *[node.start(spec(name, FakeReader([*video], tmp_path / name))) for name, video in videos.items()]
    )
    for name, video in videos.items():
        assert rows(tmp_path / name) == rows_in_one_process(parts, video)


def test_a_stream_shorter_than_its_start_still_gets_every_label_map(
    node: Node, parts: FakeParts, tmp_path: Path
) -> None:
    pictures = crowd(2, 0)
    assert len(pictures) < CONFIG.layers.init_frames
    [progress] = run_to_end(node.start(spec("short", FakeReader([*pictures], tmp_path))))
    assert rows(tmp_path) == rows_in_one_process(parts, pictures)
    assert progress.committed == 2


def test_an_undecodable_frame_is_a_row_in_its_place_and_the_others_are_labelled_as_if_it_were_not_there(
    node: Node, parts: FakeParts, tmp_path: Path
) -> None:
    pictures = crowd(12, 2)
    given = [*pictures[:1], None, *pictures[1:6], None, None, *pictures[6:], None]
    [progress] = run_to_end(node.start(spec("gaps", FakeReader(given, tmp_path))))
    labelled = iter(row.partition(" ")[2] for row in rows_in_one_process(parts, pictures))
    expected = [
        f"{index} {'quarantined' if image is None else next(labelled)}" for index, image in enumerate(given)
    ]
    assert rows(tmp_path) == expected
    assert (progress.read, progress.committed, progress.quarantined) == (16, 12, 4)


def test_drops_and_gaps_are_rows_and_counted_and_a_silent_camera_is_told_at_once(
    node: Node, parts: FakeParts, tmp_path: Path
) -> None:
    pictures = crowd(12, 2)
    answers: list[SourceFrame | SourceSilence] = []
    given, expected = [], []
    statuses: dict[int, SourceStatus] = {2: "dropped", 5: "gap", 6: "dropped"}
    for t, image in enumerate(pictures):
        if t in (0, 5):
            answers.append(SourceSilence("stalled" if t else "reconnecting", f"quiet before {t}"))
        status = statuses.get(t, "ok")
        answers.append(SourceFrame(t, image if status == "ok" else None, t / 25, f"{t:05d}", status))
        given += [image] if status == "ok" else []
    stream = node.start(spec("camera", FakeCamera(answers, tmp_path), max_frames=8))
    said = []
    while not (progress := stream.advance().result(timeout=200)).done:
        if progress.silence is not None:
            said.append((progress.read, progress.silence.state))
    stream.stop(drain=False)
    assert said == [(0, "reconnecting"), (5, "stalled")]
    assert (progress.read, progress.committed, progress.dropped, progress.gaps) == (10, 8, 2, 1)
    plain = rows_in_one_process(parts, given[:8])
    for t in range(11):
        labelled = t not in statuses
        expected.append(f"{t} {plain.pop(0).partition(' ')[2]}" if labelled else f"{t} {statuses[t]}")
    assert rows(tmp_path) == expected


class _OverwritingParts(FakeParts):
    """Whoever reads a message after its memory was given back reads something else."""

    def coordinator(
        self, config: Config, ignored: Array | None = None, motion: StoredMotion | None = None
    ) -> CoordinatorPart:
        release = SlotPool.release

        def overwritten(self: SlotPool, slots: Sequence[Slot]) -> None:
            for slot in slots:
                os.pwrite(slot.descriptor, b"\xa5" * os.fstat(slot.descriptor).st_size, 0)
            release(self, slots)

        SlotPool.release = overwritten  # type: ignore[method-assign]  # in the coordinator's process
        return super().coordinator(config, ignored, motion)


def test_messages_are_read_before_their_memory_is_given_back_also_by_a_stream_that_waits_for_its_camera(
    host: str, parts: FakeParts, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(SlotPool, "release", SlotPool.release)  # a thread's patch is undone
    pictures = crowd(16, 2)
    answers: list[SourceFrame | SourceSilence] = []
    for t, image in enumerate(pictures):
        # Until the next picture comes everything that was asked for has been answered.
        answers += [SourceFrame(t, image, t / 25, f"{t:05d}"), *[SourceSilence(None)] * 12]
    node = Node(parts=_OverwritingParts(parts.folder), policy=PoolPolicy(spare=1))
    run_to_end(node.start(spec("camera", FakeCamera(answers, tmp_path))))
    node.close()
    assert rows(tmp_path) == rows_in_one_process(parts, pictures)


class _RecordingParts(FakeParts):
    """Each acquired slot is a line in a file."""

    def coordinator(
        self, config: Config, ignored: Array | None = None, motion: StoredMotion | None = None
    ) -> CoordinatorPart:
        acquire, lines = SlotPool.acquire, self.folder / "acquired"

        def noted(self: SlotPool, kind: SlotKind) -> Slot:
            slot = acquire(self, kind)
            with lines.open("a") as acquired:
                acquired.write(f"{kind} {slot.descriptor}\n")
            return slot

        SlotPool.acquire = noted  # type: ignore[method-assign]  # in the coordinator's process
        return super().coordinator(config, ignored, motion)


def test_what_only_segmenter_and_layers_read_stays_in_few_slots_however_slow_the_sink_is(
    host: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(SlotPool, "acquire", SlotPool.acquire)  # a thread's patch is undone
    node = Node(parts=_RecordingParts(tmp_path), policy=PoolPolicy(spare=1))
    pictures = [picture(t, live=[1, 2]) for t in range(40)]
    run_to_end(
        node.start(spec("slow", FakeReader([*pictures], tmp_path), FakeSink(tmp_path, slow_seconds=0.02)))
    )
    node.close()
    acquired = set((tmp_path / "acquired").read_text().splitlines())
    slots = Counter(line.partition(" ")[0] for line in acquired)
    frames = 4  # at most three under way, and the one before
    assert slots["evidence"] <= frames
    assert slots["posterior"] <= frames * 3
    assert slots["frame"] > frames


def test_a_stream_ends_after_its_most_label_maps_however_many_frames_have_none(
    node: Node, tmp_path: Path
) -> None:
    pictures = crowd(30, 1)
    reader = FakeReader([None, *pictures[:4], None, None, *pictures[4:6], None, *pictures[6:]], tmp_path)
    [progress] = run_to_end(node.start(spec("most", reader, max_frames=7)))
    assert (progress.committed, progress.quarantined, progress.read) == (7, 4, 11)
    assert (progress.length, len(rows(tmp_path))) == (11, 11)
    assert len((tmp_path / "reads").read_text().splitlines()) == 11


# ---- bounded


@pytest.mark.parametrize("slow", ["sink", "layers"])
def test_the_reader_is_held_back_to_the_pace_of_the_slowest(
    host: str, tmp_path: Path, parts: FakeParts, slow: str
) -> None:
    # So slow that the sink keeps up, also on a machine that is busy with other tests.
    layers = FakeParts(parts.folder, slow_seconds=0.1 if slow == "layers" else 0.0)
    node = Node(parts=layers, policy=PoolPolicy(spare=0))
    reader = FakeReader([*crowd(60, 0)], tmp_path)
    sink_seconds = 0.03 if slow == "sink" else 0.0
    run_to_end(node.start(spec(slow, reader, FakeSink(tmp_path, slow_seconds=sink_seconds))))
    node.close()
    ahead = [int(frames) for frames in (tmp_path / "ahead").read_text().split()]
    # 6 reads under way, 1 in hand and 1 being written; between them 14 rows, or 2 frames in the layers and 7
    # that wait for an eighth to be written with.
    assert 3 <= max(ahead) <= (22 if slow == "sink" else 17)


def test_a_burst_ends_where_its_file_is_slow(node: Node, parts: FakeParts, tmp_path: Path) -> None:
    pictures = crowd(12, 1)  # of which a burst takes eight
    # It waits for the first ones in any case.
    reader = FakeReader([*pictures], tmp_path, gates=range(6, 12))
    stream = node.start(spec("slow", reader))
    bursts = 1
    while not stream.advance().result(timeout=200).done:
        reader.let_through(5 + bursts)
        bursts += 1
    stream.stop(drain=False)
    assert bursts >= 7
    assert rows(tmp_path) == rows_in_one_process(parts, pictures)


@on_ray
def test_frames_that_are_done_leave_the_object_store(
    node: Node, tmp_path: Path, ray_session: RaySession
) -> None:
    enlarged = 900
    frames = 2 * ray_session.object_store_bytes // (picture(0).nbytes * enlarged)
    reader = FakeReader([picture(t, live=[1]) for t in range(frames)], tmp_path, enlarged=enlarged)
    stream = node.start(spec("big", reader))
    while not stream.advance().result(timeout=200).done:
        # What is forgotten fills the store, and a full one is moved to disk.
        assert not [*ray_session.folder.glob("ray_spilled_objects*/*")]
    stream.stop(drain=False)


# ---- failures


def test_a_lost_process_fails_its_stream_alone_and_what_was_labelled_before_stays(
    node: Node, parts: FakeParts, tmp_path: Path
) -> None:
    pictures = [picture(t, live=[2]) for t in range(16)]
    expected = rows_in_one_process(parts, pictures)
    bad = {}
    for dies in ("layer", "segmenter", "coordinator"):
        fatal = [*pictures[:9], picture(9, live=[2], dies=dies, value=2), *pictures[10:]]
        held = CONFIG.layers.init_frames
        gates = range(held, held + 2) if dies == "layer" else range(0)
        reader = FakeReader([*fatal], tmp_path / dies, gates=gates)
        bad[dies] = node.start(spec(dies, reader))
        for processes, frame in enumerate(gates, start=1):  # the background's, and the layer's
            burst = bad[dies].advance()
            wait_until(lambda least=processes: node.census().busy >= least)  # type: ignore[misc]
            reader.let_through(frame)
            burst.exception(timeout=200)  # it may get as far as that
    good = node.start(spec("good", FakeReader([*pictures], tmp_path / "good")))
    for dies, stream in bad.items():
        lost = "layer 2" if dies == "layer" else dies
        with pytest.raises(ActorLostError, match=f"'{dies}' lost the process of its {lost}"):
            run_to_end(stream)
        assert stream.stop(drain=True) is None
        before = rows(tmp_path / dies)
        assert before == expected[: len(before)]
        assert len(before) == 9 or dies == "coordinator"
    [progress] = run_to_end(good)
    assert rows(tmp_path / "good") == expected
    assert progress.committed == 16
    assert node.census().busy == 0


@pytest.mark.long
@on_ray
def test_a_stream_whose_segmenter_dies_before_it_begins_says_so(
    own_node: Node, parts: FakeParts, tmp_path: Path
) -> None:
    wait_until(own_node.prepare)
    segmenters = [
        pid for pid in parts.processes() if b"SegmenterActor" in Path(f"/proc/{pid}/cmdline").read_bytes()
    ]
    for pid in segmenters:
        os.kill(pid, signal.SIGKILL)
    stream = own_node.start(spec("bad", FakeReader([*crowd(9, 1)], tmp_path)))
    with pytest.raises(ActorLostError, match="'bad' lost the process of its segmenter"):
        stream.advance().result(timeout=200)
    stream.stop(drain=False)


def test_at_the_last_try_the_death_of_the_reader_ends_the_stream_with_its_frames_committed(
    node: Node, tmp_path: Path
) -> None:
    reader = FakeReader([*crowd(20, 2)], tmp_path, dies_at=10)
    damaged = replace(spec("damaged", reader), source="/films/damaged.mp4", last_try=True)
    [progress] = run_to_end(node.start(damaged))
    assert progress.problem is not None
    assert "process that reads /films/damaged.mp4 died after 10 frames" in progress.problem
    assert (progress.read, progress.committed, len(rows(tmp_path))) == (10, 10, 10)


def test_the_reader_s_own_problem_is_told_at_the_end(node: Node, tmp_path: Path) -> None:
    reader = FakeReader([*crowd(5, 1)], tmp_path, problem="The file ends in the middle of a frame.")
    [progress] = run_to_end(node.start(spec("cut", reader)))
    assert progress.problem == "The file ends in the middle of a frame."
    assert progress.committed == 5


@pytest.mark.parametrize(
    ("reader", "says"),
    [
        (FakeReader([], Path(), raises_at=0), "is not to be had"),
        (FakeReader([], Path(), dies_at=0), "died before its first frame"),
    ],
)
def test_a_source_that_gives_no_frame_fails_the_stream(
    node: Node, tmp_path: Path, reader: FakeReader, says: str
) -> None:
    stream = node.start(replace(spec("none", replace(reader, folder=tmp_path)), last_try=True))
    for _ in range(2):
        with pytest.raises(SourceError, match=says):
            stream.advance().result(timeout=200)
    stream.stop(drain=True)


def test_a_row_that_cannot_be_written_fails_the_stream_and_none_is_written_after_it(
    node: Node, tmp_path: Path
) -> None:
    stream = node.start(spec("full", FakeReader([*crowd(20, 1)], tmp_path), FakeSink(tmp_path, fails_at=6)))
    with pytest.raises(SinkError, match="disk is full"):
        run_to_end(stream)
    stream.stop(drain=False)
    assert [row.split()[0] for row in rows(tmp_path)] == ["0", "1", "2", "3", "4", "5"]
    assert (tmp_path / "sink-closed").exists()


def test_the_death_of_the_sink_process_is_told(own_node: Node, tmp_path: Path) -> None:
    stream = own_node.start(
        spec("lost", FakeReader([*crowd(12, 1)], tmp_path), FakeSink(tmp_path, dies_at=6))
    )
    with pytest.raises(ActorLostError, match="lost the process of its sink"):
        run_to_end(stream)
    stream.stop(drain=False)


# ---- stopping


def test_a_drained_stop_labels_and_commits_exactly_what_was_read(
    node: Node, parts: FakeParts, tmp_path: Path
) -> None:
    pictures = crowd(100, 2)
    stream = node.start(spec("stopped", FakeReader([*pictures], tmp_path)))
    read = stream.advance().result(timeout=200).read
    final = stream.stop(drain=True)
    assert final is not None
    assert final.done
    assert final.read == final.committed == read < 100
    assert rows(tmp_path) == rows_in_one_process(parts, pictures[:read])
    assert stream.stop(drain=True) == final


def test_a_stream_that_waits_for_its_turn_goes_on_with_it_and_can_be_drained_before(
    node: Node, parts: FakeParts, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    limiter, held = BurstLimiter(1, 600.0), Future[None]()
    limiter.submit(lambda: held)
    monkeypatch.setattr(node, "_home", replace(node._home, burst_limiter=limiter))
    pictures = crowd(100, 2)
    started = [
        node.start(spec(name, FakeReader([*pictures], tmp_path / name))) for name in ("drained", "goes on")
    ]
    first = [_advanced_until_it_takes_turns(stream) for stream in started]
    waiting = [stream.advance() for stream in started]
    final = started[0].stop(drain=True)
    assert final is not None
    assert final.done
    assert rows(tmp_path / "drained") == rows_in_one_process(parts, pictures[: final.read])
    assert not waiting[1].done()
    held.set_result(None)
    assert waiting[1].result(timeout=200).read > first[1].read
    run_to_end(started[1])
    assert rows(tmp_path / "goes on") == rows_in_one_process(parts, pictures)


def _advanced_until_it_takes_turns(stream: RunningStream) -> StreamProgress:
    """The first burst takes no turn, nor does one after a burst that had to wait for its source."""
    while (progress := stream.advance().result(timeout=200)).kept_waiting:
        continue
    assert not progress.done
    return progress


@on_ray
def test_stopping_and_closing_leaves_no_process(
    host: str, parts: FakeParts, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pipeline, "_CLOSE_SECONDS", 100.0)
    node = Node(parts=parts, policy=PoolPolicy(spare=2))
    stream = node.start(spec("gone", FakeReader([*crowd(60, 3)], tmp_path)))
    stream.advance().result(timeout=200)
    wait_until(lambda: len(parts.processes()) >= 3)  # coordinator, segmenter and the first layer's
    stream.advance()
    stream.stop(drain=False)
    stream.stop(drain=False)
    assert (tmp_path / "sink-closed").exists()
    assert (tmp_path / "reader-closed").exists()
    node.close()
    node.close()
    wait_until(lambda: not any(is_running(process) for process in parts.processes()))


# ---- once and in order


def test_a_frame_is_done_once_in_order_and_not_after_one_that_failed() -> None:
    order = FrameOrder()
    with order.step(0, after=-1):
        pass
    for frame, after in ((0, -1), (2, 1)):
        with pytest.raises(LayerError, match="frame 0 was last"), order.step(frame, after=after):
            raise AssertionError("the work must not start")
    with pytest.raises(ZeroDivisionError), order.step(1, after=0):
        _ = 1 // 0
    for after in (0, 1):
        with (
            pytest.raises(LayerError, match="a frame that failed was last"),
            order.step(after + 1, after=after),
        ):
            raise AssertionError("the work must not start")


def test_a_record_takes_no_row_after_one_that_was_lost_on_its_way(host: str, tmp_path: Path) -> None:
    (tmp_path / "reads").touch()
    sink = spawn(SinkActor, node=here())
    get(sink.open.remote(1, FakeSink(tmp_path).opened))
    get(sink.take.remote(1, [GapRow(0, 0.0, "quarantined")]))
    with pytest.raises(LayerError, match="frame 0 was last"):
        get(sink.take.remote(1, [GapRow(2, 0.08, "quarantined")]))
    get(sink.take.remote(1, [GapRow(1, 0.04, "quarantined")]))
    assert rows(tmp_path) == ["0 quarantined", "1 quarantined"]
    end([sink])


@pytest.mark.parametrize("is_open", [True, False])
def test_a_record_follows_other_settings_even_if_they_come_before_it_is_open(
    host: str, tmp_path: Path, is_open: bool
) -> None:
    (tmp_path / "reads").touch()
    sink = spawn(SinkActor, node=here())
    calls = [sink.open.remote(1, FakeSink(tmp_path).opened)] if is_open else []
    calls.append(sink.configure.remote(1, "others"))
    if not is_open:
        calls.append(sink.open.remote(1, FakeSink(tmp_path).opened))
    for call in calls:
        get(call)
    assert (tmp_path / "configured").read_text() == "others"
    end([sink])


# ---- the engine


@pytest.fixture
def engine_node(host: str) -> Iterator[Node]:
    """A node whose processes run the engine."""
    node = Node(policy=PoolPolicy(spare=1))
    yield node
    node.close()


def test_the_engine_gives_the_same_label_maps_as_actors_and_in_one_process(
    engine_node: Node, tmp_path: Path
) -> None:
    made = scene("demo", frames=8, seed=1, width=854, height=480)
    video = [made.frame(t) for t in range(len(made))]
    run_to_end(engine_node.start(replace(spec("wide", FakeReader([*video], tmp_path)), config=Config())))
    subtractor = MultilayerSubtractor()
    results = [result for frame in video for result in subtractor.apply(frame)] + subtractor.flush()
    assert rows(tmp_path) == [
        f"{t} {t} {zlib.crc32(result.labels.tobytes())}" for t, result in enumerate(results)
    ]
    assert len(results) == len(video)
    assert any(result.labels.any() for result in results), "a scene without a layer proves little"


def test_actors_publish_the_parts_of_an_object_under_its_id_too(engine_node: Node, tmp_path: Path) -> None:
    made = scene("walker", frames=10, seed=2, width=320, height=240)
    video = [made.frame(t) for t in range(len(made))]
    run_to_end(engine_node.start(replace(spec("walker", FakeReader([*video], tmp_path)), config=Config())))
    likely: set[int] = set()  # layers that have pixels of their own
    subtractor = MultilayerSubtractor(
        inspector=lambda frame: likely.update(
            one.layer for one in frame.layers if (one.posterior > 0.5).sum() > 20
        )
    )
    results = [result for frame in video for result in subtractor.apply(frame)] + subtractor.flush()
    assert rows(tmp_path) == [
        f"{t} {t} {zlib.crc32(result.labels.tobytes())}" for t, result in enumerate(results)
    ]
    published = {layer.layer for result in results for layer in result.layers}
    assert published < likely - {0}, "a walker in one piece proves little"


def test_a_change_of_size_gives_the_same_label_maps_as_actors_and_in_one_process(
    engine_node: Node, tmp_path: Path
) -> None:
    video = [
        scene("pan", frames=60, width=width, height=height).frame(t)
        for width, height in ((160, 120), (120, 160), (160, 120))
        for t in range(7)
    ]
    stream = engine_node.start(replace(spec("turned", FakeReader([*video], tmp_path)), config=Config()))
    [progress] = run_to_end(stream)
    assert (progress.committed, engine_node.census().busy) == (21, 0)
    subtractor = MultilayerSubtractor()
    results = [result for frame in video for result in subtractor.apply(frame)] + subtractor.flush()
    assert rows(tmp_path) == [
        f"{t} {t} {zlib.crc32(result.labels.tobytes())}" for t, result in enumerate(results)
    ]
    assert len({layer.layer for result in results for layer in result.layers}) >= 3


@pytest.mark.long
def test_a_warmed_process_loads_no_kernel_when_frames_come(tmp_path: Path) -> None:
    program = Path(__file__).parents[1] / "fakes/warmed_processes.py"
    for part in ("record", "coordinator", "segmenter", "layer"):
        command = [sys.executable, str(program), part, str(tmp_path / "messages")]
        ran = subprocess.run(command, capture_output=True, text=True, check=False)
        assert ran.returncode == 0, ran.stderr
        assert ran.stdout.split() == ([] if part == "record" else ["later:", "set()"])
