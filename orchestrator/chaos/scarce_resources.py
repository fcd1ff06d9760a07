"""Disks that are full, read-only or gone, memory that runs out, and machines that go."""

from __future__ import annotations

import errno
import mmap
import signal
import time
from collections.abc import Callable
from pathlib import Path

from orchestrator.chaos.lost_processes import resumed
from orchestrator.chaos.observed_run import ObservedRun, content, expect
from orchestrator.chaos.place import (
    FRAMES,
    LINES,
    Fault,
    Place,
    expect_end,
    expect_identical,
    seconds_until_back,
)
from orchestrator.chaos.planted import Plant, Trap

__all__ = ["FAULTS"]

#: What is left to a run that is to run out of memory, and what is taken at most, bytes.
_LEFT_BYTES, _MOST_TAKEN_BYTES = 4 * 2**30, 8 * 2**30
_TAKEN_AT_ONCE_BYTES = 2**28


def _disk_fails(number: int) -> Callable[[Place], float]:
    """Nothing can be published any more: what was committed is kept, and ``--resume`` goes on from there."""

    def bring_about(place: Place) -> float:
        call = int(place.random.integers(2, 6))  # after the generations of the two streams
        full = Trap(
            "orchestrator.durable_files:publish", "fail", call, value=number, process="ray::SinkActor"
        )
        with ObservedRun(LINES, place.folder, plant=Plant(place.folder / "plant", [full])) as run:
            words = expect_end(run, 1)
            expect("cannot be written" in words, f"the error is not told: {words}")
            for name in ("victim", "beside"):
                kept, whole = content(run.output / name)["masks"], place.expected[name]["masks"]
                expect(kept.items() <= whole.items(), f"{name}: what was kept is not as without the fault")
        return resumed(place)

    return bring_about


def _folder_gone(place: Place) -> None:
    with ObservedRun(LINES, place.folder) as run:
        run.wait_for_frames("victim", int(place.random.integers(1, FRAMES // 2)))
        (run.output / "victim").rename(run.output / "elsewhere")
        words = expect_end(run, 1)
        expect("victim" in words and "cannot be written" in words, f"the error is not told: {words}")
        expect_identical(place, run, "beside")


def _memory_runs_out(place: Place) -> float:
    """Ray ends processes when the machine's memory is used up to a threshold."""
    total, free = _memory()
    threshold = (total - free + _LEFT_BYTES) / total
    expect(threshold < 1, "not injected: less than 4 GB of memory are free")
    settings = {"RAY_memory_usage_threshold": f"{threshold:.4f}", "RAY_memory_monitor_refresh_ms": "100"}
    with ObservedRun(LINES, place.folder, settings=settings) as run:
        run.wait_for_frames("victim", int(place.random.integers(8, FRAMES - 16)))
        _take_memory_until(lambda: any(stream["returns"] for stream in run.status().values()))
        seconds = seconds_until_back(run)
        expect_end(run, 0)
        expect_identical(place, run)
        return seconds


def _memory() -> tuple[int, int]:
    """Memory of the machine, and what of it is available, bytes."""
    lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
    kilobytes = {line.partition(":")[0]: int(line.split()[1]) for line in lines}
    return 1024 * kilobytes["MemTotal"], 1024 * kilobytes["MemAvailable"]


def _take_memory_until(condition: Callable[[], bool]) -> None:
    """Take more and more memory until something has come about, and give it back."""
    taken: list[mmap.mmap] = []
    try:
        while not condition():
            expect(len(taken) * _TAKEN_AT_ONCE_BYTES < _MOST_TAKEN_BYTES, "Ray ended no process")
            taken.append(mmap.mmap(-1, _TAKEN_AT_ONCE_BYTES))
            taken[-1].write(b"\1" * _TAKEN_AT_ONCE_BYTES)
            time.sleep(0.2)
    finally:
        for memory in taken:
            memory.close()


def _node_lost(place: Place) -> float:
    """Of a cluster of three nodes one is lost that does nothing, then the driver's own with all on it."""
    from ray.cluster_utils import Cluster

    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False})
    try:
        other = [cluster.add_node(num_cpus=1) for _ in range(2)][int(place.random.integers(2))]
        with ObservedRun(LINES, place.folder, "--address", cluster.address) as run:
            run.wait_for_frames("victim", int(place.random.integers(1, 16)))
            cluster.remove_node(other, allow_graceful=False)
            run.wait_for_frames("victim", int(place.random.integers(24, FRAMES - 8)))
            expect(not any(stream["returns"] for stream in run.status().values()), "a stream was disturbed")
            if cluster.head_node is not None:
                cluster.remove_node(cluster.head_node, allow_graceful=False)
            run.signal_driver(signal.SIGKILL)
            run.end(killed=True)
            return resumed(place)
    finally:
        cluster.shutdown()  # type: ignore[no-untyped-call]


FAULTS = (
    Fault("18", "a node of three lost, then the driver's, then --resume", _node_lost),
    Fault("22", "disk full, then --resume", _disk_fails(errno.ENOSPC)),
    Fault("23", "output folder read-only, then --resume", _disk_fails(errno.EROFS)),
    Fault("23", "output folder gone", _folder_gone),
    Fault("26", "memory runs out", _memory_runs_out),
)
