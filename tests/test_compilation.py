"""What is kept of compiled functions is no older than what they call."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from numba.core.dispatcher import Dispatcher
from numba.core.errors import NumbaError

from mlbs_actors import compilation
from mlbs_actors.actors.parts import has_kernels
from mlbs_actors.claim_labelling import label_claims
from mlbs_actors.messages import Array

_CALLER = """
from mlbs_actors.called import STEP, one
from mlbs_actors.compilation import compiled

@compiled()
def total():
    return STEP * one()

print(total(), sum(total.stats.cache_hits.values()))
"""

_CALLED = """
from mlbs_actors.compilation import compiled

STEP = {step}

@compiled()
def one():
    return {value}
"""


def run(package: Path, step: int, value: int) -> tuple[int, int]:
    """What a function gives whose constant and function come from another module; how often it was kept."""
    called = package / "called.py"
    if called.read_text() != (text := _CALLED.format(step=step, value=value)):
        called.write_text(text)
    done = subprocess.run(
        [sys.executable, "-c", "import mlbs_actors.caller"],
        cwd=package.parent,
        env={**os.environ, "PYTHONPATH": str(package.parent)},
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    result, kept = done.stdout.split()
    return int(result), int(kept)


def test_a_change_of_another_module_reaches_the_functions_that_use_it(tmp_path: Path) -> None:
    package = tmp_path / "mlbs_actors"
    package.mkdir()
    source = Path(compilation.__file__).read_text()
    for name, text in (("__init__", ""), ("compilation", source), ("called", ""), ("caller", _CALLER)):
        (package / f"{name}.py").write_text(text)
    assert run(package, 2, 10) == (20, 0)
    assert run(package, 2, 10) == (20, 1)
    assert run(package, 2, 11) == (22, 0)
    assert run(package, 30, 11) == (330, 0)


_LATE_CALLER = """
from mlbs_actors.called import one
from mlbs_actors.compilation import compiled

first = one()
kept = sum(one.stats.cache_hits.values())

@compiled()
def twice():
    return 2 * one()

print(first + twice(), kept)
"""


@pytest.mark.parametrize("loaded", [False, True])
def test_a_kernel_that_was_kept_can_be_built_into_others(tmp_path: Path, loaded: bool) -> None:
    package = tmp_path / "mlbs_actors"
    package.mkdir()
    source = Path(compilation.__file__).read_text()
    for name, text in (("__init__", ""), ("compilation", source), ("called", ""), ("caller", _LATE_CALLER)):
        (package / f"{name}.py").write_text(text)
    if loaded:
        run(package, 2, 10)
        for kept in (package / "__pycache__").glob("caller.twice*"):  # which is to be built again
            kept.unlink()
    assert run(package, 2, 10) == (30, int(loaded))


def test_kernels_are_kept_that_are_younger_than_the_modules(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    assert isinstance(label_claims, Dispatcher)  # the one that is looked for
    module = tmp_path / "claim_labelling.py"
    kept = tmp_path / "__pycache__/claim_labelling.label_claims-1.py311.nbi"
    module.touch()
    assert not has_kernels(tmp_path)
    kept.parent.mkdir()
    kept.touch()
    os.utime(module, (1, 1))
    assert has_kernels(tmp_path)
    os.utime(kept, (0, 0))  # of a version before
    assert not has_kernels(tmp_path)
    monkeypatch.setenv("NUMBA_CACHE_DIR", "/elsewhere")  # where nobody looks
    assert has_kernels(tmp_path)


@compilation.compiled(in_place=True)
def _add_row(row: Array, total: Array) -> None:
    part = row[:]
    for place in range(part.size):
        total[place] += part[place]


@compilation.compiled(in_place=True)
def _make_array(values: Array) -> float:
    return float(np.zeros(values.size)[0])


@compilation.compiled(in_place=True)
def _give_part(values: Array) -> Array:
    return values[1:]


def test_a_kernel_in_place_leaves_arrays_to_those_who_made_them() -> None:
    rows, total = np.arange(12.0).reshape(3, 4), np.zeros(4)
    before = sys.getrefcount(rows), sys.getrefcount(total)
    for row in rows:
        _add_row(row, total)
    del row
    np.testing.assert_array_equal(total, rows.sum(axis=0))
    assert (sys.getrefcount(rows), sys.getrefcount(total)) == before


@pytest.mark.parametrize("kernel", [_make_array, _give_part])
def test_a_kernel_in_place_that_makes_or_returns_an_array_is_refused(kernel: Dispatcher) -> None:
    with pytest.raises(NumbaError):
        kernel(np.zeros(3))
