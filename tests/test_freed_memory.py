"""Memory that is freed is not fetched again."""

from __future__ import annotations

import platform
import subprocess
import sys

import pytest

PROGRAM = """
import resource
import numpy as np
{keep}
def temporaries():
    blocks = [np.ones(40_000) for _ in range(50)]  # 16 MB together, each fetched by itself at first
for _ in range(3):
    temporaries()
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
for _ in range(10):
    temporaries()
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""
KEEP = "from mlbs_actors.freed_memory import keep_freed_memory; keep_freed_memory()"


def page_faults(keep: str) -> int:
    program = PROGRAM.format(keep=keep)
    return int(
        subprocess.run([sys.executable, "-c", program], check=True, capture_output=True, text=True).stdout
    )


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="another C library has no such setting")
def test_temporaries_use_the_same_pages_again() -> None:
    assert page_faults("") > 5_000
    assert page_faults(KEEP) < 500
