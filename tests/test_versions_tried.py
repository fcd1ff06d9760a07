"""scripts/test-versions runs, checks and tests in fresh clones, and closes with what pytest said."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).resolve().parents[1] / "scripts/test-versions"

# Each notes by which Python it was called; the tests fail with the Python that a file names.
STUBS = {
    "setup": "mkdir -p .venv/bin; printf '#!/bin/sh\\necho 1 2 3 4\\n' >.venv/bin/python; "
    "chmod +x .venv/bin/python",
    "run": "scripts/setup",
    "evaluate": 'echo \'{"mean": {"object_f": 99.0}}\' >figures.json',
    "check": "",
    "test": 'if [ "${PYTHON##*/}" = "$(cat "$NOTES/failing")" ]; then\n'
    'echo "=== 1 failed, 2 passed in 1.00s ==="; exit 1\nfi\necho "=== 3 passed, 1 skipped in 1.02s ==="',
}


@pytest.fixture
def repository(tmp_path: Path) -> Path:
    """A repository with stubs of the other scripts, and two Pythons."""
    for folder in ("repository/scripts", "repository/configs", "bin", "scratch"):
        (tmp_path / folder).mkdir(parents=True)
    repository = tmp_path / "repository"
    shutil.copy(SCRIPT, repository / "scripts")
    (repository / "configs/streams.txt").write_text("street synthetic:street\n")
    for name, does in STUBS.items():
        script = repository / "scripts" / name
        script.write_text(f'#!/bin/sh\necho "${{PYTHON##*/}} {name} $*" >>"$NOTES/called"\n{does}\n')
        script.chmod(0o755)
    for version in ("3.10", "3.13"):
        (tmp_path / f"bin/python{version}").symlink_to("/bin/true")
    (tmp_path / "failing").write_text("none")
    git = ["git", "-c", "user.name=a", "-c", "user.email=a@b", "-C", str(repository)]
    for words in (["init", "--quiet"], ["add", "."], ["commit", "--quiet", "--message", "a"]):
        subprocess.run([*git, *words], check=True)
    return repository


def tried(repository: Path, *words: str) -> tuple[int, list[str], list[str]]:
    """The status of the script, the lines it prints, and what it called."""
    folder = repository.parent
    ended = subprocess.run(
        [sys.executable, repository / "scripts/test-versions", *words],
        env={
            "PATH": f"{folder / 'bin'}:/usr/bin:/bin",
            "PYENV_ROOT": str(folder),
            "NOTES": str(folder),
            "TMPDIR": str(folder / "scratch"),
        },
        capture_output=True,
        text=True,
        check=False,
    )
    return ended.returncode, ended.stdout.splitlines(), (folder / "called").read_text().splitlines()


def test_the_newest_python_is_checked_and_both_ends_are_run_and_tested(repository: Path) -> None:
    status, lines, called = tried(repository, "newest", "oldest")
    assert (status, lines[-1]) == (0, "=== 3 passed, 1 skipped in 1.02s ===")
    of = {
        version: [line.split(maxsplit=2)[1:] for line in called if line.startswith(version)]
        for version in ("python3.13", "python3.10")
    }
    assert [words[0] for words in of["python3.13"]] == ["run", "setup", "evaluate", "check", "test"]
    assert [words[0] for words in of["python3.10"]] == ["setup", "run", "setup", "evaluate", "test"]
    assert of["python3.10"][0] == ["setup", "--oldest"]
    assert not list((repository.parent / "scratch").iterdir())


def test_what_failed_is_said_last_and_its_clone_stays(repository: Path) -> None:
    (repository.parent / "failing").write_text("python3.13")
    status, lines, called = tried(repository, "newest", "oldest")
    assert (status, lines[-1]) == (1, "=== 1 failed, 2 passed in 1.00s ===")
    assert any("3.13" in line and "FAILED: scripts/test ended with 1" in line for line in lines)
    assert "python3.10 test" in "\n".join(called)  # the other one is tried all the same
    assert len(list((repository.parent / "scratch").iterdir())) == 1


def test_the_newest_packages_are_asked_for(repository: Path) -> None:
    _, _, called = tried(repository, "3.13", "--newest", "--run")
    assert called[0] == "python3.13 setup --newest"
    assert not any(line.startswith("python3.13 test") for line in called)
