"""Entry point of ``python -m orchestrator``."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib.util import find_spec

from orchestrator.command_options import command_parser
from orchestrator.early_signals import exit_on_signals
from orchestrator.extra import missing_packages

__all__ = ["main"]


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; return its exit status (see ``--help``)."""
    exit_on_signals()
    given = sys.argv[1:] if argv is None else argv
    if not {"-h", "--help"}.isdisjoint(given):  # also where nothing is installed yet
        command_parser().print_help()
        return 0
    missing = missing_packages()
    # Nothing requires OpenCV, as its packages exclude each other.
    lacks_opencv = find_spec("cv2") is None
    if missing or lacks_opencv:
        missing = ["cv2", *missing] if lacks_opencv else missing
        extras = "run,headless" if lacks_opencv else "run"
        print(
            f"Packages are missing that a run needs ({', '.join(missing)}); "
            f"pip install 'mlbs-actors[{extras}]'",
            file=sys.stderr,
        )
        return 2
    # Imported here, because that takes a second, in which a signal may come.
    from orchestrator.command import run_command
    from orchestrator.log import ending_quietly

    with ending_quietly():
        return run_command(given)


if __name__ == "__main__":
    sys.exit(main())
