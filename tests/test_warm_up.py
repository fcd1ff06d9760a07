"""Compiling beforehand: its progress, and its end when something fails."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from mlbs_actors import MlbsError, compile_kernels, warm_up


def python_that(folder: Path, monkeypatch: pytest.MonkeyPatch, does: str) -> None:
    """Let a shell script do what the processes that compile do."""
    script = folder / "python"
    script.write_text(f"#!/bin/sh\n{does}\n")
    script.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(script))
    monkeypatch.setattr(warm_up, "machine_code_folder", lambda: folder)
    monkeypatch.setattr(warm_up, "_PROGRESS_SECONDS", 0.01)


def test_progress_tells_the_time_and_the_kernels_so_far(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    python_that(tmp_path, monkeypatch, f"echo $3 >> {tmp_path}/parts; touch {tmp_path}/$3.nbc; sleep 0.5")
    told: list[tuple[float, int]] = []
    compile_kernels(lambda seconds, kernels: told.append((seconds, kernels)))
    assert sorted((tmp_path / "parts").read_text().split()) == ["coordinator", "segmenter"]
    assert [seconds for seconds, _ in told] == sorted(seconds for seconds, _ in told)
    assert told[-1][1] == 2


def test_a_process_that_fails_is_an_error_with_its_last_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    python_that(tmp_path, monkeypatch, "echo Traceback >&2; echo 'OSError: no space' >&2; exit 1")
    with pytest.raises(MlbsError, match=r"cannot be compiled: OSError: no space\.$"):
        compile_kernels()


def test_a_progress_function_can_end_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    python_that(tmp_path, monkeypatch, "exec sleep 600")

    def stop(seconds: float, kernels: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        compile_kernels(stop)
