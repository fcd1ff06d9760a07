"""That a process does not ask again for memory that it has freed, nor looks through what it has loaded."""

from __future__ import annotations

import subprocess
import sys

import pytest

PROGRAM = """
import resource
import sys

import numpy as np

from mlbs_actors.actors.node.process_memory import settle_memory

if sys.argv[1] == "kept":
    settle_memory()


def frame():
    arrays = [np.ones((480, 640, 4), np.int32) for _ in range(8)]  # 5 MB each
    return len(arrays)


frame()
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
for _ in range(5):
    frame()
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="a setting of the GNU C library")
def test_arrays_of_a_second_frame_take_the_memory_of_the_first() -> None:
    faults = {
        how: int(subprocess.run([sys.executable, "-c", PROGRAM, how], capture_output=True, check=True).stdout)
        for how in ("given back", "kept")
    }
    assert faults["given back"] > 10_000
    assert faults["kept"] < 500


def test_what_was_loaded_before_is_not_looked_through_for_garbage_again() -> None:
    program = """
import gc

from mlbs_actors.actors.node.process_memory import settle_memory

loaded = [[number] for number in range(1_000)]
settle_memory()
print(len(gc.get_objects()))
"""
    ran = subprocess.run([sys.executable, "-c", program], capture_output=True, check=True)
    assert int(ran.stdout) < 1_000
