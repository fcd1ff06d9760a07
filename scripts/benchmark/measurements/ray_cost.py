"""Measure the whole pipeline through Ray, and the same calls and payloads without any computation."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from statistics import fmean

from benchmark.plots import Plot
from benchmark.result import MeasurementResult
from benchmark.settings import Settings, report_progress
from benchmark.through_ray.empty_parts import EmptyParts, EmptyReader, EmptySink, last_messages
from benchmark.through_ray.endless_video import EndlessReader
from benchmark.through_ray.pipeline import Arrival, SteadyWindow, pipeline, record_in
from benchmark.through_ray.process_costs import cpu_growth, sum_by_kind
from mlbs_actors.actors.parts import PartFactory
from mlbs_actors.actors.stream.protocol import StreamSink
from mlbs_actors.source import FrameReader
from orchestrator.evaluation.figures import format_number, format_table

__all__ = [
    "PipelineCost",
    "StartUp",
    "SteadyCost",
    "cpu_ms_by_kind",
    "mean_of_kinds",
    "measure_ray",
    "pipeline_cost",
    "start_up",
]

#: The rate is steady from the first frame on that begins this many frames in not much more than their time.
_STEADY_FRAMES, _STEADY_RATIO = 8, 1.25


@dataclass(frozen=True)
class StartUp:
    """Seconds from the start of Ray.

    Attributes
    ----------
    ray : float
        Until Ray is up.
    first : float
        Until the first label map.
    steady : float
        Until the first label map of the first eight that come as quickly as those of the steady window;
        NaN if none do.
    """

    ray: float
    first: float
    steady: float


@dataclass(frozen=True)
class SteadyCost:
    """A frame of one stream in steady state.

    Attributes
    ----------
    frames_a_second, wall_ms : float
    cpu_ms : dict of str to float
        CPU time of the session's processes by kind, ms a frame.
    """

    frames_a_second: float
    wall_ms: float
    cpu_ms: dict[str, float]

    @staticmethod
    def of(window: SteadyWindow) -> SteadyCost:
        """Derive the cost from a window of the stream."""
        return SteadyCost(window.frames_a_second, 1e3 / window.frames_a_second, cpu_ms_by_kind(window))

    @staticmethod
    def mean(costs: Sequence[SteadyCost]) -> SteadyCost:
        """Average the costs of windows of the same length."""
        wall_ms = fmean(one.wall_ms for one in costs)
        return SteadyCost(1e3 / wall_ms, wall_ms, mean_of_kinds([one.cpu_ms for one in costs]))

    @property
    def all_cpu_ms(self) -> float:
        """Return the CPU time of all processes, ms a frame."""
        return sum(self.cpu_ms.values())


@dataclass(frozen=True)
class PipelineCost(SteadyCost):
    """The same, and how long it took to become steady.

    Attributes
    ----------
    start_up : StartUp
    """

    start_up: StartUp


def measure_ray(settings: Settings) -> MeasurementResult:
    """Run each sequence through Ray, and then its messages with empty methods."""
    tables, figures, plots = [], {}, {}
    for number, (name, sequence) in enumerate(settings.sequences.items()):
        report_progress(f"ray: {name}, the engine ({number + 1} of {len(settings.sequences)})")
        engine = pipeline_cost(
            settings, None, partial(EndlessReader, settings.endless_video(name)), record_in
        )
        report_progress(f"ray: {name}, the same calls with empty methods")
        frames = list(settings.played(sequence))
        parts = EmptyParts(last_messages(frames, settings.config))
        empty = pipeline_cost(settings, parts, partial(EmptyReader, frames[-1]), _no_record)
        tables += [cost_table(name, engine, empty), start_table(name, engine)]
        figures[name] = {
            "engine": asdict(engine) | {"all_cpu_ms": engine.all_cpu_ms},
            "empty": asdict(empty) | {"all_cpu_ms": empty.all_cpu_ms},
            "ray_share": empty.all_cpu_ms / engine.all_cpu_ms,
        }
        kinds = _kinds(engine, empty)
        plots[f"ray-{number}" if number else "ray"] = Plot(
            f"CPU time by kind of process: {name}",
            "",
            "ms a frame",
            kinds,
            {
                title: [cost.cpu_ms.get(kind, 0.0) for kind in kinds]
                for title, cost in (("engine", engine), ("empty methods", empty))
            },
            "bars",
        )
    return MeasurementResult(tuple(tables), figures, plots)


def pipeline_cost(
    settings: Settings,
    parts: PartFactory | None,
    open_reader: Callable[[], FrameReader],
    open_record: Callable[[Path], StreamSink],
) -> PipelineCost:
    """Run one stream in a session of its own until its steady window is over.

    Parameters
    ----------
    setting : Setting
    parts : PartFactory or None
        What the actors run; None: the engine.
    open_reader, open_record : callable
        Where its frames come from, for ever, and where its results go.
    """
    with pipeline(settings.config, settings.folder, parts) as session:
        stream = session.start(open_reader, open_record)
        steady = SteadyCost.of(session.steady_window(settings.warm, settings.steady))
        started = start_up(session.started, session.ready, session.arrivals(stream), steady.wall_ms)
    return PipelineCost(steady.frames_a_second, steady.wall_ms, steady.cpu_ms, started)


def _no_record(folder: Path) -> StreamSink:
    return EmptySink()


def cpu_ms_by_kind(window: SteadyWindow) -> dict[str, float]:
    """Return the CPU time of the session's processes in a steady window by kind, ms a frame."""
    seconds = sum_by_kind(cpu_growth(window.before, window.after), window.kinds)
    return {kind: 1e3 * value / window.frames for kind, value in seconds.items()}


def mean_of_kinds(runs: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Average the CPU time a frame of each kind of process over several runs."""
    kinds = sorted({kind for run in runs for kind in run})
    return {kind: fmean(run.get(kind, 0.0) for run in runs) for kind in kinds}


def start_up(started: float, ready: float, arrivals: Sequence[Arrival], wall_ms: float) -> StartUp:
    """Return how long a session took to its first label map, and to its steady rate.

    Parameters
    ----------
    started, ready : float
        When Ray began to start, and when it was up, s.
    arrivals : sequence of Arrival
        At least one.
    wall_ms : float
        Time of a frame in steady state, ms.
    """
    times = [one.seconds - started for one in arrivals]
    bound = _STEADY_FRAMES * _STEADY_RATIO * wall_ms / 1e3
    runs = zip(times, times[_STEADY_FRAMES:], strict=False)
    steady = next((first for first, last in runs if last - first <= bound), math.nan)
    return StartUp(ready - started, times[0], steady)


def _kinds(*costs: PipelineCost) -> list[str]:
    return sorted({kind for cost in costs for kind in cost.cpu_ms})


def cost_table(name: str, engine: PipelineCost, empty: PipelineCost) -> str:
    """Format a row for each kind of process, then all of them: CPU ms a frame with the engine and without."""
    rows = [
        [kind, *(format_number(cost.cpu_ms.get(kind, 0.0)) for cost in (engine, empty)), ""]
        for kind in _kinds(engine, empty)
    ]
    both = [format_number(cost.all_cpu_ms) for cost in (engine, empty)]
    rows.append(["all processes", *both, f"{100 * empty.all_cpu_ms / engine.all_cpu_ms:.0f} %"])
    rows.append(["wall ms", *(format_number(cost.wall_ms) for cost in (engine, empty)), ""])
    rows.append(["frames/s", *(format_number(cost.frames_a_second) for cost in (engine, empty)), ""])
    return format_table([f"{name}: CPU ms a frame", "through Ray", "empty methods", "Ray's share"], rows)


def start_table(name: str, engine: PipelineCost) -> str:
    """Format the start-up times, seconds from the start of Ray."""
    start = engine.start_up
    rows = [
        ["Ray is up", f"{start.ray:.1f}"],
        ["first label map", f"{start.first:.1f}"],
        ["steady rate", "-" if math.isnan(start.steady) else f"{start.steady:.1f}"],
    ]
    return format_table([f"{name}: start-up", "s"], rows)
