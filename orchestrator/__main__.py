"""Entry point of ``python -m orchestrator``."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Sequence

from orchestrator.command_options import command_parser
from orchestrator.early_signals import exit_on_signals

__all__ = ["main"]

#: OpenCV, which nothing requires, as its packages exclude each other, and the modules of the extra ``run``,
#: which ``MultilayerSubtractor`` alone does not need.
_NEEDED = ("cv2", "av", "filelock", "jinja2", "PIL", "pyarrow", "pycocotools", "ray", "rich")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; return its exit status (see ``--help``)."""
    exit_on_signals()
    given = sys.argv[1:] if argv is None else argv
    if not {"-h", "--help"}.isdisjoint(given):  # also where nothing is installed yet
        command_parser().print_help()
        return 0
    missing = [name for name in _NEEDED if importlib.util.find_spec(name) is None]
    if missing:
        extras = "run,headless" if "cv2" in missing else "run"
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
