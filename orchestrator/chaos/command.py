"""``scripts/chaos``: brings the faults about, some seeds each, and prints which were held."""

from __future__ import annotations

import argparse
import sys
import tempfile
import zlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from orchestrator.chaos.faults import FAULTS, Fault, Place, undisturbed
from orchestrator.chaos.observed_run import NotHeldError

__all__ = ["main"]

#: Numbers of the quick faults that stand for the others.
_FAST = ("1", "28")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; 0 if every fault was held with every seed, 1 if not, 2 for wrong usage."""
    arguments = _parser().parse_args(argv)
    wanted = _FAST if arguments.fast else arguments.faults and arguments.faults.split(",")
    faults = [fault for fault in FAULTS if not wanted or set(wanted) & set(fault.number.split())]
    if not faults:
        print(f"There is no such fault; choose from {', '.join(sorted(_numbers()))}.", file=sys.stderr)
        return 2
    seeds = range(1 if arguments.fast else arguments.seeds)
    failures: list[str] = []
    with tempfile.TemporaryDirectory(prefix="mlbs-chaos-") as scratch:
        expected = undisturbed(Path(scratch) / "undisturbed")
        print(f"{'fault':8} {'what':48} {'held':>6} {'back after':>12}", flush=True)
        for position, fault in enumerate(faults):
            seconds: list[float] = []
            held = 0
            for seed in seeds:
                folder = Path(scratch) / f"{position}-{seed}"
                place = Place(
                    folder, expected, np.random.default_rng([zlib.crc32(fault.name.encode()), seed])
                )
                try:
                    back = fault.bring_about(place)
                except NotHeldError as error:
                    failures.append(f"{fault.number} {fault.name}, seed {seed}: {error}")
                else:
                    held += 1
                    seconds += [] if back is None else [back]
            print(_row(fault, held, len(seeds), seconds), flush=True)
    for failure in failures:
        print(failure)
    return 1 if failures else 0


def _row(fault: Fault, held: int, seeds: int, seconds: Sequence[float]) -> str:
    back = f"{min(seconds):.1f}–{max(seconds):.1f} s" if seconds else ""
    return f"{fault.number:8} {fault.name:48} {f'{held}/{seeds}':>6} {back:>12}"


def _numbers() -> set[str]:
    return {number for fault in FAULTS for number in fault.number.split()}


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="scripts/chaos",
        description="Bring faults about in runs of the command, and print which are survived: a row a fault, "
        "with the seeds that were held and the seconds until work went on.",
        allow_abbrev=False,
    )
    parser.add_argument("--seeds", type=int, default=3, metavar="N", help="seeds a fault (default: 3)")
    parser.add_argument("--faults", metavar="NUMBERS", help="only these, with commas (default: all)")
    parser.add_argument("--fast", action="store_true", help="a few quick ones, one seed")
    return parser
