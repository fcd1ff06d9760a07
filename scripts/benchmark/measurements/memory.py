"""Measure the private memory of a stream's processes, by kind."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

from benchmark.plots import Plot
from benchmark.result import MeasurementResult
from benchmark.settings import Settings, report_progress
from benchmark.through_ray.endless_video import EndlessReader
from benchmark.through_ray.pipeline import SteadyWindow, pipeline
from orchestrator.evaluation.figures import format_table

__all__ = ["KindMemory", "measure_memory", "memory_by_kind", "stream_mib"]

#: Kinds that every stream has for itself; the rest it shares with the others of its node.
_OF_A_STREAM = ("reader", "coordinator", "segmenter", "background layer", "object layer")


@dataclass(frozen=True, slots=True)
class KindMemory:
    """The processes of one kind.

    Attributes
    ----------
    processes : int
    mean_mib, largest_mib : float
        Private memory of one of them, MiB.
    """

    processes: int
    mean_mib: float
    largest_mib: float


def measure_memory(settings: Settings) -> MeasurementResult:
    """Run each sequence through Ray and read its processes' memory at the end of the steady window."""
    tables, figures, plots = [], {}, {}
    for number, name in enumerate(settings.sequences):
        report_progress(f"memory: {name} ({number + 1} of {len(settings.sequences)})")
        video = settings.endless_video(name)
        with pipeline(settings.config, settings.folder) as session:
            session.start(partial(EndlessReader, video))
            kinds = memory_by_kind(session.steady_window(settings.warm, settings.steady))
        tables.append(memory_table(name, kinds))
        figures[name] = {
            kind: {"processes": one.processes, "mean_mib": one.mean_mib, "largest_mib": one.largest_mib}
            for kind, one in kinds.items()
        } | {"stream_mib": stream_mib(kinds)}
        plots[f"memory-{number}" if number else "memory"] = Plot(
            f"Private memory of a process: {name}",
            "",
            "MiB",
            list(kinds),
            {"mean": [one.mean_mib for one in kinds.values()]},
            "bars",
        )
    return MeasurementResult(tuple(tables), figures, plots)


def memory_by_kind(window: SteadyWindow) -> dict[str, KindMemory]:
    """Summarise the private memory at the end of a window, by kind."""
    by_kind: dict[str, list[float]] = {}
    for pid, size in window.memory.items():
        by_kind.setdefault(window.kinds[pid], []).append(size / 2**20)
    return {
        kind: KindMemory(len(sizes), sum(sizes) / len(sizes), max(sizes))
        for kind, sizes in sorted(by_kind.items())
    }


def stream_mib(kinds: dict[str, KindMemory]) -> float:
    """Sum the private memory of all processes that one stream has for itself, MiB."""
    return sum(kinds[kind].processes * kinds[kind].mean_mib for kind in _OF_A_STREAM if kind in kinds)


def memory_table(name: str, kinds: dict[str, KindMemory]) -> str:
    """Format a row for each kind of process, then the stream's own together and all of the session."""
    rows = [
        [kind, str(one.processes), f"{one.mean_mib:.0f}", f"{one.largest_mib:.0f}"]
        for kind, one in kinds.items()
    ]
    objects = kinds["object layer"].processes if "object layer" in kinds else 0
    rows.append([f"the stream, with {objects} objects", "", f"{stream_mib(kinds):.0f}", ""])
    together = sum(one.processes * one.mean_mib for one in kinds.values())
    rows.append(["all of the session", "", f"{together:.0f}", ""])
    return format_table([f"{name}: private MiB", "processes", "mean", "largest"], rows)
