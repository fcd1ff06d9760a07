"""Who is being made ready gives way, and only where it can take its place again."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from mlbs_actors.actors.node.priority import stepping_back

#: Steps back and comes back.
_THERE_AND_BACK = """
import os
os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
"""

#: Prints the policy within and after, as a user who may not come back.
_AS_NOBODY = """
import os, resource
from mlbs_actors.actors.node.priority import stepping_back
resource.setrlimit(resource.RLIMIT_NICE, (0, 0))
if os.getuid() == 0:
    os.setuid(65534)
with stepping_back():
    print(os.sched_getscheduler(0))
print(os.sched_getscheduler(0))
"""


def _fails() -> None:
    with stepping_back():
        raise ZeroDivisionError


def _may_come_back() -> bool:
    return subprocess.run([sys.executable, "-c", _THERE_AND_BACK], stderr=subprocess.DEVNULL).returncode == 0


@pytest.mark.skipif(not _may_come_back(), reason="the system does not let this user come back")
def test_a_thread_gives_way_and_takes_its_place_again_also_after_an_error() -> None:
    before = os.sched_getscheduler(0)
    with stepping_back():
        assert os.sched_getscheduler(0) == os.SCHED_IDLE
    assert os.sched_getscheduler(0) == before
    with pytest.raises(ZeroDivisionError):
        _fails()
    assert os.sched_getscheduler(0) == before


def test_who_could_not_come_back_does_not_step_back() -> None:
    before = os.sched_getscheduler(0)
    ran = subprocess.run([sys.executable, "-c", _AS_NOBODY], capture_output=True, text=True, check=False)
    assert ran.stdout.split() == [str(before)] * 2, ran.stderr
