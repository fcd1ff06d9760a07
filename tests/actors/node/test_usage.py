"""What a stream's processes take, by what the system says of them."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from mlbs_actors.actors.node.usage import StreamUsage


def process(proc: Path, pid: int, seconds: float, pages: int) -> None:
    ticks = round(seconds * os.sysconf("SC_CLK_TCK"))
    (proc / str(pid)).mkdir(exist_ok=True)
    (proc / str(pid) / "stat").write_text(f"{pid} (ray::A (x)) S {'0 ' * 10}{ticks - 3} 3 0 0")
    (proc / str(pid) / "statm").write_text(f"900 {pages + 7} 7 0 0 0 0")


def test_only_what_processes_take_while_they_belong_to_the_stream_counts(tmp_path: Path) -> None:
    usage, page = StreamUsage(tmp_path), os.sysconf("SC_PAGE_SIZE")
    process(tmp_path, 1, 5.0, 100)
    usage.measure([1])
    assert (usage.cpu_seconds, usage.memory) == (0.0, 100 * page)
    process(tmp_path, 1, 6.5, 120)
    process(tmp_path, 2, 40.0, 10)
    usage.measure([1, 2])
    assert usage.cpu_seconds == pytest.approx(1.5)
    assert usage.memory == 130 * page
    process(tmp_path, 2, 40.5, 10)
    usage.measure([1, 2, 3])  # 3 has ended already
    usage.measure([1])
    assert usage.cpu_seconds == pytest.approx(2.0)
    assert usage.memory == 120 * page


def test_this_process_is_seen_at_work() -> None:
    usage = StreamUsage()
    usage.measure([os.getpid()])
    while usage.cpu_seconds == 0.0:
        usage.measure([os.getpid()])
    assert usage.memory > 2**20
