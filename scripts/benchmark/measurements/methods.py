"""Compare the engine with its peers on each sequence: scores and times; the engine's stages."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from benchmark.in_process.comparison import ENGINE, Measurement, measure
from benchmark.in_process.peers import PEERS
from benchmark.plots import Plot
from benchmark.result import MeasurementResult
from benchmark.settings import Settings, report_progress
from orchestrator.evaluation.figures import format_number, format_table, mean_of_sequences

__all__ = ["as_json", "measure_methods", "methods_table", "stages_table"]

#: The peer that the others are compared with.
REFERENCE = "composite"


def measure_methods(settings: Settings, peers: Sequence[str]) -> MeasurementResult:
    """Time the engine and the peers of these names on each sequence."""
    measured = {}
    for name, sequence in settings.sequences.items():
        report_progress(f"{name}: {settings.frames} frames")
        chosen = {peer: PEERS[peer] for peer in peers}
        measured[name] = measure(sequence, chosen, settings.config, settings.frames, settings.warm)
    plot = Plot(
        "CPU time by method, in one process and one thread",
        "",
        "ms a frame",
        [ENGINE, *peers],
        {name: [one.cpu_ms for one in methods] for name, methods in measured.items()},
        "bars",
    )
    return MeasurementResult(
        (methods_table(measured), stages_table(measured)), as_json(measured), {"methods": plot}
    )


def methods_table(measured: dict[str, list[Measurement]]) -> str:
    """Format a row for each sequence and method: its scores, its times, CPU time against the composite's.

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
    """Format the engine's stages, ms a frame: a row for each stage, a column for each sequence."""
    columns = {name: methods[0].stage_ms for name, methods in measured.items()}
    stages = dict.fromkeys(stage for column in columns.values() for stage in column)
    rows = [
        [stage, *(format_number(column.get(stage, 0.0)) for column in columns.values())] for stage in stages
    ]
    rows.append(["together", *(format_number(sum(column.values())) for column in columns.values())])
    return format_table([f"{ENGINE}: ms", *columns], rows)


def as_json(measured: dict[str, list[Measurement]]) -> dict[str, Any]:
    """Return the figures by sequence and method, percent and ms."""
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
