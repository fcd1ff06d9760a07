"""Remove the output folder, use up the memory, and lose a node of a cluster."""

from __future__ import annotations

import mmap
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from benchmark.through_ray.process_costs import process_tree
from chaos.harness.fault_series import LABELLED, newest_label_map, time_recovery
from chaos.harness.injection import Injector
from chaos.harness.observed_run import ObservedRun, expect
from chaos.harness.scenario import (
    BYSTANDER,
    FRAMES,
    LINES,
    RecoveryTime,
    ScenarioContext,
    bystander,
    expect_end,
    expect_identical,
    single_fault,
    victim,
)

__all__ = ["SCENARIOS"]

#: Memory left to a run that is to run out of it, and the most that is allocated, bytes.
_LEFT_BYTES, _MOST_TAKEN_BYTES = 4 * 2**30, 8 * 2**30
_TAKEN_AT_ONCE_BYTES = 2**28

#: Until a loss is reported, s.
_NOTICED_SECONDS = 5.0

#: Length of streams that go on while memory is taken, and while nodes are waited for, frames.
_VERY_LONG, _LONG = 24 * FRAMES, 8 * FRAMES


def _folder_gone(context: ScenarioContext) -> None:
    with ObservedRun(LINES, context.folder) as run:
        run.wait_for_frames("victim", int(context.random.integers(1, FRAMES // 2)))
        (run.output / "victim").rename(run.output / "elsewhere")
        stderr = expect_end(run, 1)
        expect("victim" in stderr and "cannot be written" in stderr, f"the error is not reported: {stderr}")
        expect_identical(context, run, BYSTANDER)


def _memory_runs_out(context: ScenarioContext) -> RecoveryTime:
    """Allocate memory until Ray, above a threshold of the machine's memory, ends a process."""
    total, free = _memory()
    threshold = (total - free + _LEFT_BYTES) / total
    expect(threshold < 1, "not injected: less than 4 GB of memory are free")
    settings = {"RAY_memory_usage_threshold": f"{threshold:.4f}", "RAY_memory_monitor_refresh_ms": "100"}
    lines = victim(_VERY_LONG), bystander(_VERY_LONG)
    context.prepare(lines)
    injector = Injector(context.folder / "injector", [LABELLED])
    with ObservedRun(lines, context.folder, injector=injector, settings=settings) as run:
        run.wait_for_frames("victim", int(context.random.integers(8, FRAMES)))
        newest = {name: newest_label_map(run.output / name) for name in ("victim", "bystander")}
        while not _returned(run):  # an idle one may have been ended
            ended = _allocate_until_a_process_is_ended(run)
            time.sleep(_NOTICED_SECONDS)
        back = time_recovery(run, injector, ended, newest, lambda: _returned(run))
        expect_end(run, 0)
        expect_identical(context, run, *lines)
        return back


def _returned(run: ObservedRun) -> set[str]:
    return {name for name, stream in run.status().items() if stream["returns"]}


def _memory() -> tuple[int, int]:
    """Return the memory of the machine, and what of it is available, bytes."""
    lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
    kilobytes = {line.partition(":")[0]: int(line.split()[1]) for line in lines}
    return 1024 * kilobytes["MemTotal"], 1024 * kilobytes["MemAvailable"]


def _allocate_until_a_process_is_ended(run: ObservedRun) -> float:
    """Allocate memory until Ray has ended a process, and free it; return when, monotonic, s."""
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
    """Allocate memory and write to each page (large ones, because that is quicker)."""
    memory = mmap.mmap(-1, size, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)
    memory.madvise(mmap.MADV_HUGEPAGE)
    memory[:: mmap.PAGESIZE] = bytes(size // mmap.PAGESIZE)
    return memory


def _node_lost(context: ScenarioContext) -> RecoveryTime:
    """Remove one of a cluster's three nodes that has a stream, which is restored on another one."""
    from ray.cluster_utils import Cluster

    lines = victim(_LONG), bystander(_LONG)
    context.prepare(lines)
    injector = Injector(context.folder / "injector", [LABELLED])
    with _injected_environment(injector):
        cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False})
        nodes = [cluster.add_node(num_cpus=1) for _ in range(2)]
    try:
        with ObservedRun(lines, context.folder, "--address", cluster.address, injector=injector) as run:
            run.wait_for_frames("victim", int(context.random.integers(8, FRAMES)))
            run.wait_for_frames("bystander", int(context.random.integers(8, FRAMES)))
            newest = {name: newest_label_map(run.output / name) for name in ("victim", "bystander")}
            busy = [node for node in nodes if _has_a_stream(node)]
            expect(bool(busy), "not injected: no stream is on a node that can be lost")
            began = time.monotonic()
            cluster.remove_node(busy[int(context.random.integers(len(busy)))], allow_graceful=False)
            back = time_recovery(run, injector, began, newest, lambda: _returned(run))
            expect_end(run, 0)
            expect_identical(context, run, *lines)
            return back
    finally:
        cluster.shutdown()  # type: ignore[no-untyped-call]


@contextmanager
def _injected_environment(injector: Injector) -> Iterator[None]:
    """Give the injector's environment to the processes that are started in the ``with`` block."""
    before = os.environ.get("PYTHONPATH")
    os.environ["PYTHONPATH"] = injector.environment()["PYTHONPATH"]
    try:
        yield
    finally:
        if before is None:
            del os.environ["PYTHONPATH"]
        else:
            os.environ["PYTHONPATH"] = before


def _has_a_stream(node: Any) -> bool:
    """Return whether a node of Ray's cluster for tests has processes of a stream."""
    raylet = node.all_processes["raylet"][0].process.pid
    return any(one.title.startswith("ray::SegmenterActor") for one in process_tree(raylet).values())


SCENARIOS = (
    single_fault("18", "a node of three lost with its stream", _node_lost),
    single_fault("23", "output folder gone", _folder_gone),
    single_fault("26", "memory runs out", _memory_runs_out),
)
