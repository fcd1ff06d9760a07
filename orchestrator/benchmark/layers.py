"""The cost of a frame by the number of objects in it: the engine in this process on a steady crowd."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict
from itertools import pairwise

from orchestrator.benchmark.engine_run import EngineCost, play, steady_cost
from orchestrator.benchmark.finding import Finding
from orchestrator.benchmark.plots import Plot
from orchestrator.benchmark.setting import Setting, say
from orchestrator.evaluation.datasets import open_sequence
from orchestrator.evaluation.figures import format_number, format_table

__all__ = ["OBJECTS", "further_object_ms", "layers_table", "measure_layers"]

OBJECTS = (1, 3, 8, 16, 32)

#: The number of objects of an ordinary frame, which the others are held against.
ORDINARY = 3

_SIZE = "width=640&height=480"


def measure_layers(setting: Setting, objects: tuple[int, ...] = OBJECTS) -> Finding:
    """Play the scene ``steady-crowd`` at 640×480 with each number of objects."""
    costs = {}
    for number, count in enumerate(objects):
        say(f"layers: {count} objects ({number + 1} of {len(objects)})")
        uri = f"synthetic:steady-crowd?frames={setting.frames}&{_SIZE}&objects={count}"
        costs[count] = steady_cost(
            play(setting.played(open_sequence(uri, None)), setting.config), setting.warm
        )
    plot = Plot(
        "A frame by the number of its objects (640×480, 1 % of the frame each), in one process",
        "objects",
        "ms a frame",
        list(costs),
        {
            "wall": [cost.wall_ms for cost in costs.values()],
            "CPU": [cost.cpu_ms for cost in costs.values()],
        },
        "lines",
    )
    further = further_object_ms(costs)
    figures = {
        str(count): asdict(cost) | {"further_object_ms": further[count]} for count, cost in costs.items()
    }
    return Finding((layers_table(costs),), figures, {"layers": plot})


def further_object_ms(costs: Mapping[int, EngineCost]) -> dict[int, float]:
    """CPU time of one object more, ms a frame: the mean from the row before; NaN for the first."""
    further = dict.fromkeys(costs, math.nan)
    for (fewer, less), (count, more) in pairwise(costs.items()):
        further[count] = (more.cpu_ms - less.cpu_ms) / (count - fewer)
    return further


def layers_table(costs: Mapping[int, EngineCost]) -> str:
    """A row for each number of objects; the last three columns tell how the cost grows."""
    ordinary = costs[ORDINARY].cpu_ms if ORDINARY in costs else math.nan
    rows = [
        [
            str(count),
            format_number(cost.objects),
            format_number(cost.wall_ms),
            format_number(cost.cpu_ms),
            _ratio(cost.cpu_ms / ordinary),
            format_number(further),
            format_number(100 * further / ordinary),
        ]
        for (count, cost), further in zip(costs.items(), further_object_ms(costs).values(), strict=True)
    ]
    headings = [
        "objects",
        "found",
        "wall ms",
        "cpu ms",
        f"× {ORDINARY} objects",
        "cpu ms a further object",
        f"% of a frame with {ORDINARY}",
    ]
    return format_table(headings, rows)


def _ratio(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.2f}"
