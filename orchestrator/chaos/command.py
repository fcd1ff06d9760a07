"""``scripts/chaos``: brings faults about and prints which were held; soaks; tells what recovery costs."""

from __future__ import annotations

import argparse
import functools
import sys
import tempfile
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from mlbs_actors.errors import ConfigError, MlbsError
from orchestrator.benchmark.plots import draw, require_matplotlib
from orchestrator.chaos.cost import measure_cost
from orchestrator.chaos.faults import FAULTS
from orchestrator.chaos.kills import KILLS
from orchestrator.chaos.observed_run import NotHeldError
from orchestrator.chaos.place import Fault, Place, undisturbed
from orchestrator.chaos.soak import memory_plot, soak

__all__ = ["main"]

#: Numbers of the quick faults that stand for the others.
_FAST = ("1", "28")

_DESCRIPTION = """\
Bring faults about in real runs of the command, and tell which of them are survived.

  faults   every fault of the list: a row each, the seeds that were held, the seconds until work went on
  kills    every kind of process killed at every step, the command between any two steps of a commit
  soak     long streams whose objects come and go: memory, processes and descriptors over time
  cost     the rate with masks, tables, commits and snapshots beside that with nothing kept, in turn
"""


def main(argv: Sequence[str] | None, ray_scratch: Path) -> int:
    """Run the command.

    Parameters
    ----------
    argv : sequence of str or None
        Without the program's name; None: those of this process.
    ray_scratch : Path
        From :func:`orchestrator.ray_session.ray_settings`.

    Returns
    -------
    int
        0: everything was held; 1: something was not; 2: wrong usage.
    """
    arguments = _parser().parse_args(argv)
    try:
        if arguments.plot:
            require_matplotlib()
        with tempfile.TemporaryDirectory(prefix="mlbs-chaos-") as scratch:
            if arguments.what == "soak":
                return _soak(arguments, Path(scratch))
            if arguments.what == "cost":
                print(measure_cost(arguments.pairs, arguments.frames or 144, ray_scratch).table())
                return 0
            return _bring_about(_chosen(arguments), arguments, Path(scratch))
    except NotHeldError as error:
        print(error, file=sys.stderr)
        return 1
    except MlbsError as error:
        print(error, file=sys.stderr)
        return 2


def _chosen(arguments: argparse.Namespace) -> list[Fault]:
    all_ = KILLS if arguments.what == "kills" else FAULTS
    wanted = _FAST if arguments.fast else arguments.faults and arguments.faults.split(",")
    faults = [fault for fault in all_ if not wanted or set(wanted) & set(fault.number.split())]
    words = arguments.only or ""
    faults = [fault for fault in faults if words in fault.name]
    if not faults:
        numbers = sorted({number for fault in all_ for number in fault.number.split()}, key=int)
        raise ConfigError(f"There is no such fault; choose from {', '.join(numbers)}.")
    return faults


def _bring_about(faults: Sequence[Fault], arguments: argparse.Namespace, scratch: Path) -> int:
    seeds = range(1 if arguments.fast else arguments.seeds)
    expected = functools.cache(lambda: undisturbed(scratch / "undisturbed"))
    places = [
        Place(
            scratch / f"{position}-{seed}",
            expected,
            np.random.default_rng([zlib.crc32(fault.name.encode()), seed]),
        )
        for position, fault in enumerate(faults)
        for seed in seeds
    ]
    each = [fault for fault in faults for _ in seeds]
    held = True
    print(f"{'fault':8} {'what':56} {'held':>6} {'back after':>12}", flush=True)
    with _mapping(arguments.jobs) as map_:
        if arguments.jobs > 1:
            expected()  # once, and not by two at once
        outcomes = iter(map_(_outcome, each, places))
        for fault in faults:
            of_seeds = [next(outcomes) for _ in seeds]
            print(_row(fault, of_seeds), flush=True)
            for seed, outcome in zip(seeds, of_seeds, strict=True):
                if isinstance(outcome, NotHeldError):
                    held = False
                    print(f"{'':8} seed {seed}: {outcome}", flush=True)
    return 0 if held else 1


@contextmanager
def _mapping(jobs: int) -> Iterator[Callable[..., Iterable[Any]]]:
    """``map``, of so many calls at once; an exception ends it without those that have not begun."""
    if jobs == 1:
        yield map
        return
    pool = ThreadPoolExecutor(jobs)
    try:
        yield pool.map
    finally:
        pool.shutdown(cancel_futures=True)


def _outcome(fault: Fault, place: Place) -> float | NotHeldError | None:
    try:
        return fault.bring_about(place)
    except NotHeldError as error:
        return error
    except Exception as error:  # such as a missing file; the rest of the table is wanted all the same
        return NotHeldError(f"{type(error).__name__}: {error}")


def _row(fault: Fault, outcomes: Sequence[float | NotHeldError | None]) -> str:
    held = sum(not isinstance(outcome, NotHeldError) for outcome in outcomes)
    seconds = [outcome for outcome in outcomes if isinstance(outcome, float)]
    back = f"{min(seconds):.1f}–{max(seconds):.1f} s" if seconds else ""
    return f"{fault.number:8} {fault.name:56} {f'{held}/{len(outcomes)}':>6} {back:>12}"


def _soak(arguments: argparse.Namespace, scratch: Path) -> int:
    figures = soak(arguments.streams, arguments.frames or 300, scratch / "soak")
    print(figures.table())
    if arguments.plot:
        draw(memory_plot(figures.looks), arguments.plot)
    return 0


def _parser() -> argparse.ArgumentParser:
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
    add("--seeds", type=int, default=3, metavar="N", help="seeds a fault or kill (default: 3)")
    add("--faults", metavar="NUMBERS", help="only these, with commas (default: all)")
    add("--only", metavar="WORDS", help="only those with these words in their name")
    add("--jobs", type=int, default=1, metavar="N", help="runs at once, which makes them slower (default: 1)")
    add("--fast", action="store_true", help="a few quick ones, one seed")
    add("--streams", type=int, default=2, metavar="N", help="streams of the soak (default: 2)")
    add("--frames", type=int, metavar="N", help="frames of each stream (default: soak 300, cost 144)")
    add("--plot", type=Path, metavar="PNG", help="draw the soak's memory over time there")
    add("--pairs", type=int, default=3, metavar="N", help="pairs of runs for the cost (default: 3)")
    return parser
