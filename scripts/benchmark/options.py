"""The command line of ``scripts/bench``, for which nothing has to be installed but Python."""

from __future__ import annotations

import argparse
from pathlib import Path

__all__ = ["METHODS", "PEER_NAMES", "benchmark_parser"]

_DESCRIPTION = """\
Time the engine and OpenCV subtractors on the same frames, in one process and one thread; with --measure, tell
what else decides how large a machine must be.

  scripts/bench                                             a built-in scene of 640×480 with three objects
  scripts/bench --data data --sequences mlbs/cars4          a sequence with truth, played back and forth
  scripts/bench --measure ray,memory                        the pipeline as users run it, a process a layer
  scripts/bench --measure all --json all.json --plots plots

Wall time is the median, CPU time the mean of a frame in steady state. Only ratios within one run compare;
keep the machine free of other work.
"""

_EPILOG = """\
what can be measured (on --sequences where no scene is named):
  methods   the engine beside OpenCV's subtractors, and the engine's stages
  sizes     wall and CPU time of a frame, and the stages, from 320×240 to 1920×1080 (scene demo)
  layers    CPU time of a frame with 1 to 32 objects of 1 % of a 640×480 frame each (scene steady-crowd),
            and with 3 to 16 through Ray, of all processes
  births    the longest frame in which an object enters, in process and through Ray (traffic,
            late-entry, crowd)
  ray       the pipeline through Ray: rate, CPU time of all its processes, the share of Ray, start-up
  streams   1, 2, 4 and 8 streams at once through Ray, against what the cores could do
  memory    private memory of each kind of process (the driver is this program, larger than that of a run)
  capacity  frames/s of one stream through Ray, from 640×480 to 3840×2160 with 1 to 16 objects (scene
            steady-crowd), and how many cameras a core serves: --frames of the largest size; prints Markdown
"""

#: The measurement that is made unless others are asked for.
METHODS = "methods"

#: What chooses OpenCV's subtractors.
PEER_NAMES = ("mog2", "residual", "composite")


def benchmark_parser() -> argparse.ArgumentParser:
    """Return the parser of ``scripts/bench``."""
    parser = argparse.ArgumentParser(
        prog="scripts/bench",
        description=_DESCRIPTION,
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add(
        "--measure",
        type=_names,
        default=[METHODS],
        metavar="NAME,...",
        help=f"what to measure, or all; see below (default: {METHODS})",
    )
    add("--data", type=Path, metavar="ROOT", help="folder of sequences with truth, as for scripts/evaluate")
    add(
        "--sequences",
        type=_names,
        default=["synthetic:demo?frames=60&width=640&height=480"],
        metavar="NAME,...",
        help="folders relative to ROOT, as in mlbs/cars4, or synthetic:NAME?frames=60&seed=1",
    )
    add("--frames", type=int, default=60, metavar="N", help="frames to play of each (default 60)")
    add(
        "--warm",
        type=int,
        default=10,
        metavar="N",
        help="frames at the start that are not timed (default 10)",
    )
    add(
        "--peers",
        type=_names,
        default=list(PEER_NAMES),
        metavar="NAME,...",
        help=f"which of {', '.join(PEER_NAMES)} (default: all)",
    )
    add("--set", action="append", default=[], metavar="KEY=VALUE", help="override a parameter of the engine")
    add("--json", type=Path, metavar="FILE", help="write all figures there")
    add(
        "--plots",
        type=Path,
        metavar="FOLDER",
        help="draw a PNG of each measurement there (needs matplotlib: scripts/setup bench)",
    )
    return parser


def _names(text: str) -> list[str]:
    return [name for name in text.split(",") if name]
