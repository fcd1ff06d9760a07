"""``mlbs-actors disk-use DIR``."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from orchestrator.program import program_name

__all__ = ["main"]


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; return its exit status: 0 printed, 2 no run there."""
    parser = argparse.ArgumentParser(
        prog=f"{program_name()} disk-use",
        description="Print how many bytes a frame each stream of a run takes, and how many GB that is a day.",
        allow_abbrev=False,
    )
    parser.add_argument("folder", type=Path, metavar="DIR", help="the run's output folder")
    parser.add_argument("--rate", type=float, metavar="N", help="of N frames a second, instead of its own")
    given = parser.parse_args(argv)
    # Imported here: the help needs nothing that is installed.
    from mlbs_actors.record.recorded_stream import read_description
    from orchestrator.disk_use.measured import stream_use

    if (description := read_description(given.folder)) is None:
        print(f"{given.folder} holds no run; name the folder given to --output.", file=sys.stderr)
        return 2
    print(f"{'stream':16} {'size':>11} {'frames/s':>8} {'GB a day':>8}  bytes a frame")
    for name in description["sources"]:
        use = stream_use(given.folder / name)
        if use is None:
            print(f"{name:16} no tables with two label maps to measure by")
            continue
        rate = use.rate if given.rate is None else given.rate
        kinds = ", ".join(f"{kind} {size:,.0f}" for kind, size in use.per_frame.items())
        size = f"{use.width}×{use.height}"
        print(f"{name:16} {size:>11} {rate:8.2f} {use.per_day(rate) / 1e9:8.2f}  {kinds}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
