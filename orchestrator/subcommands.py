"""The commands of the program, ``mlbs-actors COMMAND …``, and the modules behind them.

Nothing has to be installed to import this: the help needs it, too.
"""

from __future__ import annotations

import importlib
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from importlib.util import find_spec

from orchestrator.program import EXAMPLES, program_name

__all__ = ["Subcommand", "likely_subcommand", "overview", "subcommand", "words_on_namesake"]

#: Of a word to the command that may be meant.
_LEAST_LIKENESS = 0.7

_OVERVIEW = """\
usage: {program} COMMAND ...
       {program} SOURCE ...

Segment every independently moving object in videos of moving or fixed cameras: a label map for every frame.

commands; DIR is a folder of results:
{commands}

{program} COMMAND --help    shows all that a command takes; of run every flag, source and file
{program} --version         shows the version

{examples}"""


@dataclass(frozen=True, slots=True)
class Subcommand:
    """One command.

    Attributes
    ----------
    name : str
    arguments : str
        What is written behind it.
    meaning : str
        For the overview.
    module : str, optional
        Has ``main(argv) -> int``, which shows its help with nothing installed; None for a run of streams.
    """

    name: str
    arguments: str
    meaning: str
    module: str | None = None

    def main(self) -> Callable[[Sequence[str]], int]:
        """Import what runs the command."""
        assert self.module is not None
        run: Callable[[Sequence[str]], int] = importlib.import_module(self.module).main
        return run


_SUBCOMMANDS = (
    Subcommand(
        "run", "SOURCE ...", "segment videos, folders of images, cameras; the word run may be left out"
    ),
    Subcommand("demo", "", "segment a built-in scene"),
    Subcommand(
        "make", "KIND DIR [OUT]", "videos and pictures of a finished run", "orchestrator.make.__main__"
    ),
    Subcommand(
        "export",
        "FORMAT DIR OUT",
        "csv, coco, mot, mots, davis, youtube-vos, overlay, rerun",
        "orchestrator.export.__main__",
    ),
    Subcommand(
        "report",
        "DIR",
        "write report.html anew, also of a run that was killed",
        "orchestrator.report.__main__",
    ),
    Subcommand("fetch", "ADDRESS DIR", "DIR as it was published in an object store", "orchestrator.fetch"),
    Subcommand("evaluate", "...", "score label maps against truth", "orchestrator.evaluation.__main__"),
    Subcommand(
        "disk-use", "DIR", "bytes a frame and GB a day of each stream", "orchestrator.disk_use.__main__"
    ),
)


def subcommand(word: str) -> Subcommand | None:
    """Return the command of this name."""
    return next((one for one in _there() if one.name == word), None)


def overview() -> str:
    """Return the help of the program as a whole."""
    begun = {one: f"  {one.name} {one.arguments}".rstrip() for one in _there()}
    width = max(map(len, begun.values()))
    lines = [f"{begun[one]:{width}}  {one.meaning}" for one in begun]
    program = program_name()
    examples = EXAMPLES.format(program=program)
    return _OVERVIEW.format(program=program, commands="\n".join(lines), examples=examples).rstrip() + "\n"


def words_on_namesake(word: str) -> str | None:
    """Say how a file or folder is meant that is called like the command; None if there is none."""
    if not os.path.lexists(word):
        return None
    return f"{word} is a command; to name the file or folder here that is called so, write ./{word}"


def likely_subcommand(word: str) -> str | None:
    """Return the command that a word may stand for which names no file."""
    names = [one.name for one in _there()]
    near = [] if os.path.lexists(word) else get_close_matches(word, names, 1, _LEAST_LIKENESS)
    return near[0] if near else None


def _there() -> list[Subcommand]:
    packages = {one: (one.module or "orchestrator").removesuffix(".__main__") for one in _SUBCOMMANDS}
    return [one for one, package in packages.items() if find_spec(package) is not None]
