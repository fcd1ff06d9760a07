"""An event that wakes a process: once each time it is set, and for good when its owner is gone."""

from __future__ import annotations

import gc
import os
import subprocess
import sys
import time
from dataclasses import astuple, replace
from pathlib import Path

import pytest

from mlbs_actors.actors.ipc.wakeup import WakeupEvent, wait_until_woken

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="needs /proc")

LISTENER = """
import sys

from mlbs_actors.actors.ipc.wakeup import WakeupHandle, wait_until_woken

for turn in range(int(sys.argv[4])):
    wait_until_woken(WakeupHandle(*map(int, sys.argv[1:4])))
    print(turn, flush=True)
"""

OWNER = """
import sys
from dataclasses import astuple

from mlbs_actors.actors.ipc.wakeup import WakeupEvent

wakeup = WakeupEvent()
print(*astuple(wakeup.handle), flush=True)
sys.stdin.read()
"""


def listener(*handle: int, turns: int) -> subprocess.Popen[str]:
    arguments = [str(number) for number in (*handle, turns)]
    return subprocess.Popen([sys.executable, "-c", LISTENER, *arguments], stdout=subprocess.PIPE, text=True)


def test_each_ring_ends_one_wait_also_of_who_listens_later() -> None:
    wakeup = WakeupEvent()
    wakeup.wake()
    with listener(*astuple(wakeup.handle), turns=3) as listening:
        assert listening.stdout is not None
        assert listening.stdout.readline() == "0\n"
        with pytest.raises(subprocess.TimeoutExpired):
            listening.wait(0.3)
        wakeup.wake()
        assert listening.stdout.readline() == "1\n"
        wakeup.wake()
        assert listening.wait(180) == 0
    wakeup.close()
    wakeup.close()
    wakeup.wake()


def test_who_waits_goes_on_when_the_owner_is_gone() -> None:
    with subprocess.Popen(
        [sys.executable, "-c", OWNER], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as owner:
        assert owner.stdout is not None
        handle = [int(number) for number in owner.stdout.readline().split()]
        with listener(*handle, turns=1) as listening:
            time.sleep(0.3)
            assert listening.poll() is None
            owner.kill()
            assert listening.wait(180) == 0


def test_who_is_told_of_a_bell_that_is_none_any_more_does_not_wait(tmp_path: Path) -> None:
    wakeup = WakeupEvent()
    wait_until_woken(replace(wakeup.handle, inode=wakeup.handle.inode + 1))
    wait_until_woken(replace(wakeup.handle, descriptor=os.sysconf("SC_OPEN_MAX") - 1))
    wakeup.close()
    wait_until_woken(wakeup.handle)


def test_who_waits_goes_on_when_the_event_is_dropped() -> None:
    wakeup = WakeupEvent()
    with listener(*astuple(wakeup.handle), turns=2) as listening:
        assert listening.stdout is not None
        wakeup.wake()
        assert listening.stdout.readline() == "0\n"
        del wakeup
        gc.collect()
        assert listening.wait(180) == 0
