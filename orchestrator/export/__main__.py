"""``mlbs-actors export FORMAT DIR OUT``."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from orchestrator.program import program_name

__all__ = ["FORMATS", "main"]


#: Names of formats.
FORMATS = ("csv", "coco", "mot", "mots", "davis", "youtube-vos", "overlay", "rerun")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; return its exit status: 0 written, 1 a disk error, 2 impossible."""
    parser = argparse.ArgumentParser(
        prog=f"{program_name()} export",
        description="Write what a run has committed in the format of other tools.",
        epilog="csv: one table, a row per frame and object; coco: one JSON file; mot, mots: a text file a "
        "stream, of boxes or masks; davis, youtube-vos: indexed PNG masks; overlay: videos with the labels, "
        "drawn anew; rerun: a recording for the viewer of rerun.io",
        allow_abbrev=False,
    )
    parser.add_argument("format", choices=FORMATS)
    parser.add_argument("run", type=Path, metavar="DIR", help="the run's output folder")
    parser.add_argument("out", type=Path, metavar="OUT", help="what to write")
    parser.add_argument("--replace", action="store_true", help="replace what was exported there before")
    parser.add_argument(
        "--internals",
        action="store_true",
        help="rerun only: segment the streams once more, which takes its time, and record the trajectories, "
        "motion fields and posteriors of every layer too; not of cameras",
    )
    given = parser.parse_intermixed_args(argv)
    from orchestrator.export.command import export  # the help needs nothing that is installed

    return export(given.format, given.run, given.out, internals=given.internals, replace=given.replace)


if __name__ == "__main__":
    sys.exit(main())
