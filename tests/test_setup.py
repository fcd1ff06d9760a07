"""scripts/setup installs once, however often it is started."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[1]

# Stands for every Python: makes an environment, and notes and takes its time for what is installed or run.
PYTHON = """#!/usr/bin/env bash
case "$*" in
    "-m venv .venv") mkdir -p .venv/bin; cp "$0" .venv/bin/python; cp "$0" .venv/bin/pip ;;
    install*) echo begun >>log; sleep 0.5; echo ended >>log ;;
    "-m orchestrator "*) ls -l /proc/self/fd >>descriptors ;;
esac
"""


def test_two_at_once_install_one_after_the_other_and_only_what_is_not_there(tmp_path: Path) -> None:
    (tmp_path / "scripts").mkdir()
    shutil.copy(REPOSITORY / "scripts/setup", tmp_path / "scripts/setup")
    (tmp_path / "pyproject.toml").touch()
    python = tmp_path / "python"
    python.write_text(PYTHON)
    python.chmod(0o755)

    def begin(*words: str) -> subprocess.Popen[bytes]:
        environment = {"PYTHON": str(python), "PATH": "/usr/bin:/bin"}
        return subprocess.Popen([tmp_path / "scripts/setup", *words], env=environment, stderr=subprocess.PIPE)

    both = [begin(), begin()]
    said = b"".join(run.communicate()[1] for run in both)
    assert [run.returncode for run in both] == [0, 0]
    assert (tmp_path / "log").read_text().split() == ["begun", "ended"]
    assert said.count(b"Installing into .venv") == 1
    # What Ray leaves behind for a moment must not keep the next one waiting.
    assert "/lock" not in (tmp_path / "descriptors").read_text()
    begin().communicate()
    assert (tmp_path / "log").read_text().split() == ["begun", "ended"]
    begin("dev").communicate()
    assert (tmp_path / "log").read_text().split() == ["begun", "ended"] * 2
