"""What the processes of a stream take of their node: CPU time and memory."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

from mlbs_actors.actors.node.memory import unique_memory

__all__ = ["StreamUsage"]


class StreamUsage:
    """CPU time and memory of a changing set of processes.

    Parameters
    ----------
    proc : Path
        Where the system shows processes.

    Attributes
    ----------
    cpu_seconds : float
        CPU time that they have taken while they belonged to the stream, s.
    memory : int
        Unique memory of the present ones, bytes.
    """

    def __init__(self, proc: Path = Path("/proc")) -> None:
        self.cpu_seconds = 0.0
        self.memory = 0
        self._proc = proc
        self._seen: dict[int, float] = {}

    def measure(self, processes: Iterable[int]) -> None:
        """Measure the processes that belong to the stream now; what a new one took before does not count."""
        now = {pid: self._cpu_seconds(pid) for pid in processes}
        self.cpu_seconds += sum(seconds - self._seen.get(pid, seconds) for pid, seconds in now.items())
        self.memory = sum(unique_memory(pid, self._proc) for pid in now)
        self._seen = now

    def _cpu_seconds(self, pid: int) -> float:
        """Return a process's CPU time, s; what was seen last if it has ended."""
        try:
            stat = (self._proc / str(pid) / "stat").read_text(encoding="utf-8", errors="replace")
        except OSError:
            return self._seen.get(pid, 0.0)
        fields = stat.rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
