"""scripts/setup installs exact versions, once, however often it is started."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[1]

# Stands for every Python: makes an environment, tells its version, and notes what is installed or run, which
# takes its time where there is a file "slow".
PYTHON = """#!/usr/bin/env bash
case "$*" in
    "-m venv .venv") mkdir -p .venv/bin; cp "$0" .venv/bin/python; cp "$0" .venv/bin/pip ;;
    "-c import sys; print"*) cat version ;;
    *" install --quiet uv"*) [[ -f without_uv ]] || cp "$0" .venv/bin/uv ;;
    *"install "*) echo begun >>log; echo "$*" >>installed; [[ -f slow ]] && sleep 0.5; echo ended >>log ;;
    "-m mlbs_actors.warm_up") echo compiled >>log ;;
    "-m orchestrator "*) ls -l /proc/self/fd >>descriptors ;;
esac
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with the script, a Python 3.11 and files of versions for it, but not for 3.14."""
    for name in ("scripts", "requirements"):
        (tmp_path / name).mkdir()
    shutil.copy(REPOSITORY / "scripts/setup", tmp_path / "scripts/setup")
    (tmp_path / "pyproject.toml").touch()
    for name in ("python3.11", "python3.10-oldest"):
        (tmp_path / f"requirements/{name}.txt").touch()
    (tmp_path / "version").write_text("3.11\n")
    (tmp_path / "python").write_text(PYTHON)
    (tmp_path / "python").chmod(0o755)
    return tmp_path


def begin(folder: Path, *words: str) -> subprocess.Popen[bytes]:
    """Start the script."""
    environment = {"PYTHON": str(folder / "python"), "PATH": "/usr/bin:/bin"}
    return subprocess.Popen([folder / "scripts/setup", *words], env=environment, stderr=subprocess.PIPE)


def done(folder: Path, *words: str) -> list[str]:
    """Run the script to its end; return what was installed in this run, a line for each call."""
    installed = folder / "installed"
    installed.unlink(missing_ok=True)
    running = begin(folder, *words)
    said = running.communicate()[1]
    assert running.returncode == 0, said
    return installed.read_text().splitlines() if installed.exists() else []


def test_two_at_once_install_one_after_the_other_and_only_what_is_not_there(folder: Path) -> None:
    (folder / "slow").touch()
    both = [begin(folder), begin(folder)]
    said = b"".join(run.communicate()[1] for run in both)
    assert [run.returncode for run in both] == [0, 0]
    once = ["begun", "ended", "begun", "ended", "compiled"]  # what builds the package comes first
    assert (folder / "log").read_text().split() == once
    assert said.count(b"Installing into .venv") == 1
    # What Ray leaves behind for a moment must not keep the next one waiting.
    assert "/lock" not in (folder / "descriptors").read_text()
    assert done(folder) == []
    assert len(done(folder, "dev")) == 2
    assert (folder / "log").read_text().split() == [*once, "begun", "ended", "begun", "ended"]


def test_what_is_installed_is_held_to_the_versions_of_the_environments_python(folder: Path) -> None:
    builder, package = done(folder, "dev")
    assert builder.endswith("--constraint requirements/python3.11.txt setuptools")
    assert package.endswith(
        "--constraint requirements/python3.11.txt --no-build-isolation --editable .[run,headless,dev]"
    )


@pytest.mark.parametrize("file", ["pyproject.toml", "requirements/python3.11.txt"])
def test_other_versions_are_installed_after_a_change(folder: Path, file: str) -> None:
    done(folder, "dev")
    (folder / file).write_text("changed")
    assert len(done(folder, "dev")) == 2
    assert done(folder) == []  # an environment for development is one to run, too


def test_an_environment_keeps_to_its_choice_of_packages(folder: Path) -> None:
    done(folder, "dev")
    (newest,) = done(folder, "--newest", "dev")
    assert "--constraint" not in newest
    assert "--upgrade" in newest
    assert done(folder, "dev") == done(folder) == []


def test_a_python_newer_than_those_tried_gets_the_newest_packages_and_a_sentence(folder: Path) -> None:
    (folder / "version").write_text("3.14\n")
    running = begin(folder)
    assert b"Python 3.14 is newer than what this has been tried with" in running.communicate()[1]
    assert "--constraint" not in (folder / "installed").read_text()


def test_pip_installs_where_uv_cannot(folder: Path) -> None:
    by_uv = done(folder)
    shutil.rmtree(folder / ".venv")
    (folder / "without_uv").touch()
    by_pip = done(folder)
    assert [line.split(" install ")[0] for line in by_pip] == ["--disable-pip-version-check"] * 2
    assert [line.split("--constraint")[1] for line in by_pip] == [
        line.split("--constraint")[1] for line in by_uv
    ]


def test_the_oldest_packages_are_refused_where_none_are_known(folder: Path) -> None:
    running = begin(folder, "--oldest")
    assert b"known for Python 3.10 only, not for 3.11" in running.communicate()[1]
    assert running.returncode == 2
    (folder / "version").write_text("3.10\n")
    assert all("python3.10-oldest.txt" in line for line in done(folder, "--oldest"))
