"""The number of threads: one inside, whatever it was outside."""

from __future__ import annotations

import subprocess
import sys

import cv2
import pytest
import scipy.linalg  # noqa: F401  (brings a BLAS of its own, which must be limited too)
from threadpoolctl import threadpool_info  # type: ignore[import-untyped]

from mlbs_actors.determinism import single_threaded


def thread_counts() -> dict[str, int]:
    """Threads each numerical library of this process would use now."""
    counts = {"opencv": cv2.getNumThreads()}
    return counts | {pool["filepath"]: int(pool["num_threads"]) for pool in threadpool_info()}


@pytest.fixture(autouse=True)
def _two_opencv_threads() -> object:
    before = cv2.getNumThreads()
    cv2.setNumThreads(2)
    yield
    cv2.setNumThreads(before)


def test_every_library_computes_in_one_thread_inside_the_block_and_as_before_after_it() -> None:
    before = thread_counts()
    assert len(before) > 1, "a BLAS must be loaded for this test to mean anything"
    with single_threaded():
        assert set(thread_counts().values()) == {1}
    assert thread_counts() == before


def test_the_threads_are_restored_after_an_exception() -> None:
    before = thread_counts()
    with pytest.raises(ZeroDivisionError), single_threaded():
        _ = 1 // 0
    assert thread_counts() == before


def test_leaving_an_inner_block_keeps_the_outer_one_single_threaded() -> None:
    with single_threaded():
        with single_threaded():
            pass
        assert set(thread_counts().values()) == {1}


@pytest.mark.parametrize("loaded", ["before", "after"])
def test_a_limited_process_computes_in_one_thread_for_good(loaded: str) -> None:
    libraries = "import cv2, os, scipy.linalg; from threadpoolctl import threadpool_info"
    limit = "from mlbs_actors.determinism import limit_process; limit_process()"
    count = (
        "print({cv2.getNumThreads(), int(os.environ['OMP_NUM_THREADS'])}"
        " | {pool['num_threads'] for pool in threadpool_info()})"
    )
    program = [libraries, limit, count] if loaded == "before" else [limit, libraries, count]
    ran = subprocess.run(
        [sys.executable, "-c", "\n".join(program)], capture_output=True, text=True, check=True
    )
    assert ran.stdout.strip() == "{1}"


def test_numba_still_compiles_after_the_limit_was_set() -> None:
    program = (
        "import numba; from mlbs_actors.determinism import limit_process; limit_process()\n"
        "print(numba.njit(lambda x: x + 1)(1))"
    )
    ran = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert ran.stdout.strip() == "2"
