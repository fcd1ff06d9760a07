"""Commands in the help and in advice can be pasted."""

from __future__ import annotations

import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from orchestrator.program import python_name


@pytest.mark.parametrize("on_path", [True, False])
def test_this_python_is_named_so_that_it_starts_from_here(
    on_path: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    here = Path(sys.executable).parents[2]
    monkeypatch.chdir(here)
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}:/bin" if on_path else f"{tmp_path}:/bin")
    name = python_name()
    assert (name == "python") == on_path
    found = subprocess.run([*shlex.split(name), "-c", "import sys; print(sys.prefix)"], capture_output=True)
    assert found.stdout.decode().strip() == sys.prefix
