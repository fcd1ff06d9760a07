"""What a frame of a steady crowd costs by the number of objects in it, in one process and through Ray.

Through Ray there is a stream of each number in one session, and they take turns, there and back: what else
runs on a shared machine changes within minutes, by more than what an object costs, so that what is measured
one after the other says little of the difference. Believe the mean over all further objects, not the step
from one number to the next.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from functools import partial
from itertools import pairwise
from typing import Any

from benchmark.finding import Finding
from benchmark.in_process.engine_run import EngineCost, play, steady_cost
from benchmark.measurements.ray_cost import SteadyCost
from benchmark.plots import Plot
from benchmark.setting import Setting, say
from benchmark.through_ray.endless_video import EndlessReader
from benchmark.through_ray.pipeline import TURNS, pipeline
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

#: The number of objects of an ordinary frame, which the others are held against.
ORDINARY = 3

_SIZE = "width=640&height=480"


def measure_layers(
    setting: Setting,
    objects: tuple[int, ...] = OBJECTS,
    through_ray: tuple[int, ...] = OBJECTS_THROUGH_RAY,
) -> Finding:
    """Play the scene ``steady-crowd`` at 640×480 with each number of objects."""
    alone: dict[int, EngineCost] = {}
    for number, count in enumerate(objects):
        say(f"layers: {count} objects in this process ({number + 1} of {len(objects)})")
        sequence = open_sequence(_scene(setting, count), None)
        alone[count] = steady_cost(play(setting.played(sequence), setting.config), setting.warm)
    turns = _costs_through_ray(setting, through_ray) if through_ray else {}
    together = {count: SteadyCost.mean(costs) for count, costs in turns.items()}
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
    for count, costs in turns.items():
        figures["through_ray"][str(count)]["turns_cpu_ms"] = [one.all_cpu_ms for one in costs]
    tables = (layers_table(alone), *([processes_table(together)] if together else []))
    return Finding(tables, figures, {"layers": plot})


def _costs_through_ray(setting: Setting, objects: Sequence[int]) -> dict[int, list[SteadyCost]]:
    """What each number of objects costs in each of the turns."""
    names = [_scene(setting, count) for count in objects]
    scenes = replace(setting, sequences={name: open_sequence(name, None) for name in names})
    videos = [scenes.endless_video(name) for name in names]
    costs: dict[int, list[SteadyCost]] = {count: [] for count in objects}
    told = f"layers: {', '.join(map(str, objects))} objects through Ray, by turns"
    say(f"{told}: until all processes are there")
    with pipeline(setting.config, setting.folder) as session:
        each = [[session.start(partial(EndlessReader, video))] for video in videos]
        for turn, windows in enumerate(session.turns(setting.warm, setting.steady, each)):
            say(f"{told} ({turn + 1} of {TURNS} done)")
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


def _scene(setting: Setting, objects: int) -> str:
    return f"synthetic:steady-crowd?frames={setting.frames}&{_SIZE}&objects={objects}"


def further_object_ms(cpu_ms: Mapping[int, float]) -> dict[int, float]:
    """CPU time of one object more, ms a frame: the mean from the row before; NaN for the first."""
    further = dict.fromkeys(cpu_ms, math.nan)
    for (fewer, less), (count, more) in pairwise(cpu_ms.items()):
        further[count] = (more - less) / (count - fewer)
    return further


def mean_further_object_ms(cpu_ms: Mapping[int, float]) -> dict[int, float]:
    """The same over all objects past those of an ordinary frame; NaN up to there."""
    ordinary = cpu_ms.get(ORDINARY, math.nan)
    return {
        count: (more - ordinary) / (count - ORDINARY) if count > ORDINARY else math.nan
        for count, more in cpu_ms.items()
    }


def layers_table(costs: Mapping[int, EngineCost]) -> str:
    """A row for each number of objects in one process; the last four columns tell how the cost grows."""
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
    """The same through Ray, with the CPU time of all processes, and of those that are objects."""
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
