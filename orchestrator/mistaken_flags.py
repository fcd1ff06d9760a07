"""Flags that do not exist or stand in the wrong place: what their user meant."""

from __future__ import annotations

import os
import shlex
from collections.abc import Sequence
from difflib import get_close_matches

from mlbs_actors.errors import ConfigError
from orchestrator.program import command_line_of

__all__ = ["refuse_source_behind", "unknown_flag"]

#: Of a flag to the one that may be meant; less is chance, ``--bogus`` has 0.67 of ``--log``.
_LEAST_LIKENESS = 0.7


def unknown_flag(word: str, known: Sequence[str]) -> str:
    """Say that there is no such flag, and which one may be meant."""
    if os.path.lexists(word):
        return f"{word} begins like a flag; to name the file write {shlex.quote(f'./{word}')}"
    flag = word.partition("=")[0]
    near = [name for name in known if name.startswith(flag if flag.startswith("--") else f"-{flag}")]
    near = near if len(near) == 1 else get_close_matches(flag, known, 1, _LEAST_LIKENESS)
    return f"there is no {flag}; " + (
        f"did you mean {near[0]}?" if near else f"{command_line_of('run', '--help')} lists all flags"
    )


def refuse_source_behind(flag: str, words: Sequence[str | None]) -> None:
    """Raise ConfigError if a flag was given a source for one of its values."""
    for word in words:
        if word and not word.isdecimal() and os.path.lexists(word):
            raise ConfigError(
                f"{flag} takes the words behind it, here {word!r}; name your sources first: "
                f"{command_line_of(word, flag)} …"
            )
