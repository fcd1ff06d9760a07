"""The command ``scripts/chaos``: inject faults, print which were survived; soak; measure recovery's cost."""

from __future__ import annotations

import argparse
import sys
import tempfile
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from benchmark.plots import draw
from chaos.endurance.recovery_cost import measure_cost
from chaos.endurance.soak import memory_plot, soak
from chaos.harness.observed_run import ExpectationError
from chaos.harness.reference import References
from chaos.harness.scenario import Fault, Scenario, ScenarioContext, Verdict, Verdicts
from chaos.options import chaos_parser
from chaos.scenarios.catalogue import FAULTS
from chaos.scenarios.kills import KILLS
from mlbs_actors.errors import ConfigError, MlbsError
from orchestrator.extra import require_matplotlib

__all__ = ["main"]

#: Numbers of some quick faults, for ``--fast``.
_FAST = ("1", "28")


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
        0: everything was survived; 1: something was not; 2: wrong usage.
    """
    arguments = chaos_parser().parse_args(argv)
    try:
        if arguments.plot:
            require_matplotlib()
        with tempfile.TemporaryDirectory(prefix="mlbs-chaos-") as scratch:
            if arguments.what == "soak":
                return _soak(arguments, Path(scratch))
            if arguments.what == "cost":
                print(measure_cost(arguments.pairs, arguments.frames or 144, ray_scratch).table())
                return 0
            return _run_scenarios(_chosen(arguments), arguments, Path(scratch))
    except ExpectationError as error:
        print(error, file=sys.stderr)
        return 1
    except MlbsError as error:
        print(error, file=sys.stderr)
        return 2


def _chosen(arguments: argparse.Namespace) -> list[tuple[Scenario, tuple[Fault, ...]]]:
    """Return the scenarios, and which of their faults were chosen."""
    all_ = KILLS if arguments.what == "kills" else FAULTS
    numbers = _FAST if arguments.fast else arguments.faults and arguments.faults.split(",")
    words = arguments.only or ""

    def wanted(fault: Fault) -> bool:
        return words in fault.name and (not numbers or bool(set(numbers) & set(fault.number.split())))

    chosen = [(scenario, tuple(filter(wanted, scenario.faults))) for scenario in all_]
    if not any(faults for _, faults in chosen):
        known = {number for scenario in all_ for fault in scenario.faults for number in fault.number.split()}
        raise ConfigError(f"There is no such fault; choose from {', '.join(sorted(known, key=int))}.")
    return [(scenario, faults) for scenario, faults in chosen if faults]


def _run_scenarios(
    chosen: Sequence[tuple[Scenario, tuple[Fault, ...]]], arguments: argparse.Namespace, scratch: Path
) -> int:
    seeds = range(1, 1 + _seeds(arguments))
    references = References(scratch / "references")
    runs = [
        (
            scenario,
            faults,
            ScenarioContext(scratch / f"{position}-{seed}", references, _random(scenario, seed)),
        )
        for position, (scenario, faults) in enumerate(chosen)
        for seed in seeds
    ]
    held = True
    print(f"{'fault':8} {'what':56} {'held':>6} {'back after':>12} {'got on after':>12}", flush=True)
    with _mapping(arguments.jobs) as map_:
        outcomes = iter(map_(_outcome, *zip(*runs, strict=True)))
        for _, faults in chosen:
            of_seeds = [next(outcomes) for _ in seeds]
            for fault in faults:
                verdicts = [verdicts.by_name[fault.name] for verdicts in of_seeds]
                print(_row(fault, verdicts), flush=True)
                for seed, verdict in zip(seeds, verdicts, strict=True):
                    if verdict.failure is not None:
                        held = False
                        print(f"{'':8} seed {seed}: {verdict.failure}", flush=True)
    return 0 if held else 1


def _seeds(arguments: argparse.Namespace) -> int:
    """Return how often each fault is injected: kills are many, so by default once."""
    if arguments.fast or (arguments.seeds is None and arguments.what == "kills"):
        return 1
    return 3 if arguments.seeds is None else int(arguments.seeds)


def _random(scenario: Scenario, seed: int) -> np.random.Generator:
    return np.random.default_rng([zlib.crc32(scenario.name.encode()), seed])


@contextmanager
def _mapping(jobs: int) -> Iterator[Callable[..., Iterable[Any]]]:
    """Yield a ``map`` that runs so many calls at once; an exception cancels those that have not begun."""
    if jobs == 1:
        yield map
        return
    pool = ThreadPoolExecutor(jobs)
    try:
        yield pool.map
    finally:
        pool.shutdown(cancel_futures=True)


def _outcome(scenario: Scenario, faults: Sequence[Fault], context: ScenarioContext) -> Verdicts:
    verdicts = Verdicts((fault.name for fault in faults), _report)
    try:
        scenario.run(context, verdicts)
    except Exception as error:  # the rest of the table is still useful
        for verdict in verdicts.by_name.values():
            verdict.add(f"{type(error).__name__}: {error}")
    return verdicts


def _report(name: str, verdict: Verdict) -> None:
    back = "" if verdict.recovery is None else f", back after {verdict.recovery.first:.1f} s"
    print(f"{name}: {verdict.failure or 'held'}{back}", file=sys.stderr, flush=True)


def _row(fault: Fault, verdicts: Sequence[Verdict]) -> str:
    held = sum(verdict.failure is None for verdict in verdicts)
    backs = [verdict.recovery for verdict in verdicts if verdict.recovery is not None]
    first = _range([back.first for back in backs])
    new = _range([back.new for back in backs if back.new is not None])
    return f"{fault.number:8} {fault.name:56} {f'{held}/{len(verdicts)}':>6} {first:>12} {new:>12}"


def _range(seconds: Sequence[float]) -> str:
    return f"{min(seconds):.1f}–{max(seconds):.1f} s" if seconds else ""


def _soak(arguments: argparse.Namespace, scratch: Path) -> int:
    figures = soak(arguments.streams, arguments.frames or 300, scratch / "soak")
    print(figures.table())
    if arguments.plot:
        draw(memory_plot(figures.samples), arguments.plot)
    return 0
