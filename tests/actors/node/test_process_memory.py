"""That a process does not ask again for memory that it has freed, nor looks through what it has loaded."""

from __future__ import annotations

import subprocess
import sys

import pytest


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="a setting of the GNU C library")
def test_the_arrays_of_a_frame_take_the_memory_of_the_one_before() -> None:
    program = """
import resource

import numpy as np

from mlbs_actors.actors.node.process_memory import settle_memory


def faults():
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    [np.ones((480, 640, 4), np.int32) for _ in range(8)]  # 5 MB each
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before


faults()
given_back = faults()
settle_memory()
faults()
print(faults() < given_back / 10)
"""
    ran = subprocess.run([sys.executable, "-c", program], capture_output=True, check=True)
    assert ran.stdout.strip() == b"True"


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
