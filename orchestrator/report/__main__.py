"""Writes the report of a run again: ``mlbs-actors report DIR``, even after a kill."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from orchestrator.program import program_name


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; return its exit status: 0 written, 2 no run, or it cannot be written."""
    parser = argparse.ArgumentParser(
        prog=f"{program_name()} report",
        description="Write DIR/report.html anew from what a run has left in DIR.",
        allow_abbrev=False,
    )
    parser.add_argument("folder", type=Path, metavar="DIR", help="the run's output folder")
    folder: Path = parser.parse_args(argv).folder
    # Imported here: the help needs nothing that is installed.
    from mlbs_actors.errors import ConfigError
    from orchestrator.report.page import render_report
    from orchestrator.storage.durable_files import replace_file

    try:
        replace_file(folder / "report.html", render_report(folder).encode())
    except ConfigError as error:
        print(error, file=sys.stderr)
        return 2
    except OSError as error:
        print(f"{folder / 'report.html'} cannot be written: {error.strerror}.", file=sys.stderr)
        return 2
    print(folder / "report.html")
    return 0


if __name__ == "__main__":
    sys.exit(main())
