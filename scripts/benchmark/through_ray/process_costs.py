"""Read the CPU time and private memory of a process and all its descendants, by kind of process.

The source is ``/proc``. The kind of one of our actors is known by the name that Ray gives its process,
``ray::ReaderActor.serve``; whatever else descends from the driver is Ray's own.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

__all__ = [
    "DRIVER",
    "LAYER",
    "RAY",
    "Process",
    "cpu_growth",
    "kinds_of",
    "private_bytes",
    "process_tree",
    "sum_by_kind",
]

#: Kinds that are no actors, and actors whose role is not known.
DRIVER, RAY, LAYER = "driver", "Ray's own", "layer"

_ACTOR = re.compile(r"ray::(\w+)")
_KIND_OF_ACTOR = {
    "ReaderActor": "reader",
    "CoordinatorActor": "coordinator",
    "LayerActor": LAYER,
    "SegmenterActor": "segmenter",
    "SinkActor": "sink",
    "PoolActor": "pool",
}


@dataclass(frozen=True, slots=True)
class Process:
    """A process at one moment.

    Attributes
    ----------
    pid, parent : int
    title : str
        Its command line.
    cpu_seconds : float
        User and system time of all its threads since its start, s.
    started : int
        When, by the kernel's clock, ticks: process ids are reused, but not with the same start.
    """

    pid: int
    parent: int
    title: str
    cpu_seconds: float
    started: int


def process_tree(root: int, proc: Path = Path("/proc")) -> dict[int, Process]:
    """Return a process and all that descend from it, by process id.

    Parameters
    ----------
    root : int
        Process id.
    proc : Path
        Where the kernel lists processes.
    """
    known = [_read(folder) for folder in proc.iterdir() if folder.name.isdecimal()]
    children: dict[int, list[Process]] = {}
    for process in known:
        if process is not None:
            children.setdefault(process.parent, []).append(process)
    found = {process.pid: process for process in known if process is not None and process.pid == root}
    waiting = list(found)
    while waiting:
        for child in children.get(waiting.pop(), []):
            found[child.pid] = child
            waiting.append(child.pid)
    return found


def _read(folder: Path) -> Process | None:
    try:
        # The name, in parentheses, may hold spaces and parentheses itself.
        fields = (folder / "stat").read_text(errors="replace").rpartition(")")[2].split()
        title = (folder / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace").strip()
    except OSError:
        return None  # it has ended meanwhile
    ticks = int(fields[11]) + int(fields[12])
    cpu_seconds = ticks / os.sysconf("SC_CLK_TCK")
    return Process(int(folder.name), int(fields[1]), title, cpu_seconds, int(fields[19]))


def kinds_of(tree: Mapping[int, Process], driver: int, layers: Mapping[int, str]) -> dict[int, str]:
    """Return the kind of each process of a session.

    Parameters
    ----------
    tree : mapping of int to Process
        From :func:`process_tree`.
    driver : int
        Process id of the driver.
    layers : mapping of int to str
        Roles of the layer processes, where they are known; the others are :data:`LAYER`.
    """
    kinds = {}
    for pid, process in tree.items():
        actor = _ACTOR.match(process.title)
        kind = _KIND_OF_ACTOR.get(actor[1], RAY) if actor else RAY
        kinds[pid] = DRIVER if pid == driver else layers.get(pid, LAYER) if kind == LAYER else kind
    return kinds


def cpu_growth(before: Mapping[int, Process], after: Mapping[int, Process]) -> dict[int, float]:
    """Return the CPU seconds that each process has used between two moments.

    One that was started in between counts whole; one that ended in between is left out.
    """
    return {
        pid: process.cpu_seconds - (before[pid].cpu_seconds if pid in before else 0.0)
        for pid, process in after.items()
    }


def sum_by_kind(values: Mapping[int, float], kinds: Mapping[int, str]) -> dict[str, float]:
    """Sum a figure of each process over the processes of a kind, in the order of the kinds' names."""
    sums: dict[str, float] = {}
    for pid, value in values.items():
        sums[kinds[pid]] = sums.get(kinds[pid], 0.0) + value
    return dict(sorted(sums.items()))


def private_bytes(pid: int, proc: Path = Path("/proc")) -> int:
    """Return the memory that would be freed if a process ended (its unique set size), bytes; 0 if it has."""
    try:
        lines = (proc / str(pid) / "smaps_rollup").read_text(encoding="ascii").splitlines()
    except OSError:
        return 0
    return 1024 * sum(int(line.split()[1]) for line in lines if line.startswith("Private_"))
