"""Arrays that kernels make are whole and apart, in blocks that are used again, and end with the program."""

from __future__ import annotations

import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from mlbs_actors.array_memory import LARGEST
from mlbs_actors.compilation import compiled
from mlbs_actors.messages import Array


@compiled(nogil=True)
def _filled(size: int, value: int) -> Array:
    made = np.empty(size, np.uint8)
    made[:] = value
    return made


@compiled(nogil=True)
def _made_and_left(size: int, times: int) -> int:
    """How often an array did not hold what was written to it."""
    wrong = 0
    for turn in range(times):
        one, other = np.empty(size, np.int64), np.empty(size + turn % 7, np.int64)
        one[:], other[:] = turn, -turn
        wrong += int((one != turn).any() or (other != -turn).any())
    return wrong


def test_arrays_begin_with_a_line_of_the_caches() -> None:
    kept = [_filled(size, 0) for size in range(1, 2000, 7)]
    assert all(array.ctypes.data % 64 == 0 for array in kept)


@pytest.mark.parametrize("size", [1, 900, 5_000, 70_000, LARGEST])
def test_the_next_array_takes_the_memory_of_the_one_that_is_gone(size: int) -> None:
    first = _filled(size, 1)
    place = first.ctypes.data
    del first
    assert _filled(size, 2).ctypes.data == place
    kept = _filled(size, 3)
    assert _filled(size, 4).ctypes.data != kept.ctypes.data


def test_arrays_of_all_sizes_hold_what_is_written_to_them_until_they_are_gone() -> None:
    rng = np.random.default_rng(5)
    sizes = [*range(200), *(2 ** np.arange(8, 20)), *(2 ** np.arange(8, 20) - 64), LARGEST, LARGEST + 1]
    held: list[tuple[int, int, Array]] = []
    for turn in range(3_000):
        size, value = int(rng.choice(sizes)), turn % 251
        held.append((size, value, _filled(size, value)))
        if len(held) > 60:
            size, value, array = held.pop(int(rng.integers(len(held))))
            assert array.size == size
            assert (array == value).all()
    for size, value, array in held:
        assert array.size == size
        assert (array == value).all()


def test_no_more_memory_is_taken_than_was_needed_at_once() -> None:
    places = set()
    for turn in range(500):
        kept = [_filled(3_000, turn % 200) for _ in range(4)]
        places |= {array.ctypes.data for array in kept}
        kept.clear()
    assert len(places) <= 8


def test_threads_make_arrays_at_once() -> None:
    _made_and_left(10, 1)
    with ThreadPoolExecutor(4) as threads:
        wrong = threads.map(_made_and_left, [50, 50, 300, 900], [20_000] * 4)
    assert list(wrong) == [0, 0, 0, 0]


def test_a_program_ends_well_that_still_holds_arrays() -> None:
    script = """
import builtins
from mlbs_actors.patch_search import patch_places
class Ring: pass
ring = Ring()
ring.own, ring.array = ring, patch_places(0, 100, 5)
builtins.left = [patch_places(0, 200, 5)]
class Last:
    def __init__(self): self.array = patch_places(0, 300, 5)
    def __del__(self): del self.array
builtins.last = Last()
"""
    ended = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr
    assert ended.stderr == ""
