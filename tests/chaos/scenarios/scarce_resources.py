"""Remove the output folder, and use up the memory."""

from __future__ import annotations

import mmap
import time
from pathlib import Path

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

#: Length of streams that go on while memory is taken, frames.
_VERY_LONG = 24 * FRAMES


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


SCENARIOS = (
    single_fault("23", "output folder gone", _folder_gone),
    single_fault("26", "memory runs out", _memory_runs_out),
)
