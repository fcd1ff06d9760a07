"""Threads of others in a process may be late; those of one's own are not."""

from __future__ import annotations

import subprocess
import sys

import pytest

PROGRAM = """
import os
import sys
import threading
import time

from mlbs_actors.actors.node.idle_threads import relax_thread_timers

done = threading.Event()
threading.Thread(target=done.wait, daemon=True).start()
if sys.argv[1] == "nobody":
    try:
        os.setuid(65534)
    except PermissionError:
        pass  # nor may this user
relax_thread_timers()


def sleep(late):
    for _ in range(3):
        began = time.monotonic()
        time.sleep(0.001)
        late.append(time.monotonic() - began)


own, later = [], []
sleep(own)
thread = threading.Thread(target=sleep, args=(later,))
thread.start()
thread.join()
print(max(min(own), min(later)))
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="needs /proc")
@pytest.mark.parametrize("user", ["this one", "nobody"])
def test_the_thread_that_asks_and_the_ones_that_it_starts_later_keep_the_time(user: str) -> None:
    ran = subprocess.run([sys.executable, "-c", PROGRAM, user], capture_output=True, text=True)
    assert ran.returncode == 0, ran.stderr
    assert float(ran.stdout) < 0.1
