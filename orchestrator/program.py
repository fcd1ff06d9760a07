"""The name of the program, as its user typed it, for help and advice to be pasted."""

from __future__ import annotations

import os
import shlex
import sys
from pathlib import Path

from orchestrator.credentials import mask

__all__ = ["EXAMPLES", "command_line_of", "program_name"]

#: Set by scripts/run to the path by which it was called.
_VARIABLE = "MLBS_COMMAND"

#: What the help begins or ends with.
EXAMPLES = """\
examples:
  {program} street.mp4                     one video; results in street-objects, beside it
  {program} clips/ rtsp://host/stream      each video of a folder, and a camera; results in out
  {program} demo --max-frames 30           the beginning of a built-in scene

"""


def program_name() -> str:
    """Return the words that start the command."""
    if script := os.environ.get(_VARIABLE):
        return shlex.quote(script)
    name = Path(sys.argv[0]).name
    return name if name == "mlbs-actors" else "python -m orchestrator"


def command_line_of(*words: str) -> str:
    """Write the command with these arguments so that a shell takes it as it is meant, without credentials."""
    return f"{program_name()} {shlex.join(map(mask, words))}"
