"""Threads of others in a process: their timers may come late, those of one's own do not."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from mlbs_actors.actors.node.idle_threads import SLACK_SECONDS

PROGRAM = """
import os
import sys
import threading
from pathlib import Path

from mlbs_actors.actors.node.idle_threads import relax_thread_timers


def slack(thread):
    return int(Path(f"/proc/{thread}/timerslack_ns").read_bytes())


done = threading.Event()
other = threading.Thread(target=done.wait, daemon=True)
other.start()
if sys.argv[1] == "as nobody":
    try:
        os.setuid(65534)
    except PermissionError:
        pass  # nor may this user
before = slack(threading.get_native_id())
relax_thread_timers()
assert slack(threading.get_native_id()) == before
if sys.argv[1] == "as root":
    later = threading.Thread(target=done.wait, daemon=True)
    later.start()
    print(before, slack(other.native_id), slack(later.native_id))
"""


def ran(how: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", PROGRAM, how], capture_output=True, text=True)


def may_set_the_slack_of_others() -> bool:
    """CAP_SYS_NICE among the effective capabilities of this process."""
    status = Path("/proc/self/status")
    if not status.exists():
        return False
    effective = next(line for line in status.read_text("ascii").splitlines() if line.startswith("CapEff"))
    return bool(int(effective.split()[1], 16) >> 23 & 1)


@pytest.mark.skipif(not may_set_the_slack_of_others(), reason="needs CAP_SYS_NICE")
def test_only_the_threads_that_were_there_before_get_slack() -> None:
    own, other, later = map(int, ran("as root").stdout.split())
    assert other == SLACK_SECONDS * 1e9
    assert own == later < 1e6


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="needs /proc")
def test_a_user_who_may_not_is_not_troubled() -> None:
    done = ran("as nobody")
    assert done.returncode == 0, done.stderr
