"""Run streams through Ray as users do, observed from the driver: a session, a node, readers, real records.

The source is a video file, so that its reader does what a user's does. A *steady window* begins when every
stream has read its warm frames and no process is starting any more. The processes record in small files
which layer each of them is, and when each label map reached the sink.
"""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import contextmanager, redirect_stdout
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmark.through_ray.process_costs import Process, kinds_of, private_bytes, process_tree
from benchmark.through_ray.recording_parts import SPARE, RecordingParts, RecordingSink
from mlbs_actors import Config
from mlbs_actors.actors.parts import EngineParts, PartFactory
from mlbs_actors.actors.pipeline import Node, StreamActors
from mlbs_actors.actors.stream.protocol import StreamProgress, StreamSink, StreamSpec
from mlbs_actors.source import FrameReader
from orchestrator.option_values import SAVED
from orchestrator.ray_session import ray_session
from orchestrator.sinks.record import StreamRecord

__all__ = ["ROUNDS", "Arrival", "Pipeline", "SteadyWindow", "pipeline", "record_in"]

#: Interval of polling whether the layer processes have started, s.
_POLL_SECONDS = 0.2

#: How often streams that are compared run alternately.
ROUNDS = 6

#: Kind of the processes that wait for the next stream.
STANDBY = "standby"


@dataclass(frozen=True, slots=True)
class Arrival:
    """A label map that has reached the sink.

    Attributes
    ----------
    seconds : float
        When, on the machine's monotonic clock, s.
    labelled : float
        When it was made; several may reach the sink together.
    frame : int
        Index of the frame.
    objects : frozenset of int
        Its objects.
    """

    seconds: float
    labelled: float
    frame: int
    objects: frozenset[int]


@dataclass(frozen=True, slots=True)
class SteadyWindow:
    """The session between two moments in steady state.

    Attributes
    ----------
    begin, end : float
        On the machine's monotonic clock, s.
    frames : int
        Label maps of all streams that reached the sink between them.
    before, after : dict of int to Process
        The session's processes then.
    kinds : dict of int to str
        Kind of each process of ``after``.
    memory : dict of int to int
        Private memory of each at the end, bytes.
    """

    begin: float
    end: float
    frames: int
    before: dict[int, Process]
    after: dict[int, Process]
    kinds: dict[int, str]
    memory: dict[int, int]

    @property
    def frames_a_second(self) -> float:
        """Return the rate of all streams together."""
        return self.frames / (self.end - self.begin)


def record_in(folder: Path) -> StreamSink:
    """Open a record with the parts that a run without ``--save`` has."""
    return StreamRecord(folder, folder.name, frozenset(SAVED))


@dataclass
class Pipeline:
    """A node of a Ray session on this machine; made by :func:`pipeline`.

    Attributes
    ----------
    started : float
        When the session began to start, s.
    ready : float
        When Ray was up, s.
    """

    started: float
    ready: float
    _node: Node
    _config: Config
    _folder: Path
    _streams: list[StreamActors] = field(default_factory=list)
    #: Bursts of frames in progress, with the number of their stream.
    _bursts: dict[Future[StreamProgress], int] = field(default_factory=dict)
    #: Live layers of each stream after its last burst.
    _layers: dict[int, int] = field(default_factory=dict)

    def start(
        self,
        open_reader: Callable[[], FrameReader],
        open_record: Callable[[Path], StreamSink] = record_in,
        max_frames: int | None = None,
    ) -> int:
        """Start a stream; return its number, which :meth:`arrivals` takes."""
        number = len(self._streams)
        open_sink = partial(
            RecordingSink,
            partial(open_record, self._folder / f"record-{number}"),
            self._arrivals_file(number),
        )
        spec = StreamSpec(f"stream {number}", self._config, open_reader, open_sink, max_frames)
        self._streams.append(self._node.start(spec))
        return number

    def run_to_end(self) -> None:
        """Drive the newest stream until it is done, and stop it."""
        stream = self._streams[-1]
        while not stream.advance().result().done:
            continue
        stream.stop(drain=False)

    def settle(self) -> None:
        """Wait until no layer process is starting any more."""
        while not self._settled():
            time.sleep(_POLL_SECONDS)

    def steady_window(self, warm: int, frames: int) -> SteadyWindow:
        """Drive all streams, which must not end, until a steady window is over; stop them.

        Parameters
        ----------
        warm : int
            Frames that each stream has read at least when the window begins.
        frames : int
            Label maps of each stream that the window holds at least.
        """
        numbers = range(len(self._streams))
        self._warm_up(warm)
        window = self._window(numbers, frames)
        self._stop()
        return window

    def alternating_windows(
        self, warm: int, frames: int, groups: Sequence[Sequence[int]]
    ) -> Iterator[list[SteadyWindow]]:
        """Drive groups of streams, which must not end, alternately; stop them at the end.

        Every other round is in reverse order, so that other load on a shared machine, which changes within
        minutes, affects all groups alike.

        Parameters
        ----------
        warm, frames : int
            As for :meth:`steady_window`.
        groups : sequence of sequence of int
            Numbers of the streams that are driven together.

        Yields
        ------
        list of SteadyWindow
            For each of the :data:`ROUNDS` one of each group, in which no other stream was driven.
        """
        self._warm_up(warm)
        for round_number in range(ROUNDS):
            windows = []
            for group in reversed(groups) if round_number % 2 else groups:
                wait(self._bursts)  # the last group's
                self._bursts.clear()
                self._drive(group, bool)
                windows.append(self._window(group, frames))
            yield windows[::-1] if round_number % 2 else windows
        self._stop()

    def _warm_up(self, warm: int) -> None:
        """Drive all streams until they are steady: no process is starting any more."""
        numbers = range(len(self._streams))
        least = dict.fromkeys(numbers, 0)

        def steady(read: Mapping[int, int]) -> bool:
            least.update(read)
            return min(least.values()) >= warm and self._settled() and self._standby_is_ready()

        self._drive(numbers, steady)

    def _window(self, numbers: Sequence[int], frames: int) -> SteadyWindow:
        """Drive streams that are already driven until each has produced ``frames`` more label maps."""
        begin, before = time.monotonic(), process_tree(os.getpid())
        arrived = {number: self._arrived(number) for number in numbers}
        self._drive(numbers, lambda _: all(self._arrived(one) - arrived[one] >= frames for one in numbers))
        end, after = time.monotonic(), process_tree(os.getpid())
        memory = {pid: private_bytes(pid) for pid in after}
        kinds = kinds_of(after, os.getpid(), self._layer_kinds())
        kinds |= {pid: STANDBY for pid in after if (self._folder / "standby" / str(pid)).exists()}
        count = sum(begin < one.seconds <= end for number in numbers for one in self.arrivals(number))
        return SteadyWindow(begin, end, count, before, after, kinds, memory)

    def _drive(self, numbers: Sequence[int], enough: Callable[[Mapping[int, int]], bool]) -> None:
        """Keep streams reading until ``enough``, called after bursts, is true of the frames read.

        The next bursts are in progress when this returns.
        """
        for number in set(numbers) - set(self._bursts.values()):
            self._bursts[self._streams[number].advance()] = number
        while True:
            ready, _ = wait(self._bursts, return_when=FIRST_COMPLETED)
            read = {}
            for burst in ready:
                number = self._bursts.pop(burst)
                progress = burst.result()
                read[number], self._layers[number] = progress.read, progress.layers
                self._bursts[self._streams[number].advance()] = number
            if enough(read):
                return

    def _stop(self) -> None:
        for stream in self._streams:
            stream.stop(drain=False)

    def arrivals(self, number: int) -> list[Arrival]:
        """Return all label maps of a stream that have reached the sink, in order."""
        file = self._arrivals_file(number)
        lines = file.read_text(encoding="ascii").splitlines(keepends=True) if file.exists() else []
        words = [line.split() for line in lines if line.endswith("\n")]  # the last may not be whole
        return [
            Arrival(float(line[0]), float(line[1]), int(line[2]), frozenset(map(int, line[3:])))
            for line in words
        ]

    def _arrived(self, number: int) -> int:
        """Count the label maps without parsing them, because this happens after every burst."""
        file = self._arrivals_file(number)
        return file.read_bytes().count(b"\n") if file.exists() else 0

    def _arrivals_file(self, number: int) -> Path:
        return self._folder / f"arrivals-{number}"

    def _settled(self) -> bool:
        census = self._node.census()
        started = self._layer_kinds().keys() & process_tree(os.getpid()).keys()
        # With fewer than there are layers the pool is about to start another.
        return len(started) >= census.idle + census.busy >= sum(self._layers.values())

    def _standby_is_ready(self) -> bool:
        """Return whether the standby processes of the next coordinator and segmenter are ready."""
        return len(list((self._folder / "standby").iterdir())) >= 2

    def _layer_kinds(self) -> dict[int, str]:
        files = (self._folder / "layers").iterdir()
        return {int(file.name): file.read_text(encoding="utf-8") or SPARE for file in files}


@contextmanager
def pipeline(config: Config, scratch: Path, parts: PartFactory | None = None) -> Iterator[Pipeline]:
    """Keep a Ray session with one node while the ``with`` block runs; its streams end with it.

    Parameters
    ----------
    config : Config
        Of every stream.
    scratch : Path
        From :func:`orchestrator.ray_session.ray_settings`.
    parts : PartFactory, optional
        What the actors run; by default the engine.
    """
    started = time.monotonic()
    at_sigterm = signal.getsignal(signal.SIGTERM)
    # Ray prints its own warnings; standard output is for the tables.
    with (
        redirect_stdout(sys.stderr),
        TemporaryDirectory(prefix="mlbs-bench-") as name,
        ray_session(None, scratch),
    ):
        ready = time.monotonic()
        signal.signal(signal.SIGTERM, at_sigterm)  # Ray replaces it, and would exit without unwinding
        folder = Path(name)
        recording_parts = RecordingParts(parts or EngineParts(), folder / "layers", folder / "standby")
        recording_parts.folder.mkdir()
        recording_parts.standby.mkdir()
        node = Node(parts=recording_parts)
        made = Pipeline(started, ready, node, config, folder)
        try:
            yield made
        finally:
            node.close()
