"""What is kept of compiled functions is no older than what they call."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numba
import numpy as np
import pytest

from mlbs_actors import errors
from mlbs_actors.kernels import jit, machine_code
from mlbs_actors.kernels.jit import compiled

config: Any = numba.config

CALLER = """
from mlbs_actors.kernels import jit, machine_code
from mlbs_actors.deeper.called import STEP, one

known = machine_code.has_machine_code()

@jit.compiled
def total():
    return STEP * one()

print(total(), sum(total.stats.cache_hits.values()), int(known))
"""

CALLED = """
from mlbs_actors.kernels.jit import compiled

STEP = {step}

@compiled
def one():
    return {value}
"""


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """A package with the decorator, and a kernel that calls another one of a sub-package."""
    folder = tmp_path / "mlbs_actors"
    for name in ("deeper", "kernels"):
        (folder / name).mkdir(parents=True)
    for module, home in ((jit, "kernels"), (machine_code, "kernels"), (errors, "")):
        source = Path(str(module.__file__))
        (folder / home / source.name).write_text(source.read_text())
    for name in ("__init__", "deeper/__init__", "kernels/__init__"):
        (folder / f"{name}.py").touch()
    (folder / "caller.py").write_text(CALLER)
    return folder


def run(package: Path, step: int, value: int, **environment: str) -> tuple[int, int, bool]:
    """What a kernel gives whose constant and callee come from elsewhere; how often it was kept; and whether
    machine code was known to be there."""
    (package / "deeper/called.py").write_text(CALLED.format(step=step, value=value))
    done = subprocess.run(
        [sys.executable, "-c", "import mlbs_actors.caller"],
        cwd=package.parent,
        env={**os.environ, "PYTHONPATH": str(package.parent), **environment},
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    result, kept, known = map(int, done.stdout.split())
    return result, kept, bool(known)


@pytest.mark.long
def test_a_change_of_another_module_reaches_the_functions_that_use_it(package: Path) -> None:
    assert run(package, 2, 10) == (20, 0, False)
    assert run(package, 2, 10) == (20, 1, True)
    assert run(package, 2, 11) == (22, 0, False)
    assert run(package, 30, 11) == (330, 0, False)


def test_machine_code_of_the_newest_versions_only_is_kept(package: Path) -> None:
    for age in range(5):
        before = package / f"__pycache__/kernels-{age}"
        before.mkdir(parents=True)
        os.utime(before, (1e9 - age, 1e9 - age))
    run(package, 2, 10)
    own, *others = sorted((package / "__pycache__").glob("kernels-*"), key=os.path.getmtime, reverse=True)
    assert [*own.rglob("*")]
    assert [other.name for other in others] == ["kernels-0", "kernels-1"]


def test_beside_a_package_that_is_read_only_the_user_s_cache_takes_the_machine_code(
    package: Path, tmp_path: Path
) -> None:
    cache = tmp_path / "cache"
    (package / "__pycache__").write_text("nothing can be put into a file")
    assert run(package, 2, 10, XDG_CACHE_HOME=str(cache)) == (20, 0, False)
    assert run(package, 2, 10, XDG_CACHE_HOME=str(cache)) == (20, 1, True)
    assert [folder.name for folder in cache.iterdir()] == ["mlbs-actors"]


def test_the_place_of_a_caller_s_own_kernels_stays_as_it_is() -> None:
    before = config.CACHE_DIR

    @compiled
    def twice(values: np.ndarray) -> np.ndarray:
        return 2 * values

    assert before == config.CACHE_DIR
    assert twice(np.ones(2)).tolist() == [2.0, 2.0]
