"""The command ``scripts/bench``: what frames cost, in the engine and in the whole pipeline."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from benchmark.in_process.peers import PEERS
from benchmark.measurements.births import measure_births
from benchmark.measurements.capacity import measure_capacity
from benchmark.measurements.layers import measure_layers
from benchmark.measurements.memory import measure_memory
from benchmark.measurements.methods import measure_methods
from benchmark.measurements.ray_cost import measure_ray
from benchmark.measurements.sizes import measure_sizes
from benchmark.measurements.streams import measure_streams
from benchmark.plots import draw, require_matplotlib
from benchmark.result import MeasurementResult
from benchmark.settings import Settings
from mlbs_actors.config import load_config
from mlbs_actors.errors import ConfigError, MlbsError
from orchestrator.evaluation import datasets
from orchestrator.evaluation.figure_files import write_json

__all__ = ["main"]

DESCRIPTION = """\
Time the engine and OpenCV subtractors on the same frames, in one process and one thread; with --measure, tell
what else decides how large a machine must be.

  scripts/bench                                             a built-in scene of 640×480 with three objects
  scripts/bench --data data --sequences mlbs/cars4          a sequence with truth, played back and forth
  scripts/bench --measure ray,memory                        the pipeline as users run it, a process a layer
  scripts/bench --measure all --json all.json --plots plots

Wall time is the median, CPU time the mean of a frame in steady state. Only ratios within one run compare;
keep the machine free of other work.
"""

EPILOG = """\
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

METHODS = "methods"


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
    parser = _parser()
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
    unknown = sorted(set(options.peers) - set(PEERS))
    if unknown:
        raise ConfigError(f"There is no peer {unknown[0]!r}; there are {', '.join(PEERS)}.")
    known = _measurements(options.peers)
    if options.measure == ["all"]:
        options.measure = list(known)
    unknown = sorted(set(options.measure) - set(known))
    if unknown or not options.measure:
        asked = f"knows no {unknown[0]!r}" if unknown else "names nothing"
        raise ConfigError(f"--measure {asked}; choose from {', '.join(known)}, or write all.")
    if options.plots:
        require_matplotlib()


def _names(text: str) -> list[str]:
    return [name for name in text.split(",") if name]


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="scripts/bench",
        description=DESCRIPTION,
        epilog=EPILOG,
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
        default=list(PEERS),
        metavar="NAME,...",
        help=f"which of {', '.join(PEERS)} (default: all)",
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
