"""The names of the command, as its user typed it, and of its Python, for help and advice to be pasted."""

from __future__ import annotations

import os
import shlex
import shutil
import sys
from pathlib import Path

from orchestrator.credentials import mask

__all__ = ["command_line_of", "program_name", "python_name"]

#: Set by scripts/run to the path by which it was called.
_VARIABLE = "MLBS_COMMAND"


def program_name() -> str:
    """Return the words that start the command."""
    if script := os.environ.get(_VARIABLE):
        return shlex.quote(script)
    name = Path(sys.argv[0]).name
    return name if name == "mlbs-actors" else "python -m orchestrator"


def command_line_of(*words: str) -> str:
    """Write the command with these arguments so that a shell takes it as it is meant, without credentials."""
    return f"{program_name()} {shlex.join(map(mask, words))}"


def python_name() -> str:
    """Return the word that starts this Python from here."""
    if (found := shutil.which("python")) is not None and Path(found) == Path(sys.executable):
        return "python"
    executable = Path(sys.executable)
    if script := os.environ.get(_VARIABLE):  # which shows the help by any Python until its own is there
        executable = Path(script).absolute().parents[1] / ".venv/bin/python"
    below = executable.is_relative_to(Path.cwd() / ".venv")
    return shlex.quote(os.path.relpath(executable) if below else str(executable))
