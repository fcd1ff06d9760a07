"""Entry point of ``mlbs-actors`` and ``python -m orchestrator``."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib.util import find_spec

from orchestrator.command_options import command_parser
from orchestrator.early_signals import exit_on_signals
from orchestrator.extra import missing_packages
from orchestrator.program import command_line_of
from orchestrator.subcommands import likely_subcommand, overview, subcommand, words_on_namesake

__all__ = ["main"]

_HELP = ("-h", "--help")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program; return its exit status (see ``--help``)."""
    exit_on_signals()
    given = list(sys.argv[1:] if argv is None else argv)
    flags, words = (given[:1], given[1:]) if given[:1] == ["--or-demo"] else ([], given)  # of scripts/run
    if words and words[0] in _HELP:
        print(overview(), end="")
        return 0
    word = words[0] if words else ""
    chosen = subcommand(word)
    if chosen is not None and word != "demo":  # which is a source, too
        words = words[1:]
        if (remark := words_on_namesake(word)) is not None:
            print(remark, file=sys.stderr)
    run = _streams if chosen is None or chosen.module is None else chosen.main()
    if not set(_HELP).isdisjoint(words):  # also where nothing is installed yet
        return run(words)
    missing = missing_packages()
    # Nothing requires OpenCV, as its packages exclude each other.
    lacks_opencv = find_spec("cv2") is None
    if missing or lacks_opencv:
        missing = ["cv2", *missing] if lacks_opencv else missing
        extras = "run,headless" if lacks_opencv else "run"
        print(
            f"Packages are missing that it needs ({', '.join(missing)}); pip install 'mlbs-actors[{extras}]'",
            file=sys.stderr,
        )
        return 2
    from orchestrator.log import ending_quietly

    with ending_quietly():
        status = run([*flags, *words] if run is _streams else words)
    if status == 2 and chosen is None and (meant := likely_subcommand(word)) is not None:
        print(f"Did you mean {command_line_of(meant)}?", file=sys.stderr)
    return status


def _streams(words: Sequence[str]) -> int:
    if not set(_HELP).isdisjoint(words):
        command_parser().print_help()
        return 0
    # Imported here, because that takes a second, in which a signal may come.
    from orchestrator.command import run_command

    return run_command(words)


if __name__ == "__main__":
    sys.exit(main())
