"""Small parts for the actors: quick, and every bit of their label maps depends on all that they were given.

A frame's first pixels say what is to happen: which layers live (row 0, a column a layer), which of them are
dormant (row 1), and which part is to die at that frame (:data:`DEATHS`).
"""

from __future__ import annotations

import time
import zlib
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from itertools import count
from pathlib import Path

import numpy as np
import pytest
from joined_evidence import joined_evidence
from thread_host import die, hang, pause, process_id

from mlbs_actors.actors.parts import CoordinatorPart, LayerPart, PartFactory, SegmenterPart
from mlbs_actors.actors.stream.protocol import (
    Opening,
    RunningStream,
    Snapshot,
    StreamProgress,
    StreamSink,
    StreamSpec,
)
from mlbs_actors.config import Config
from mlbs_actors.errors import SinkError, SourceError
from mlbs_actors.messages import (
    Array,
    FrameEvidence,
    LayerAppearance,
    LayerEvidence,
    LayerKind,
    LayerPosterior,
    Region,
    Segmentation,
)
from mlbs_actors.source import FrameReader, GapStatus, SourceFrame, SourceSilence, SourceStatus
from mlbs_actors.stored_motion import StoredMotion

#: Marks of a test, or of a case, that starts or uses the session of Ray: all are left to one process.
ON_RAY = (pytest.mark.ray, pytest.mark.xdist_group("ray"))
#: For tests of the actors on Ray alone.
on_ray = pytest.mark.parametrize("host", [pytest.param("ray", marks=ON_RAY)], indirect=True)

SHAPE = (24, 40)
#: Where a frame says that a part dies: value 1 at this (row, column); for a layer its id.
DEATHS = {"coordinator": (2, 0), "segmenter": (2, 1), "layer": (2, 2)}
CONFIG = Config.model_validate({"layers": {"init_frames": 3}})


def picture(
    index: int, live: Iterable[int] = (), dormant: Iterable[int] = (), dies: str = "", value: int = 1
) -> Array:
    """A noisy frame that carries its orders in its first pixels."""
    image = np.random.default_rng(index).integers(0, 256, (*SHAPE, 3), dtype=np.uint8)
    image[:3] = 0
    image[0, list(live)] = 1
    image[1, list(dormant)] = 1
    if dies:
        image[DEATHS[dies]] = value
    return image


def crowd(frames: int, most: int) -> list[Array]:
    """One layer, then up to ``most`` and back, layer 1 dormant for a while; ids are never reused."""
    pictures = []
    for t in range(frames):
        size = round(most * (1 - abs(2 * t / (frames - 1) - 1)))
        objects = range(1 + max(0, t - frames // 2), 1 + max(0, t - frames // 2) + size)
        asleep = [1] if 1 in objects and t % 5 == 4 else []
        pictures.append(picture(t, live=[k for k in objects if k not in asleep], dormant=asleep))
    return pictures


def still_evidence(
    layers: Sequence[LayerEvidence],
    frame_index: int,
    retired: tuple[int, ...] = (),
    frame: Array | None = None,
) -> FrameEvidence:
    """Evidence of a frame, black if none is given, in which nothing moves but what the layers say."""
    return joined_evidence(
        layers,
        frame_index=frame_index,
        shape=SHAPE,
        camera=np.eye(3),
        flow=np.zeros((2, 2, 2), np.float32),
        flow_reliable=np.ones((2, 2), bool),
        unexplained=np.zeros((1, 1), np.uint8),
        colours=np.zeros((*SHAPE, 3), np.uint8) if frame is None else frame,
        retired=retired,
        latency_frames=0,
    )


@dataclass
class Memory:
    """State of a part: a checksum of all that it was told."""

    checksum: int


@dataclass
class CoordinatorMemory:
    checksum: int
    held: tuple[tuple[int, Array], ...]
    last: dict[int, int]


@dataclass(frozen=True)
class RaySession:
    """The running session: its folder, and the size of its object store, bytes."""

    folder: Path
    object_store_bytes: int


class _Coordinator:
    """Holds the first frames, then emits each at once; reads the labels of exactly t−2."""

    def __init__(self, config: Config, death: Death) -> None:
        self._hold = config.layers.init_frames
        self._death = death
        self.state = CoordinatorMemory(1, (), {})

    def feedback_index(self, frame_index: int) -> int | None:
        return None if frame_index < max(self._hold, 2) else frame_index - 2

    def step(
        self,
        frame_index: int,
        frame: Array,
        feedback: Callable[[], Segmentation] | None,
        concealed: bool = False,
    ) -> list[FrameEvidence]:
        if frame[DEATHS["coordinator"]][0]:
            self._death.come()
        read = None if feedback is None else feedback()
        assert (None if read is None else read.frame_index) == self.feedback_index(frame_index)
        if read is not None:
            self.state.checksum = zlib.crc32(read.labels.tobytes(), self.state.checksum)
        self.state.held += ((frame_index, frame),)
        return [] if frame_index + 1 < self._hold else self.flush()

    def begin_anew(self) -> list[FrameEvidence]:
        return self.flush()

    def flush(self) -> list[FrameEvidence]:
        held, self.state.held = self.state.held, ()
        return [self._evidence(*frame) for frame in held]

    def _evidence(self, t: int, frame: Array) -> FrameEvidence:
        live = [0, *np.flatnonzero(frame[0, :, 0]).tolist()]
        dormant = np.flatnonzero(frame[1, :, 0]).tolist()
        retired = tuple(sorted(set(self.state.last) - {*live, *dormant}))
        for layer in retired:
            del self.state.last[layer]
        layers = tuple(
            LayerEvidence(
                layer=layer,
                kind="object" if layer else "background",
                last_frame=self.state.last.get(layer, -1),
                positions=np.full((1, 2), self.state.checksum % 1009 + layer, np.float32),
                motions=np.zeros((1, 2), np.float32),
            )
            for layer in live
        )
        self.state.last |= dict.fromkeys(live, t)
        return still_evidence(layers, t, retired, frame)


class _Layer:
    def __init__(self, layer: int, kind: LayerKind, slow_seconds: float, death: Death) -> None:
        self._layer, self._kind, self._slow_seconds, self._death = layer, kind, slow_seconds, death
        self.state = Memory(layer + 1)

    def step(self, evidence: FrameEvidence, previous: Segmentation | None) -> LayerPosterior:
        t = self._frame = evidence.frame_index
        if evidence.colours[DEATHS["layer"]][0] == self._layer > 0:
            self._death.come()
        assert (previous.frame_index if previous else -1) == t - 1
        pause(self._slow_seconds)
        for told in (
            evidence.of(self._layer).positions,
            evidence.colours,
            *([] if previous is None else [previous.labels]),
        ):
            self.state.checksum = zlib.crc32(told.tobytes(), self.state.checksum)
        cost = np.random.default_rng(self.state.checksum).integers(0, 256, SHAPE, dtype=np.uint8)
        region = Region(0, 0, SHAPE[1], SHAPE[0])
        return LayerPosterior(
            layer=self._layer,
            frame_index=t,
            kind=self._kind,
            region=region,
            cell=1,
            cost=cost,
            log_ratio=np.zeros(SHAPE, np.int8),
            samples=np.zeros(SHAPE, np.uint8),
            outside_cost=255,
            confidence=1.0,
            velocity=np.zeros(2, np.float32),
            stage_ms={"layer": 1.0},
        )

    def appearance(self) -> LayerAppearance:
        region = Region(0, 0, SHAPE[1], SHAPE[0])
        return LayerAppearance(
            self._layer, self._frame, region, np.zeros((*SHAPE, 3), np.uint8), np.zeros(SHAPE, bool)
        )


class _Segmenter:
    def __init__(self, death: Death) -> None:
        self._death = death
        self.state = Memory(7)

    def step(self, evidence: FrameEvidence, frame: Array, posteriors: list[LayerPosterior]) -> Segmentation:
        if frame[DEATHS["segmenter"]][0]:
            self._death.come()
        ids = [posterior.layer for posterior in posteriors]
        assert ids == [own.layer for own in evidence.layers] == sorted(ids)
        costs = np.stack([posterior.cost for posterior in posteriors]) ^ np.uint8(self.state.checksum & 255)
        labels = np.array(ids, np.uint16)[costs.argmin(axis=0)]
        self.state.checksum = zlib.crc32(labels.tobytes(), self.state.checksum)
        return Segmentation(
            evidence.frame_index,
            labels,
            costs.min(axis=0),
            np.zeros(SHAPE, np.int8),
            (),
            (0.0, 0.0),
            0,
            {"segmenter": 2.0, "layer": 4.0},
        )


@dataclass(frozen=True)
class Death:
    """How a part dies where a frame says so.

    Attributes
    ----------
    folder : Path
        Gets a file for each death.
    times : int
        Later ones pass the part by.
    hangs : bool
        It does nothing any more instead of being gone.
    """

    folder: Path
    times: int = 1_000_000
    hangs: bool = False

    def come(self) -> None:
        number = len([*self.folder.glob("death-*")])
        if number >= self.times:
            return
        (self.folder / f"death-{number}").touch()
        if self.hangs:
            hang()
        die()


@dataclass(frozen=True)
class FakeParts:
    """Makes the small parts, and notes the processes they are in.

    Attributes
    ----------
    folder : Path
        Holds a file ``pid-<process id>`` for each process that ran a part.
    cannot_start : bool
        Layer processes die at their start.
    slow_seconds : float
        What a layer needs for a frame.
    deaths : int
        How often parts die where frames say so.
    hang : bool
        They hang instead.
    hanging_starts : range
        Which layer processes hang at their start, of those that have come so far, until they are let start
        (:meth:`let_start`).
    """

    folder: Path
    cannot_start: bool = False
    slow_seconds: float = 0.0
    deaths: int = 1_000_000
    hang: bool = False
    hanging_starts: range = range(0)

    def coordinator(
        self, config: Config, ignored: Array | None = None, motion: StoredMotion | None = None
    ) -> CoordinatorPart:
        self._note()
        return _Coordinator(config, self._death())

    def layer(self, config: Config, layer: int, kind: LayerKind) -> LayerPart:
        return _Layer(layer, kind, self.slow_seconds, self._death())

    def segmenter(self, config: Config) -> SegmenterPart:
        self._note()
        return _Segmenter(self._death())

    def warm_layer(self) -> None:
        self._note()
        if self.cannot_start:
            raise MemoryError("no memory left for a layer")
        hangs = self._start_number() in self.hanging_starts
        while hangs and not (self.folder / "let-start").exists():
            pause(0.01)

    def let_start(self) -> None:
        (self.folder / "let-start").touch()

    def warm_coordinator(self) -> None:
        self._note()

    def warm_segmenter(self) -> None:
        self._note()

    def processes(self) -> set[int]:
        return {int(note.name.removeprefix("pid-")) for note in self.folder.glob("pid-*")}

    def _start_number(self) -> int:
        for number in count():
            with suppress(FileExistsError):
                (self.folder / f"start-{number}").touch(exist_ok=False)
                break
        return number

    def _note(self) -> None:
        (self.folder / f"pid-{process_id()}").touch()

    def _death(self) -> Death:
        return Death(self.folder, self.deaths, self.hang)


@dataclass
class FakeReader:
    """Reads from memory; notes every read in a file, and fails or dies where told to.

    Before the frames of ``gates`` it waits until they are let through (:meth:`let_through`).
    """

    pictures: list[Array | None]
    folder: Path
    raises_at: int = -1
    dies_at: int = -1
    enlarged: int = 1
    slow_seconds: float = 0.0
    gates: range = range(0)
    problem: str | None = None
    index: int = 0

    def opened(self) -> FrameReader:
        return self

    def let_through(self, frame: int) -> None:
        (self.folder / f"through-{frame}").touch()

    def read(self) -> SourceFrame | None:
        pause(self.slow_seconds)
        while self.index in self.gates and not (self.folder / f"through-{self.index}").exists():
            pause(0.01)
        if self.index == self.raises_at:
            raise SourceError("The source is not to be had.")
        if self.index == self.dies_at:
            die()
        if self.index >= len(self.pictures):
            return None
        image, t = self.pictures[self.index], self.index
        if image is not None:
            image = np.tile(image, (self.enlarged, 1, 1))  # the orders stay where they are
        self.index += 1
        with (self.folder / "reads").open("a") as reads:
            reads.write(f"{t}\n")
        status: SourceStatus = "quarantined" if image is None else "ok"
        return SourceFrame(t, image, t / 25, f"{t:05d}", status, length=len(self.pictures))

    def close(self) -> None:
        (self.folder / "reader-closed").touch()


@dataclass
class FakeCamera:
    """Answers what it is told to, then ends."""

    answers: list[SourceFrame | SourceSilence]
    folder: Path
    problem: str | None = None

    def opened(self) -> FrameReader:
        return self

    def read(self) -> SourceFrame | SourceSilence | None:
        with (self.folder / "reads").open("a") as reads:
            reads.write("\n")
        return self.answers.pop(0) if self.answers else None

    def close(self) -> None:
        (self.folder / "reader-closed").touch()


@dataclass
class FakeSink:
    """Writes a line for each row: source index, what it is, and a checksum of the labels."""

    folder: Path
    slow_seconds: float = 0.0
    fails_at: int = -1
    dies_at: int = -1
    rows: int = 0
    opening: Opening = field(default_factory=Opening)

    def opened(self) -> StreamSink:
        return self

    def write(
        self, segmentation: Segmentation, frame: SourceFrame, background: LayerAppearance | None = None
    ) -> int:
        if frame.index == self.dies_at:
            die()
        if background is not None:
            with (self.folder / "backgrounds").open("a") as told:
                told.write(f"{frame.index} {background.layer} {background.frame_index}\n")
        self._row(frame.index, f"{segmentation.frame_index} {zlib.crc32(segmentation.labels.tobytes())}")
        self.rows += 1
        return self.rows

    def gap(self, index: int, pts: float, status: GapStatus) -> int:
        self._row(index, status)
        return self.rows

    def keep(self, snapshot: Snapshot) -> bool:
        return False

    def configure(self, settings: object) -> None:
        (self.folder / "configured").write_text(str(settings))

    def silent(self) -> None:
        (self.folder / "silent").touch()

    def provisional(self) -> None:
        (self.folder / "provisional").touch()

    def close(self, *, whole: bool) -> int:
        (self.folder / "sink-closed").touch()
        return self.rows

    def _row(self, index: int, text: str) -> None:
        if index == self.fails_at:
            raise SinkError("The disk is full; free some space.")
        pause(self.slow_seconds)
        read = len((self.folder / "reads").read_text().splitlines())
        with (self.folder / "rows").open("a") as rows:
            rows.write(f"{index} {text}\n")
        with (self.folder / "ahead").open("a") as ahead:
            ahead.write(f"{read - index}\n")


def spec(
    name: str, reader: FakeReader | FakeCamera, sink: FakeSink | None = None, *, max_frames: int | None = None
) -> StreamSpec:
    """A stream that reads from memory and writes its rows into the reader's folder."""
    reader.folder.mkdir(parents=True, exist_ok=True)
    sink = sink or FakeSink(reader.folder)
    return StreamSpec(name, CONFIG, reader.opened, sink.opened, max_frames)


def rows(folder: Path) -> list[str]:
    """Rows the sink took, in order."""
    return (folder / "rows").read_text().splitlines() if (folder / "rows").exists() else []


def rows_in_one_process(parts: PartFactory, pictures: Iterable[Array], config: Config = CONFIG) -> list[str]:
    """The same parts called one after the other, as the plain way to do what the actors do."""
    coordinator, segmenter = parts.coordinator(config), parts.segmenter(config)
    layers: dict[int, LayerPart] = {}
    results: list[Segmentation] = []
    given = list(pictures)
    for index, image in enumerate(given):
        wanted = coordinator.feedback_index(index)
        complete = coordinator.step(
            index, image, None if wanted is None else partial(results.__getitem__, wanted)
        )
        if index == len(given) - 1:
            complete = [*complete, *coordinator.flush()]
        for evidence in complete:
            for retired in evidence.retired:
                del layers[retired]
            frame = given[evidence.frame_index]
            previous = results[-1] if results else None
            posteriors = []
            for own in evidence.tracks:
                if own.layer not in layers:
                    layers[own.layer] = parts.layer(config, own.layer, own.kind)
                posteriors.append(layers[own.layer].step(evidence, previous))
            results.append(segmenter.step(evidence, frame, posteriors))
    return [f"{t} {t} {zlib.crc32(result.labels.tobytes())}" for t, result in enumerate(results)]


def run_to_end(*streams: RunningStream) -> list[StreamProgress]:
    """Ask each stream for one burst after the other, all at once, and stop each at its end."""
    asked = {index: stream.advance() for index, stream in enumerate(streams)}
    last: dict[int, StreamProgress] = {}
    while asked:
        for index, answer in list(asked.items()):
            last[index] = answer.result(timeout=200)
            if last[index].done:
                streams[index].stop(drain=False)
                del asked[index]
            else:
                asked[index] = streams[index].advance()
    return [last[index] for index in range(len(streams))]


def wait_until(condition: Callable[[], bool]) -> None:
    """Wait for something that comes about on a very busy machine, too."""
    deadline = time.monotonic() + 180.0
    while not condition():
        assert time.monotonic() < deadline, "it did not come about"
        time.sleep(0.02)


def is_running(process: int) -> bool:
    try:
        state = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0]
    except FileNotFoundError:
        return False
    return state != "Z"
