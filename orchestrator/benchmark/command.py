"""The command ``scripts/bench``: time the engine beside what else one could use, with what each finds."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from mlbs_actors.config import load_config
from mlbs_actors.errors import ConfigError, MlbsError
from orchestrator.benchmark.measurement import ENGINE, Measurement, measure
from orchestrator.benchmark.peers import PEERS
from orchestrator.evaluation import datasets
from orchestrator.evaluation.figures import format_number, format_table, mean_of_sequences, write_figures

__all__ = ["main"]

DESCRIPTION = """\
Time the engine and OpenCV subtractors on the same frames, in one process and one thread.

  scripts/bench                                             a built-in scene of 640×480 with three objects
  scripts/bench --data data --sequences mlbs/cars4          a sequence with truth, played back and forth

Wall time is the median, CPU time the mean of a frame in steady state. Only ratios within one run compare;
keep the machine free of other work.
"""

#: The peer that the others are held against.
REFERENCE = "composite"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command.

    Parameters
    ----------
    arguments : sequence of str or None
        Without the program's name; None: those of this process.

    Returns
    -------
    int
        0: measured; 2: wrong usage.
    """
    parser = _parser()
    options = parser.parse_args(arguments)
    try:
        measured = _measure(options)
    except MlbsError as error:
        parser.error(str(error))
    print(methods_table(measured))
    print()
    print(stages_table(measured))
    if options.json:
        try:
            write_figures(options.json, as_json(measured))
        except MlbsError as error:
            parser.error(str(error))
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="scripts/bench", description=DESCRIPTION, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("--data", type=Path, metavar="ROOT", help="folder of sequences with truth, as for scripts/evaluate")
    add(
        "--sequences",
        type=lambda text: [name for name in text.split(",") if name],
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
        type=lambda text: [name for name in text.split(",") if name],
        default=list(PEERS),
        metavar="NAME,...",
        help=f"which of {', '.join(PEERS)} (default: all)",
    )
    add("--set", action="append", default=[], metavar="KEY=VALUE", help="override a parameter of the engine")
    add("--json", type=Path, metavar="FILE", help="write all figures there")
    return parser


def _measure(options: argparse.Namespace) -> dict[str, list[Measurement]]:
    if not 0 <= options.warm < options.frames:
        raise ConfigError(
            f"--warm {options.warm} leaves nothing of --frames {options.frames} to time; give more frames."
        )
    unknown = sorted(set(options.peers) - set(PEERS))
    if unknown:
        raise ConfigError(f"There is no peer {unknown[0]!r}; there are {', '.join(PEERS)}.")
    config = load_config(None, options.set)
    sequences = [datasets.open_sequence(name, options.data) for name in options.sequences]
    measured = {}
    for name, sequence in zip(options.sequences, sequences, strict=True):
        print(f"{name}: {options.frames} frames", file=sys.stderr)
        peers = {peer: PEERS[peer] for peer in options.peers}
        measured[name] = measure(sequence, peers, config, options.frames, options.warm)
    return measured


def methods_table(measured: dict[str, list[Measurement]]) -> str:
    """A row for each sequence and method: what it finds, what it takes, CPU time against the composite's.

    Several sequences are followed by a row for each method with the means of its columns.
    """
    figures: dict[str, list[list[float]]] = {}
    rows = []
    for name, methods in measured.items():
        reference = next((one.cpu_ms for one in methods if one.method == REFERENCE), float("nan"))
        for one in methods:
            score, ratio = one.score.all_frames, one.cpu_ms / reference
            row = [100 * score.two_label_f, 100 * score.object_f, one.wall_ms, one.cpu_ms, ratio]
            figures.setdefault(one.method, []).append(row)
            rows.append([name, one.method, *_cells(row)])
    if len(measured) > 1:
        for method, of_sequences in figures.items():
            means = [mean_of_sequences(column) for column in zip(*of_sequences, strict=True)]
            rows.append(["mean", method, *_cells(means)])
    headings = ["sequence", "method", "two_label_f", "object_f", "wall ms", "cpu ms", f"× {REFERENCE}"]
    return format_table(headings, rows)


def _cells(row: list[float]) -> list[str]:
    return [*(format_number(figure) for figure in row[:-1]), f"{row[-1]:.2f}"]


def stages_table(measured: dict[str, list[Measurement]]) -> str:
    """The engine's stages, ms a frame: a row for each stage, a column for each sequence."""
    columns = {name: methods[0].stage_ms for name, methods in measured.items()}
    stages = dict.fromkeys(stage for column in columns.values() for stage in column)
    rows = [
        [stage, *(format_number(column.get(stage, 0.0)) for column in columns.values())] for stage in stages
    ]
    rows.append(["together", *(format_number(sum(column.values())) for column in columns.values())])
    return format_table([f"{ENGINE}: ms", *columns], rows)


def as_json(measured: dict[str, list[Measurement]]) -> dict[str, Any]:
    """The figures by sequence and method, percent and ms."""
    return {
        name: {
            one.method: {
                "two_label_f": 100 * one.score.all_frames.two_label_f,
                "object_f": 100 * one.score.all_frames.object_f,
                "wall_ms": one.wall_ms,
                "cpu_ms": one.cpu_ms,
                "stage_ms": dict(one.stage_ms),
            }
            for one in methods
        }
        for name, methods in measured.items()
    }
