"""The scripts tell what they do before anything is installed."""

from __future__ import annotations

import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from mlbs_actors import __version__

ROOT = Path(__file__).resolve().parents[1]
SCRIPTS = sorted(path.name for path in (ROOT / "scripts").iterdir() if path.is_file())


@pytest.fixture(scope="module")
def clone(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The files of this folder without its environment, and a ``python3`` that has no package at all."""
    folder = tmp_path_factory.mktemp("clone")
    shutil.copytree(ROOT / "scripts", folder / "scripts")
    for name in ("mlbs_actors", "orchestrator", "tests"):
        (folder / name).symlink_to(ROOT / name)
    (folder / "bin").mkdir()
    python = folder / "bin/python3"
    python.write_text(f'#!/bin/sh\nexec {shlex.quote(sys.executable)} -S "$@"\n')
    python.chmod(0o755)
    return folder


def said(clone: Path, script: str, *words: str) -> str:
    """What a script prints in a folder that is not its own, with nothing in the environment but a path."""
    return subprocess.run(
        [clone / "scripts" / script, *words],
        cwd=clone / "bin",
        env={"PATH": f"{clone / 'bin'}:/usr/bin:/bin"},
        capture_output=True,
        text=True,
        check=True,
    ).stdout


@pytest.mark.parametrize("script", SCRIPTS)
def test_every_script_shows_its_help_where_nothing_is_installed(clone: Path, script: str) -> None:
    assert len(said(clone, script, "--help")) > 60
    assert said(clone, script, "-h") == said(clone, script, "--help")
    assert not (clone / ".venv").exists()


@pytest.mark.parametrize(
    "command", ["run", "demo", "make", "export", "report", "fetch", "evaluate", "disk-use"]
)
def test_the_main_script_shows_the_help_of_a_command_where_nothing_is_installed(
    clone: Path, command: str
) -> None:
    shown = said(clone, "run", command, "--help")
    assert "usage: " in shown
    assert f"{clone / 'scripts/run'} " in shown
    assert not (clone / ".venv").exists()


def test_the_main_script_tells_the_version_where_nothing_is_installed(clone: Path) -> None:
    assert said(clone, "run", "--version") == f"mlbs-actors {__version__}\n"
    assert not (clone / ".venv").exists()
