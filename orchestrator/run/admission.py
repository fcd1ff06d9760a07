"""Which streams may run at once, in the order of the list; the others wait, and are told what for.

A stream is several processes, and together they must fit into memory: if a machine swaps, or its kernel kills
for memory, all streams are lost at once. Each stream is admitted with memory for a few objects; for more,
the pool starts processes while memory lasts (:mod:`mlbs_actors.actors.node.pool`).

A stream of a file takes all CPU time that it gets, so a fixed number of them keeps the cores busy, and more
would only cost memory. A camera takes what its rate asks for. So as many cameras start as files would; once
it is measured what these take, with the objects that they have after half a minute, more start, until all
but a tenth of the cores is busy: without a reserve cameras drop frames. Those of a resumed run start at once.
What was admitted stays: if it takes more later, frames are dropped, too.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from statistics import fmean
from typing import TypeAlias

from mlbs_actors.actors.node.memory import NodeMemory
from mlbs_actors.wording import count_of
from orchestrator.run.need import PLACE_BYTES, STREAMS_A_CORE, USUAL_NEED, Need
from orchestrator.run.stream_state import ENDED, StreamState

__all__ = [
    "Admission",
    "Verdict",
    "by_count",
    "by_load",
    "cores",
    "places",
    "places_by_memory",
]

#: Left for the driver, Ray's own processes, the sink and the object store, bytes.
_RESERVED_BYTES = 1_500 * 2**20

#: Share of the cores that cameras may take.
_BUSY_SHARE = 0.9

#: Cores counted for a file, and for a camera while no camera has been measured.
_CORES_A_FILE = _BUSY_SHARE / STREAMS_A_CORE

#: What the sink and Ray take besides a stream's own processes, as a share of these (docs/scaling.md).
_SHARED_SHARE = 0.14

#: Interval of measurements of the free memory, s.
_LOOK_SECONDS = 1.0


@dataclass(frozen=True, slots=True)
class Verdict:
    """A decision about the streams that wait.

    Attributes
    ----------
    start : str, optional
        Name of the one to start now.
    files_wait_for, cameras_wait_for : str
        Otherwise, what the others wait for.
    """

    start: str | None = None
    files_wait_for: str = ""
    cameras_wait_for: str = ""

    def waits_for(self, state: StreamState) -> str:
        """Return what a waiting stream waits for."""
        return self.cameras_wait_for if state.live else self.files_wait_for


#: Takes the states of all streams and the names of those whose processes are ending.
Admission: TypeAlias = Callable[[Sequence[StreamState], Collection[str]], Verdict]


def by_count(
    most: int | Callable[[int], int], kind: str = "places", total: Callable[[], int] | None = None
) -> Admission:
    """Admit so many streams at once, whatever they take.

    Parameters
    ----------
    most : int or callable
        A callable is called repeatedly, with the number of streams that wait.
    kind : str
        What there are so many of, for the user.
    total : callable, optional
        How many there are of them, those included that ``most`` does not have yet.
    """

    def admit(states: Sequence[StreamState], ending: Collection[str]) -> Verdict:
        waiting = [state.name for state in states if state.state == "waiting"]
        limit = most(len(waiting)) if callable(most) else most
        if not waiting:
            return Verdict()
        if len(_running(states, ending)) < limit:
            return Verdict(waiting[0])
        there = limit if total is None else max(limit, total())
        reason = f"one of the {there} {kind}, which are taken" if there else f"{kind}: there are none yet"
        return Verdict(None, reason, reason)

    return admit


def by_load(
    core_count: int,
    most_files: int,
    memory: Callable[[], NodeMemory],
    clock: Callable[[], float] = time.monotonic,
) -> Admission:
    """Admit files by number, and cameras by the CPU time and memory that they take on this machine.

    Parameters
    ----------
    core_count : int
    most_files : int
        Files at once.
    memory : callable
        Measures the memory.
    clock : callable
        Monotonic time, s.
    """
    looked, free = clock(), memory().free

    def admit(states: Sequence[StreamState], ending: Collection[str]) -> Verdict:
        nonlocal looked, free
        file = next((state for state in states if state.state == "waiting" and not state.live), None)
        camera = next((state for state in states if state.state == "waiting" and state.live), None)
        if file is None and camera is None:
            return Verdict()
        if clock() - looked >= _LOOK_SECONDS:
            looked, free = clock(), memory().free
        load = _Load.of(_running(states, ending))
        if load.streams == 0:
            return Verdict(next(state.name for state in states if state.state == "waiting"))
        short = load.short_of_memory(free)
        files_wait, cameras_wait = "" if load.files == load.streams else short, short
        if load.files >= most_files:
            files_wait = f"one of the {most_files} places for files, which are taken"
        files_wait = files_wait or load.short_of_cores(core_count, _CORES_A_FILE)
        # One of the run that is resumed was there before, whatever the others take by now.
        if camera is None or not camera.earlier_cores:
            cameras_wait = cameras_wait or load.short_of_cores(core_count, load.cores_a_camera)
        fitting = [one for one, waits_for in ((file, files_wait), (camera, cameras_wait)) if not waits_for]
        first = next((state.name for state in states if state in fitting), None)
        return Verdict(first, files_wait, cameras_wait)

    return admit


@dataclass(frozen=True, slots=True)
class _Load:
    """What the running streams take: cores, and memory, bytes; and what one more would."""

    streams: int
    files: int
    cores: float
    cores_a_camera: float
    unmeasured: int
    memory_a_stream: float

    @staticmethod
    def of(running: Sequence[StreamState]) -> _Load:
        files = sum(not state.live for state in running)
        measured = [state.cores or state.earlier_cores for state in running if state.live]
        cameras = [cores * (1 + _SHARED_SHARE) for cores in measured if cores]
        a_camera = fmean(cameras) if cameras else _CORES_A_FILE
        taken = sum(cameras) + a_camera * (len(running) - files - len(cameras)) + files * _CORES_A_FILE
        memory = [state.memory for state in running if state.memory]
        return _Load(
            streams=len(running),
            files=files,
            cores=taken,
            cores_a_camera=a_camera,
            unmeasured=len(running) - len(memory),
            memory_a_stream=fmean(memory) if memory else PLACE_BYTES,
        )

    def short_of_cores(self, core_count: int, more: float) -> str:
        """Return why a stream that takes so many cores does not fit; empty if it does."""
        if self.cores + more <= core_count * _BUSY_SHARE + 1e-6:
            return ""
        return (
            f"CPU time: {count_of(self.streams, 'stream')} {'take' if self.streams > 1 else 'takes'} "
            f"{self.cores:.1f} of {count_of(core_count, 'core')}, and another one would take {more:.2f}; "
            "a tenth stays free"
        )

    def short_of_memory(self, free: int) -> str:
        """Return why another stream does not fit into the free memory, bytes; empty if it does."""
        reserved = self.memory_a_stream * self.unmeasured
        if self.unmeasured == self.streams:  # the session itself is still growing
            reserved += _RESERVED_BYTES
        if free - reserved >= self.memory_a_stream:
            return ""
        left, more = max(free - reserved, 0) / 2**30, self.memory_a_stream / 2**30
        return f"memory: {left:.1f} GiB are left for more streams, and one takes {more:.1f} GiB"


def _running(states: Sequence[StreamState], ending: Collection[str]) -> list[StreamState]:
    """Select the streams that have processes."""
    return [
        state
        for state in states
        if state.name in ending or (state.state != "waiting" and state.state not in ENDED)
    ]


def places(memory: NodeMemory, core_count: float, need: Need = USUAL_NEED) -> int:
    """Return how many streams of files may run at once.

    Parameters
    ----------
    memory : NodeMemory
        Before the run.
    core_count : float
    need : Need
        Of each.

    Returns
    -------
    int
        At least 1: a machine too small for the estimate may still hold one small stream.
    """
    return max(1, min(places_by_memory(memory, need), int(core_count / need.cpus + 1e-6)))


def places_by_memory(memory: NodeMemory, need: Need = USUAL_NEED) -> int:
    """Return how many streams fit into the memory before the run; at least 1."""
    return max(1, (memory.free - _RESERVED_BYTES) // need.memory)


def cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0))
