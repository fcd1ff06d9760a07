"""Without the extra ``run`` an import says what to install."""

from __future__ import annotations

import subprocess
import sys

import pytest

PARTS = (
    "clips",
    "evaluation.datasets",
    "run.job",
    "sinks.record",
    "sources.video",
    "storage.commit_log",
)


@pytest.mark.parametrize("part", PARTS)
def test_a_part_of_a_run_says_which_extra_it_needs(part: str) -> None:
    code = f"""
import sys

sys.modules["av"] = sys.modules["ray"] = None
try:
    import orchestrator.{part}
except ImportError as error:
    print(error)
"""
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert "(av, ray)" in said
    assert "pip install 'mlbs-actors[run]'" in said


@pytest.mark.parametrize(
    ("module", "package", "extra"),
    [
        ("counts.table", "pyarrow", "read"),
        ("rows.endings", "pycocotools", "read"),
        ("library.starting", "pyarrow", "run"),
    ],
)
def test_a_module_that_programs_import_says_which_extra_has_what_it_needs(
    module: str, package: str, extra: str
) -> None:
    code = f"""
import sys

sys.modules["{package}"] = None
try:
    import orchestrator.{module}
except ImportError as error:
    print(error)
"""
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert package in said
    assert f"pip install 'mlbs-actors[{extra}]'" in said
