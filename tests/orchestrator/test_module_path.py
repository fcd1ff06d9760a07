"""Where the modules of a run come from, and which of them need Ray."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from orchestrator.module_path import PACKAGE_ROOT, is_being_started


@pytest.mark.parametrize(
    ("words", "started"),
    [
        (["python", "-m", "orchestrator", "film.mp4"], True),
        (["python", "-W", "error", "-m", "orchestrator.export", "out"], True),
        (["python", "-morchestrator"], True),
        (["python", "-m", "theirs"], False),
        (["python", "-m", "orchestrators"], False),
    ],
)
def test_only_a_module_of_this_package_that_is_being_started_changes_the_path(
    words: list[str], started: bool
) -> None:
    assert is_being_started(["-m", *words[3:]], words) == started
    assert not is_being_started(["/x/orchestrator/__main__.py"], words)


@pytest.mark.parametrize("module", ["orchestrator", "orchestrator.export", "orchestrator.disk_use"])
def test_every_command_of_the_package_leaves_the_working_folder_alone(tmp_path: Path, module: str) -> None:
    for name in ("av", "cv2", "yaml", "queue", "select", "secrets", "json", "argparse"):
        (tmp_path / f"{name}.py").write_text("open('was-run', 'w').close()\n")
    ended = subprocess.run(
        [sys.executable, "-m", module, "--help"], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert ended.returncode == 0, ended.stderr
    assert not (tmp_path / "was-run").exists()


def test_a_checkout_that_is_not_installed_is_found_from_its_own_folder() -> None:
    program = "import orchestrator.module_path as m; print(m.PACKAGE_ROOT)"
    ended = subprocess.run(
        [sys.executable, "-S", "-c", program], cwd=PACKAGE_ROOT, capture_output=True, text=True, check=True
    )
    assert ended.stdout.strip() == PACKAGE_ROOT


@pytest.mark.parametrize(
    "module",
    ["command", "disk_use.measured", "evaluation.command", "export.command", "report.page", "sources.survey"],
)
def test_ray_is_imported_only_to_run_streams(module: str) -> None:
    code = f"import sys, orchestrator.{module}; sys.exit('ray' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
