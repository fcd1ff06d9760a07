"""How much memory a node has for processes, and how much one takes.

Control groups (containers, services) limit it, too; the smallest limit counts. Inactive pages of files are
available, as the system drops them when needed.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

__all__ = ["LAYER_BYTES", "STREAM_BYTES", "NodeMemory", "node_memory", "unique_memory"]

#: Unique memory of a stream's reader, coordinator, segmenter and background at 640×480, bytes, as measured in
#: docs/scaling.md.
STREAM_BYTES = 610 * 2**20

#: The same of an object's process; a pool with larger ones expects more.
LAYER_BYTES = 140 * 2**20

#: What stays free: this share of the node's memory, and at least so many bytes. Processes grow as their
#: objects do, and Ray ends one when less than a twentieth is left.
_RESERVED_SHARE, _LEAST_RESERVED = 0.1, 512 * 2**20

#: Of control groups of version 2 and 1: the files of limit and usage, and the unused pages in memory.stat.
_GROUP_FILES = {
    "": ("memory.max", "memory.current", "inactive_file"),
    "memory": ("memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file"),
}


@dataclass(frozen=True, slots=True)
class NodeMemory:
    """Memory of a node.

    Attributes
    ----------
    total : int
        Limit of its use, bytes.
    available : int
        Unused part of it, bytes.
    """

    total: int
    available: int

    @property
    def free(self) -> int:
        """Memory for new processes, bytes; negative if the reserve is in use."""
        return self.available - max(round(_RESERVED_SHARE * self.total), _LEAST_RESERVED)


def node_memory(proc: Path = Path("/proc"), cgroups: Path = Path("/sys/fs/cgroup")) -> NodeMemory:
    """Measure this node: the machine, and the control groups of this process."""
    fields = (line.split() for line in (proc / "meminfo").read_text(encoding="ascii").splitlines())
    machine = {name: 1024 * int(size) for name, size, *_ in fields}
    within = [(machine["MemTotal:"], machine["MemAvailable:"]), *_groups(proc, cgroups)]
    return NodeMemory(min(total for total, _ in within), min(available for _, available in within))


def unique_memory(pid: int, proc: Path = Path("/proc")) -> int:
    """Return a process's unique memory (its unique set size without files), bytes; 0 if it has ended."""
    try:
        _, resident, shared, *_ = (proc / str(pid) / "statm").read_text(encoding="ascii").split()
    except OSError:
        return 0
    return (int(resident) - int(shared)) * os.sysconf("SC_PAGE_SIZE")


def _groups(proc: Path, cgroups: Path) -> Iterator[tuple[int, int]]:
    """Yield the limit of each control group that has one, and what is left of it, bytes."""
    for line in (proc / "self" / "cgroup").read_text(encoding="utf-8").splitlines():
        _, controllers, path = line.split(":", 2)
        if controllers not in _GROUP_FILES:
            continue
        limit, usage, unused = _GROUP_FILES[controllers]
        own = cgroups / controllers / path.lstrip("/")
        for group in (own, *own.parents):  # a container sees its own group as the topmost
            try:
                most, used = (int((group / name).read_text(encoding="ascii")) for name in (limit, usage))
                statistics = (group / "memory.stat").read_text(encoding="ascii").splitlines()
            except (OSError, ValueError):  # no such group, or no limit ("max")
                continue
            figures = dict(statistic.split() for statistic in statistics)
            yield most, most - used + int(figures[unused])
