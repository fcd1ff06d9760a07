"""Measure the cost of a frame by the number of its objects, in one process and through Ray.

Through Ray one session has a stream for each number of objects, and they run alternately, in an order that is
reversed every other round: the load of a shared machine changes within minutes by more than an object costs,
so that measurements one after the other say little of the difference. The mean over all further objects is
more reliable than the step from one number to the next.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from functools import partial
from itertools import pairwise
from typing import Any

from benchmark.in_process.engine_run import EngineCost, play, steady_cost
from benchmark.measurements.ray_cost import SteadyCost
from benchmark.plots import Plot
from benchmark.result import MeasurementResult
from benchmark.settings import Settings, report_progress
from benchmark.through_ray.endless_video import EndlessReader
from benchmark.through_ray.pipeline import ROUNDS, pipeline
from orchestrator.evaluation.datasets import open_sequence
from orchestrator.evaluation.figures import format_number, format_table

__all__ = [
    "OBJECTS",
    "further_object_ms",
    "layers_table",
    "mean_further_object_ms",
    "measure_layers",
    "processes_table",
]

OBJECTS = (1, 3, 8, 16, 32)
OBJECTS_THROUGH_RAY = (3, 8, 16)

#: The number of objects of an ordinary frame, which the others are compared with.
ORDINARY = 3

_SIZE = "width=640&height=480"


def measure_layers(
    settings: Settings,
    objects: tuple[int, ...] = OBJECTS,
    through_ray: tuple[int, ...] = OBJECTS_THROUGH_RAY,
) -> MeasurementResult:
    """Play the scene ``steady-crowd`` at 640×480 with each number of objects."""
    alone: dict[int, EngineCost] = {}
    for number, count in enumerate(objects):
        report_progress(f"layers: {count} objects in this process ({number + 1} of {len(objects)})")
        sequence = open_sequence(_scene(settings, count), None)
        alone[count] = steady_cost(play(settings.played(sequence), settings.config), settings.warm)
    rounds = _costs_through_ray(settings, through_ray) if through_ray else {}
    together = {count: SteadyCost.mean(costs) for count, costs in rounds.items()}
    plot = Plot(
        "A frame by the number of its objects (640×480, 1 % of the frame each), in one process",
        "objects",
        "ms a frame",
        list(alone),
        {
            "wall": [cost.wall_ms for cost in alone.values()],
            "CPU": [cost.cpu_ms for cost in alone.values()],
        },
        "lines",
    )
    figures = {
        "in_process": _figures(alone, {count: cost.cpu_ms for count, cost in alone.items()}),
        "through_ray": _figures(together, {count: cost.all_cpu_ms for count, cost in together.items()}),
    }
    for count, costs in rounds.items():
        figures["through_ray"][str(count)]["turns_cpu_ms"] = [one.all_cpu_ms for one in costs]
    tables = (layers_table(alone), *([processes_table(together)] if together else []))
    return MeasurementResult(tables, figures, {"layers": plot})


def _costs_through_ray(settings: Settings, objects: Sequence[int]) -> dict[int, list[SteadyCost]]:
    """Measure each number of objects in each of the rounds."""
    names = [_scene(settings, count) for count in objects]
    scenes = replace(settings, sequences={name: open_sequence(name, None) for name in names})
    videos = [scenes.endless_video(name) for name in names]
    costs: dict[int, list[SteadyCost]] = {count: [] for count in objects}
    activity = f"layers: {', '.join(map(str, objects))} objects through Ray, alternately"
    report_progress(f"{activity}: until all processes are there")
    with pipeline(settings.config, settings.folder) as session:
        each = [[session.start(partial(EndlessReader, video))] for video in videos]
        for number, windows in enumerate(session.alternating_windows(settings.warm, settings.steady, each)):
            report_progress(f"{activity} ({number + 1} of {ROUNDS} done)")
            for count, window in zip(objects, windows, strict=True):
                costs[count].append(SteadyCost.of(window))
    return costs


def _figures(
    costs: Mapping[int, EngineCost] | Mapping[int, SteadyCost], cpu_ms: Mapping[int, float]
) -> dict[str, Any]:
    further, mean = further_object_ms(cpu_ms), mean_further_object_ms(cpu_ms)
    return {
        str(count): asdict(cost)
        | {
            "all_cpu_ms": cpu_ms[count],
            "further_object_ms": further[count],
            "mean_further_object_ms": mean[count],
        }
        for count, cost in costs.items()
    }


def _scene(settings: Settings, objects: int) -> str:
    return f"synthetic:steady-crowd?frames={settings.frames}&{_SIZE}&objects={objects}"


def further_object_ms(cpu_ms: Mapping[int, float]) -> dict[int, float]:
    """Return the CPU time of one object more, ms a frame: the mean from the row before; NaN for the first."""
    further = dict.fromkeys(cpu_ms, math.nan)
    for (fewer, less), (count, more) in pairwise(cpu_ms.items()):
        further[count] = (more - less) / (count - fewer)
    return further


def mean_further_object_ms(cpu_ms: Mapping[int, float]) -> dict[int, float]:
    """Average the same over all objects beyond those of an ordinary frame; NaN up to there."""
    ordinary = cpu_ms.get(ORDINARY, math.nan)
    return {
        count: (more - ordinary) / (count - ORDINARY) if count > ORDINARY else math.nan
        for count, more in cpu_ms.items()
    }


def layers_table(costs: Mapping[int, EngineCost]) -> str:
    """Format a row for each number of objects in one process; the last four columns show the growth."""
    growth = _growth({count: cost.cpu_ms for count, cost in costs.items()})
    rows = [
        [
            str(count),
            format_number(cost.objects),
            format_number(cost.wall_ms),
            format_number(cost.cpu_ms),
            *growth[count],
        ]
        for count, cost in costs.items()
    ]
    return format_table(["objects", "found", "wall ms", "cpu ms", *_GROWTH], rows)


def processes_table(costs: Mapping[int, SteadyCost]) -> str:
    """Format the same through Ray, with the CPU time of all processes, and of those that are objects."""
    growth = _growth({count: cost.all_cpu_ms for count, cost in costs.items()})
    rows = [
        [
            str(count),
            format_number(cost.wall_ms),
            format_number(cost.all_cpu_ms),
            format_number(cost.cpu_ms.get("object layer", 0.0)),
            *growth[count],
        ]
        for count, cost in costs.items()
    ]
    headings = ["objects through Ray", "wall ms", "cpu ms", "of it the objects' processes", *_GROWTH]
    return format_table(headings, rows)


#: How the cost grows with the objects.
_GROWTH = (
    f"× {ORDINARY} objects",
    "cpu ms a further object",
    f"% of a frame with {ORDINARY}",
    f"% on average from {ORDINARY} on",
)


def _growth(cpu_ms: Mapping[int, float]) -> dict[int, list[str]]:
    ordinary, mean = cpu_ms.get(ORDINARY, math.nan), mean_further_object_ms(cpu_ms)
    return {
        count: [
            _ratio(cpu_ms[count] / ordinary),
            format_number(further),
            format_number(100 * further / ordinary),
            format_number(100 * mean[count] / ordinary),
        ]
        for count, further in further_object_ms(cpu_ms).items()
    }


def _ratio(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.2f}"
