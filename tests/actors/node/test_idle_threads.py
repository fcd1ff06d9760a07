"""Threads of others in a process may be late; those of one's own are not."""

from __future__ import annotations

import subprocess
import sys

import pytest

PROGRAM = """
import ctypes
import os
import sys
import threading

from mlbs_actors.actors.node.idle_threads import relax_thread_timers

done = threading.Event()
threading.Thread(target=done.wait, daemon=True).start()
if sys.argv[1] == "nobody":
    try:
        os.setuid(65534)
    except PermissionError:
        pass  # nor may this user
relax_thread_timers()

PR_GET_TIMERSLACK = 30
library = ctypes.CDLL(None)
library.prctl.restype = ctypes.c_long


def tell(slacks):
    slacks.append(library.prctl(PR_GET_TIMERSLACK))


slacks = []
tell(slacks)
thread = threading.Thread(target=tell, args=(slacks,))
thread.start()
thread.join()
print(*slacks)
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="needs /proc")
@pytest.mark.parametrize("user", ["this one", "nobody"])
def test_the_thread_that_asks_and_the_ones_that_it_starts_later_keep_the_time(user: str) -> None:
    ran = subprocess.run([sys.executable, "-c", PROGRAM, user], capture_output=True, text=True)
    assert ran.returncode == 0, ran.stderr
    assert all(0 < int(slack) < 1_000_000 for slack in ran.stdout.split()), "ns"
