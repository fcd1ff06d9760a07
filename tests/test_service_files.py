"""The files and command lines that people copy to run a service: they parse, and ask for what exists."""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
import sys
from configparser import ConfigParser
from pathlib import Path
from typing import Any

import pytest
import yaml

from orchestrator.command_line import parse
from orchestrator.monitor.address import TOKEN_VARIABLE
from orchestrator.options import Arguments

ROOT = Path(__file__).resolve().parents[1]
UNIT = ROOT / "configs/mlbs-actors.service"


def expect_service(arguments: Arguments) -> None:
    """Expect a command line that serves for the first start and for all later ones."""
    assert arguments.resume
    assert arguments.watch
    assert arguments.monitor is not None
    assert arguments.monitor.port == 9464


def test_the_unit_runs_a_command_that_continues_and_signals_it_alone() -> None:
    unit = ConfigParser(interpolation=None)
    unit.optionxform = str  # type: ignore[assignment,method-assign]
    unit.read_string(UNIT.read_text(encoding="utf-8"))
    service = unit["Service"]
    expect_service(parse(shlex.split(service["ExecStart"])[1:]))
    assert service["KillMode"] == "mixed"
    assert set(service["SuccessExitStatus"].split()) == {"130", "143"}


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="needs systemd-analyze")
def test_systemd_accepts_the_unit(tmp_path: Path) -> None:
    text = re.sub(r"ExecStart=\S+", f"ExecStart={sys.executable}", UNIT.read_text(encoding="utf-8"))
    (tmp_path / UNIT.name).write_text(text, encoding="utf-8")
    ended = subprocess.run(
        ["systemd-analyze", "verify", tmp_path / UNIT.name], capture_output=True, text=True, check=False
    )
    assert (ended.returncode, ended.stderr) == (0, "")


def test_the_composition_is_complete_and_prometheus_reads_the_page_with_its_token() -> None:
    whole: dict[str, Any] = yaml.safe_load((ROOT / "configs/compose.yaml").read_text(encoding="utf-8"))
    expect_service(parse(whole["services"]["mlbs-actors"]["command"]))
    assert TOKEN_VARIABLE in whole["services"]["mlbs-actors"]["environment"]
    assert whole["secrets"]["monitor-token"]["environment"] == TOKEN_VARIABLE
    for service in whole["services"].values():
        assert {one["source"] for one in service.get("configs", ())} <= whole["configs"].keys()
        named = {mount.partition(":")[0] for mount in service["volumes"] if not mount.startswith(".")}
        assert named <= whole["volumes"].keys()
    assert (ROOT / "configs" / whole["configs"]["board"]["file"]).is_file()
    (job,) = yaml.safe_load(whole["configs"]["prometheus"]["content"])["scrape_configs"]
    assert job["static_configs"] == [{"targets": ["mlbs-actors:9464"]}]
    assert job["authorization"] == {"credentials_file": "/run/secrets/monitor-token"}
    for name in ("datasources", "dashboards"):
        assert yaml.safe_load(whole["configs"][name]["content"])["apiVersion"] == 1


def test_the_command_lines_of_the_page_exist() -> None:
    text = (ROOT / "docs/service.md").read_text(encoding="utf-8").replace("\\\n", " ")
    lines = re.findall(r"^(?:podman run .* )?mlbs-actors (--streams .*)$", text, re.MULTILINE)
    assert len(lines) == 2
    for line in lines:
        expect_service(parse(shlex.split(line)))
