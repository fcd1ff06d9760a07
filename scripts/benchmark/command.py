"""The command ``scripts/bench``: what frames cost, in the engine and in the whole pipeline."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from benchmark.measurements.births import measure_births
from benchmark.measurements.capacity import measure_capacity
from benchmark.measurements.layers import measure_layers
from benchmark.measurements.memory import measure_memory
from benchmark.measurements.methods import measure_methods
from benchmark.measurements.ray_cost import measure_ray
from benchmark.measurements.sizes import measure_sizes
from benchmark.measurements.streams import measure_streams
from benchmark.options import METHODS, PEER_NAMES, benchmark_parser
from benchmark.plots import draw
from benchmark.result import MeasurementResult
from benchmark.settings import Settings
from mlbs_actors.config import load_config
from mlbs_actors.errors import ConfigError, MlbsError
from orchestrator.evaluation import datasets
from orchestrator.evaluation.figure_files import write_json
from orchestrator.extra import require_matplotlib

__all__ = ["main"]


def main(arguments: Sequence[str] | None, scratch: Path) -> int:
    """Run the command.

    Parameters
    ----------
    arguments : sequence of str or None
        Without the program's name; None: those of this process.
    scratch : Path
        Folder for files of the measurements and of Ray, from :func:`orchestrator.ray_session.ray_settings`.

    Returns
    -------
    int
        0: measured; 2: wrong usage.
    """
    parser = benchmark_parser()
    options = parser.parse_args(arguments)
    try:
        _check(options)
        settings = Settings(
            sequences={name: datasets.open_sequence(name, options.data) for name in options.sequences},
            config=load_config(None, options.set),
            frames=options.frames,
            warm=options.warm,
            folder=scratch,
        )
        _measure_all(settings, options)
    except MlbsError as error:
        parser.error(str(error))
    return 0


def _measurements(peers: Sequence[str]) -> dict[str, Callable[[Settings], MeasurementResult]]:
    return {
        METHODS: partial(measure_methods, peers=peers),
        "sizes": measure_sizes,
        "layers": measure_layers,
        "births": measure_births,
        "ray": measure_ray,
        "streams": measure_streams,
        "memory": measure_memory,
        "capacity": measure_capacity,
    }


def _measure_all(settings: Settings, options: argparse.Namespace) -> None:
    """Measure one after the other; print and write each result before the next measurement begins."""
    figures: dict[str, Any] = {}
    measurements = _measurements(options.peers)
    for number, name in enumerate(options.measure):
        result = measurements[name](settings)
        print(("\n" if number else "") + "\n\n".join(result.tables), flush=True)
        figures |= result.figures if name == METHODS else {name: result.figures}
        if options.json:
            write_json(options.json, figures)
        if options.plots:
            for file, plot in result.plots.items():
                draw(plot, options.plots / f"{file}.png")


def _check(options: argparse.Namespace) -> None:
    if not 0 <= options.warm <= options.frames - 2:
        raise ConfigError(
            f"--warm {options.warm} leaves fewer than two of --frames {options.frames} to time; give more."
        )
    unknown = sorted(set(options.peers) - set(PEER_NAMES))
    if unknown:
        raise ConfigError(f"There is no peer {unknown[0]!r}; there are {', '.join(PEER_NAMES)}.")
    known = _measurements(options.peers)
    if options.measure == ["all"]:
        options.measure = list(known)
    unknown = sorted(set(options.measure) - set(known))
    if unknown or not options.measure:
        asked = f"knows no {unknown[0]!r}" if unknown else "names nothing"
        raise ConfigError(f"--measure {asked}; choose from {', '.join(known)}, or write all.")
    if options.plots:
        require_matplotlib()
