"""A bell that another process waits for: it rings once for each time, and for good when its owner is gone."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from dataclasses import astuple, replace
from pathlib import Path

import pytest

from mlbs_actors.actors.ipc.wakeup import Bell, await_bell

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="needs /proc")

LISTENER = """
import sys

from mlbs_actors.actors.ipc.wakeup import BellRope, await_bell

for turn in range(int(sys.argv[4])):
    await_bell(BellRope(*map(int, sys.argv[1:4])))
    print(turn, flush=True)
"""

OWNER = """
import sys
from dataclasses import astuple

from mlbs_actors.actors.ipc.wakeup import Bell

bell = Bell()
print(*astuple(bell.rope), flush=True)
sys.stdin.read()
"""


def listener(*rope: int, turns: int) -> subprocess.Popen[str]:
    arguments = [str(number) for number in (*rope, turns)]
    return subprocess.Popen([sys.executable, "-c", LISTENER, *arguments], stdout=subprocess.PIPE, text=True)


def test_each_ring_ends_one_wait_also_of_who_listens_later() -> None:
    bell = Bell()
    bell.ring()
    with listener(*astuple(bell.rope), turns=3) as listening:
        assert listening.stdout is not None
        assert listening.stdout.readline() == "0\n"
        with pytest.raises(subprocess.TimeoutExpired):
            listening.wait(0.3)
        bell.ring()
        assert listening.stdout.readline() == "1\n"
        bell.ring()
        assert listening.wait(10) == 0
    bell.close()
    bell.ring()


def test_who_waits_goes_on_when_the_owner_is_gone() -> None:
    with subprocess.Popen(
        [sys.executable, "-c", OWNER], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as owner:
        assert owner.stdout is not None
        rope = [int(number) for number in owner.stdout.readline().split()]
        with listener(*rope, turns=1) as listening:
            time.sleep(0.3)
            assert listening.poll() is None
            owner.kill()
            assert listening.wait(10) == 0


def test_who_is_told_of_a_bell_that_is_none_any_more_does_not_wait(tmp_path: Path) -> None:
    bell = Bell()
    await_bell(replace(bell.rope, inode=bell.rope.inode + 1))
    await_bell(replace(bell.rope, descriptor=os.sysconf("SC_OPEN_MAX") - 1))
    bell.close()
    await_bell(bell.rope)
