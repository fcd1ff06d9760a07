"""One program of several commands: what its words mean, and its help."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

from orchestrator import __main__ as program
from orchestrator.__main__ import main
from orchestrator.subcommands import likely_subcommand, overview, subcommand

#: What no help may wait for.
_SLOW = ("av", "cv2", "mlbs_actors", "numba", "numpy", "pyarrow", "pydantic", "ray", "yaml")


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> list[Sequence[str]]:
    """The words with which streams would be run, in an empty working folder."""
    found: list[Sequence[str]] = []
    monkeypatch.setattr(program, "exit_on_signals", lambda: None)  # the test run has its own

    def run(words: Sequence[str]) -> int:
        found.append(words)
        return 0

    monkeypatch.setattr(program, "_streams", run)
    monkeypatch.chdir(tmp_path)
    return found


@pytest.mark.parametrize(
    ("given", "run"),
    [
        (["a.mp4", "--resume"], ["a.mp4", "--resume"]),
        (["run", "a.mp4", "--resume"], ["a.mp4", "--resume"]),
        (["--streams", "list.txt"], ["--streams", "list.txt"]),
        (["a.mp4", "export"], ["a.mp4", "export"]),
        (["./report"], ["./report"]),
        (["report/"], ["report/"]),
        (["demo", "--max-frames", "3"], ["demo", "--max-frames", "3"]),
        (["--or-demo"], ["--or-demo"]),
        (["--or-demo", "run", "a.mp4"], ["--or-demo", "a.mp4"]),
        ([], []),
    ],
)
def test_without_the_word_of_a_command_streams_are_run(
    asked: list[Sequence[str]], given: list[str], run: list[str]
) -> None:
    assert main(given) == 0
    assert [list(words) for words in asked] == [run]


def test_a_command_gets_the_words_behind_it(
    asked: list[Sequence[str]], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out/run.json").write_text(json.dumps({"sources": {}}))
    assert main(["disk-use", "out"]) == 0
    assert main(["--or-demo", "disk-use", "nothing"]) == 2
    assert capsys.readouterr().err == "nothing holds no run; name the folder given to --output.\n"
    assert not asked


def test_a_folder_that_is_called_like_a_command_is_told_how_it_is_meant(
    asked: list[Sequence[str]], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "run").mkdir()
    assert main(["run", "a.mp4"]) == 0
    assert asked == [["a.mp4"]]
    assert "write ./run" in capsys.readouterr().err
    assert main(["./run"]) == 0
    assert asked[1:] == [["./run"]]
    assert capsys.readouterr().err == ""


def test_a_misspelt_command_is_told(
    asked: list[Sequence[str]],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(program, "_streams", lambda _: 2)
    assert main(["exprot", "csv", "out", "x.csv"]) == 2
    assert "Did you mean" in (said := capsys.readouterr().err)
    assert said.endswith(" export?\n")
    (tmp_path / "exprot").touch()
    assert likely_subcommand("exprot") is None
    assert likely_subcommand("street.mp4") is None


@pytest.mark.parametrize("command", ["", "run", "demo", "export", "report", "evaluate", "disk-use"])
def test_a_help_waits_for_nothing_slow(command: str) -> None:
    code = (
        "import sys; from orchestrator.__main__ import main\n"
        "try: status = main(sys.argv[1:])\n"
        "except SystemExit as end: status = end.code\n"
        f"print(*(name for name in {_SLOW} if name in sys.modules), file=sys.stderr)\n"
        "sys.exit(status)"
    )
    words = [*([command] if command else []), "--help"]
    ended = subprocess.run([sys.executable, "-c", code, *words], capture_output=True, text=True, check=True)
    assert ended.stderr == "\n"
    assert "usage: " in ended.stdout


def test_the_overview_begins_with_the_commands_and_names_each_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MLBS_COMMAND", "")
    monkeypatch.setattr(sys, "argv", ["/bin/mlbs-actors"])
    text = overview()
    assert text.startswith("usage: mlbs-actors COMMAND ...\n       mlbs-actors SOURCE ...\n")
    names = [line.split()[0] for line in text.split("\n\n")[2].splitlines()[1:]]
    assert names[:2] == ["run", "demo"]
    assert len(set(names)) == len(names)
    assert {"export", "report", "evaluate", "disk-use"} <= set(names)
    assert all(subcommand(name) is not None for name in names)
    assert max(map(len, text.splitlines())) <= 110


def test_the_help_of_a_command_says_how_it_was_called(
    asked: list[Sequence[str]], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("MLBS_COMMAND", "my clone/scripts/run")
    with pytest.raises(SystemExit):
        main(["export", "--help"])
    assert "usage: 'my clone/scripts/run' export" in capsys.readouterr().out
    monkeypatch.setenv("MLBS_COMMAND", "")
    monkeypatch.setattr(sys, "argv", ["/bin/mlbs-actors"])
    assert main(["evaluate", "-h"]) == 0
    assert "  mlbs-actors evaluate --data data  " in capsys.readouterr().out
