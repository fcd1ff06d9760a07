"""Measure the cost of a frame by its size: the engine in this process on one scene in four sizes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict

from benchmark.in_process.engine_run import EngineCost, play, steady_cost
from benchmark.plots import Plot
from benchmark.result import MeasurementResult
from benchmark.settings import Settings, report_progress
from orchestrator.evaluation.datasets import open_sequence
from orchestrator.evaluation.figures import format_number, format_table

__all__ = ["SIZES", "measure_sizes"]

SIZES = ((320, 240), (640, 480), (1280, 720), (1920, 1080))


def measure_sizes(settings: Settings, sizes: tuple[tuple[int, int], ...] = SIZES) -> MeasurementResult:
    """Play the scene ``demo`` in each size, (width, height) px."""
    costs = {}
    for number, (width, height) in enumerate(sizes):
        report_progress(f"sizes: {width}×{height} ({number + 1} of {len(sizes)})")
        uri = f"synthetic:demo?frames={settings.frames}&width={width}&height={height}"
        calls = play(settings.played(open_sequence(uri, None)), settings.config)
        costs[f"{width}×{height}"] = steady_cost(calls, settings.warm)
    plot = Plot(
        "A frame by its size, in one process",
        "megapixels",
        "ms a frame",
        [width * height / 1e6 for width, height in sizes],
        {
            "wall": [cost.wall_ms for cost in costs.values()],
            "CPU": [cost.cpu_ms for cost in costs.values()],
        },
        "lines",
    )
    figures = {size: asdict(cost) for size, cost in costs.items()}
    return MeasurementResult((sizes_table(costs, sizes), stages_by_size(costs)), figures, {"sizes": plot})


def sizes_table(costs: Mapping[str, EngineCost], sizes: tuple[tuple[int, int], ...]) -> str:
    """Format a row for each size: wall and CPU ms a frame, and CPU ms a megapixel."""
    rows = [
        [
            size,
            format_number(cost.wall_ms),
            format_number(cost.cpu_ms),
            format_number(1e6 * cost.cpu_ms / (width * height)),
        ]
        for (size, cost), (width, height) in zip(costs.items(), sizes, strict=True)
    ]
    return format_table(["size", "wall ms", "cpu ms", "cpu ms a megapixel"], rows)


def stages_by_size(costs: Mapping[str, EngineCost]) -> str:
    """Format the engine's stages, wall ms a frame: a row for each stage, a column for each size."""
    stages = dict.fromkeys(stage for cost in costs.values() for stage in cost.stage_ms)
    rows = [
        [stage, *(format_number(cost.stage_ms.get(stage, 0.0)) for cost in costs.values())]
        for stage in stages
    ]
    return format_table(["stage: ms", *costs], rows)
