"""Disks that are full, read-only or gone, memory that runs out, and machines that go."""

from __future__ import annotations

import mmap
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from benchmark.through_ray.process_costs import process_tree
from chaos.harness.injection import Plant
from chaos.harness.loss_series import LABELLED, newest_label_map, seconds_back
from chaos.harness.observed_run import ObservedRun, expect
from chaos.harness.scenario import (
    BESIDE,
    FRAMES,
    LINES,
    Back,
    Place,
    alone,
    beside,
    expect_end,
    expect_identical,
    victim,
)

__all__ = ["SCENARIOS"]

#: What is left to a run that is to run out of memory, and what is taken at most, bytes.
_LEFT_BYTES, _MOST_TAKEN_BYTES = 4 * 2**30, 8 * 2**30
_TAKEN_AT_ONCE_BYTES = 2**28

#: Until a loss is told, s.
_NOTICED_SECONDS = 5.0

#: Length of streams that go on while memory is taken, and while nodes are waited for, frames.
_VERY_LONG, _LONG = 24 * FRAMES, 8 * FRAMES


def _folder_gone(place: Place) -> None:
    with ObservedRun(LINES, place.folder) as run:
        run.wait_for_frames("victim", int(place.random.integers(1, FRAMES // 2)))
        (run.output / "victim").rename(run.output / "elsewhere")
        words = expect_end(run, 1)
        expect("victim" in words and "cannot be written" in words, f"the error is not told: {words}")
        expect_identical(place, run, BESIDE)


def _memory_runs_out(place: Place) -> Back:
    """Ray ends processes when the machine's memory is used up to a threshold."""
    total, free = _memory()
    threshold = (total - free + _LEFT_BYTES) / total
    expect(threshold < 1, "not injected: less than 4 GB of memory are free")
    settings = {"RAY_memory_usage_threshold": f"{threshold:.4f}", "RAY_memory_monitor_refresh_ms": "100"}
    lines = victim(_VERY_LONG), beside(_VERY_LONG)
    place.prepare(lines)
    plant = Plant(place.folder / "plant", [LABELLED])
    with ObservedRun(lines, place.folder, plant=plant, settings=settings) as run:
        run.wait_for_frames("victim", int(place.random.integers(8, FRAMES)))
        newest = {name: newest_label_map(run.output / name) for name in ("victim", "beside")}
        while not _gone_back(run):  # one that only waited may have been ended
            ended = _take_memory_until_a_process_is_ended(run)
            time.sleep(_NOTICED_SECONDS)
        back = seconds_back(run, plant, ended, newest, lambda: _gone_back(run))
        expect_end(run, 0)
        expect_identical(place, run, *lines)
        return back


def _gone_back(run: ObservedRun) -> set[str]:
    return {name for name, stream in run.status().items() if stream["returns"]}


def _memory() -> tuple[int, int]:
    """Memory of the machine, and what of it is available, bytes."""
    lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
    kilobytes = {line.partition(":")[0]: int(line.split()[1]) for line in lines}
    return 1024 * kilobytes["MemTotal"], 1024 * kilobytes["MemAvailable"]


def _take_memory_until_a_process_is_ended(run: ObservedRun) -> float:
    """Take more and more memory, and give it back as soon as Ray has ended a process; return when."""
    taken: list[mmap.mmap] = []
    living = run.tree().keys()
    try:
        while living <= run.tree().keys():
            expect(len(taken) * _TAKEN_AT_ONCE_BYTES < _MOST_TAKEN_BYTES, "Ray ended no process")
            taken.append(_memory_in_use(_TAKEN_AT_ONCE_BYTES))
            time.sleep(0.2)
        return time.monotonic()
    finally:
        for memory in taken:
            memory.close()


def _memory_in_use(size: int) -> mmap.mmap:
    """Memory that is there: something is written on each page (on large ones, because that is quicker)."""
    memory = mmap.mmap(-1, size, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)
    memory.madvise(mmap.MADV_HUGEPAGE)
    memory[:: mmap.PAGESIZE] = bytes(size // mmap.PAGESIZE)
    return memory


def _node_lost(place: Place) -> Back:
    """Of a cluster of three nodes one is lost that has a stream, which goes on on another one."""
    from ray.cluster_utils import Cluster

    lines = victim(_LONG), beside(_LONG)
    place.prepare(lines)
    plant = Plant(place.folder / "plant", [LABELLED])
    with _springing(plant):
        cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False})
        nodes = [cluster.add_node(num_cpus=1) for _ in range(2)]
    try:
        with ObservedRun(lines, place.folder, "--address", cluster.address, plant=plant) as run:
            run.wait_for_frames("victim", int(place.random.integers(8, FRAMES)))
            run.wait_for_frames("beside", int(place.random.integers(8, FRAMES)))
            newest = {name: newest_label_map(run.output / name) for name in ("victim", "beside")}
            busy = [node for node in nodes if _has_a_stream(node)]
            expect(bool(busy), "not injected: no stream is on a node that can be lost")
            began = time.monotonic()
            cluster.remove_node(busy[int(place.random.integers(len(busy)))], allow_graceful=False)
            back = seconds_back(run, plant, began, newest, lambda: _gone_back(run))
            expect_end(run, 0)
            expect_identical(place, run, *lines)
            return back
    finally:
        cluster.shutdown()  # type: ignore[no-untyped-call]


@contextmanager
def _springing(plant: Plant) -> Iterator[None]:
    """Give the environment of a plant to the processes that are started meanwhile."""
    before = os.environ.get("PYTHONPATH")
    os.environ["PYTHONPATH"] = plant.environment()["PYTHONPATH"]
    try:
        yield
    finally:
        if before is None:
            del os.environ["PYTHONPATH"]
        else:
            os.environ["PYTHONPATH"] = before


def _has_a_stream(node: Any) -> bool:
    """Whether a node of Ray's cluster for tests has processes of a stream."""
    raylet = node.all_processes["raylet"][0].process.pid
    return any(one.title.startswith("ray::SegmenterActor") for one in process_tree(raylet).values())


SCENARIOS = (
    alone("18", "a node of three lost with its stream", _node_lost),
    alone("23", "output folder gone", _folder_gone),
    alone("26", "memory runs out", _memory_runs_out),
)
