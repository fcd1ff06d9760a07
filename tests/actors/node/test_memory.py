"""How much memory a node has, by the machine and by its control groups."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from mlbs_actors.actors.node.memory import NodeMemory, node_memory, unique_memory


def machine(folder: Path, groups: str) -> Path:
    """A machine of 8000 KiB, 5000 of them available, for a process in these control groups."""
    (folder / "self").mkdir(parents=True)
    (folder / "self" / "cgroup").write_text(groups)
    (folder / "meminfo").write_text("MemTotal: 8000 kB\nMemFree: 9 kB\nMemAvailable:     5000 kB\nHuge: 0\n")
    return folder


def group(folder: Path, limit: str, used: int) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "memory.max").write_text(f"{limit}\n")
    (folder / "memory.current").write_text(f"{used}\n")
    (folder / "memory.stat").write_text("anon 7\ninactive_file 500\nactive_file 9\n")


def test_a_machine_without_control_groups_has_what_it_says(tmp_path: Path) -> None:
    proc = machine(tmp_path / "proc", "0::/\n")
    assert node_memory(proc, tmp_path / "none") == NodeMemory(8000 * 1024, 5000 * 1024)


@pytest.mark.parametrize(
    ("own", "above", "expected"),
    [
        ("max", "max", (8000 * 1024, 5000 * 1024)),
        ("90000", "max", (90_000, 90_000 - 40_000 + 500)),
        ("max", "70000", (70_000, 70_000 - 40_000 + 500)),  # the least of all levels
        ("90000", "70000", (70_000, 70_000 - 40_000 + 500)),
        ("99999999", "max", (8000 * 1024, 5000 * 1024)),
    ],
)
def test_the_least_of_machine_and_control_groups_counts_without_unused_pages_of_files(
    tmp_path: Path, own: str, above: str, expected: tuple[int, int]
) -> None:
    proc = machine(tmp_path / "proc", "0::/service/run\n")
    group(tmp_path / "groups" / "service", above, 40_000)
    group(tmp_path / "groups" / "service" / "run", own, 40_000)
    assert node_memory(proc, tmp_path / "groups") == NodeMemory(*expected)


def test_a_container_s_limit_is_found_where_its_group_is_the_uppermost(tmp_path: Path) -> None:
    proc = machine(tmp_path / "proc", "0::/docker/4711\n")
    group(tmp_path / "groups", "60000", 20_000)
    assert node_memory(proc, tmp_path / "groups") == NodeMemory(60_000, 40_500)


def test_control_groups_of_version_1_count_too(tmp_path: Path) -> None:
    proc = machine(tmp_path / "proc", "9:name=systemd:/\n4:memory:/run\n1:cpu:/\n0::/\n")
    own = tmp_path / "groups" / "memory" / "run"
    own.mkdir(parents=True)
    (own / "memory.limit_in_bytes").write_text("90000\n")
    (own / "memory.usage_in_bytes").write_text("30000\n")
    (own / "memory.stat").write_text("inactive_file 1\ntotal_inactive_file 400\n")
    assert node_memory(proc, tmp_path / "groups") == NodeMemory(90_000, 60_400)


def test_a_reserve_is_not_free() -> None:
    gibibyte = 2**30
    assert NodeMemory(100 * gibibyte, 30 * gibibyte).free == 20 * gibibyte
    assert NodeMemory(2 * gibibyte, gibibyte // 4).free == -gibibyte // 4


def test_this_machine_and_this_process_have_memory() -> None:
    here = node_memory()
    assert 2**20 < here.available <= here.total
    assert 2**20 < unique_memory(os.getpid()) < here.total
    assert unique_memory(2**22 + 1) == 0  # past the largest process id
