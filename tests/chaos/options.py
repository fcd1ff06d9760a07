"""The command line of ``scripts/chaos``, for which nothing has to be installed but Python."""

from __future__ import annotations

import argparse
from pathlib import Path

__all__ = ["chaos_parser"]

_DESCRIPTION = """\
Bring faults about in real runs of the command, and tell which of them are survived.

  faults   every fault of the list: a row each, how often it was held; how long until label maps were made
           again ("back after"), and until there was one that had not been there before ("got on after")
  kills    every kind of process killed at every step, the command between any two steps of a commit
  soak     long streams whose objects come and go: memory, processes and descriptors over time
  cost     the rate with synced commits and snapshots beside that with the same files alone, in turns
"""


def chaos_parser() -> argparse.ArgumentParser:
    """Return the parser of ``scripts/chaos``."""
    parser = argparse.ArgumentParser(
        prog="scripts/chaos",
        description=_DESCRIPTION,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    add = parser.add_argument
    add(
        "what",
        nargs="?",
        choices=("faults", "kills", "soak", "cost"),
        default="faults",
        help="what to do (default: faults)",
    )
    add(
        "--seeds", type=int, metavar="N", help="how often each, at other moments (default: faults 3, kills 1)"
    )
    add("--faults", metavar="NUMBERS", help="only these, with commas (default: all)")
    add("--only", metavar="WORDS", help="only those with these words in their name")
    add("--jobs", type=int, default=1, metavar="N", help="runs at once, which makes each slower (default: 1)")
    add("--fast", action="store_true", help="a few quick ones, one seed")
    add("--streams", type=int, default=2, metavar="N", help="streams of the soak (default: 2)")
    add("--frames", type=int, metavar="N", help="frames of each stream (default: soak 300, cost 144)")
    add("--plot", type=Path, metavar="PNG", help="draw the soak's memory over time there")
    add("--pairs", type=int, default=3, metavar="N", help="pairs of runs for the cost (default: 3)")
    return parser
