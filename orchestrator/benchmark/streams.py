"""Several streams at once through Ray, against what the cores could do at best."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import partial

from orchestrator.admission import cores
from orchestrator.benchmark.finding import Finding
from orchestrator.benchmark.pipeline import SteadyWindow, pipeline
from orchestrator.benchmark.played_video import EndlessReader
from orchestrator.benchmark.plots import Plot
from orchestrator.benchmark.process_costs import cpu_growth
from orchestrator.benchmark.setting import Setting, say
from orchestrator.evaluation.figures import format_number, format_table

__all__ = ["STREAMS", "StreamsCost", "measure_streams", "most_frames_a_second"]

STREAMS = (1, 2, 4, 8)


@dataclass(frozen=True, slots=True)
class StreamsCost:
    """Some streams at once in steady state.

    Attributes
    ----------
    frames_a_second : float
        Of all together.
    cpu_ms : float
        CPU time of all processes of the session, ms a frame.
    """

    frames_a_second: float
    cpu_ms: float

    @staticmethod
    def of(window: SteadyWindow) -> StreamsCost:
        """What a steady window shows."""
        seconds = sum(cpu_growth(window.before, window.after).values())
        return StreamsCost(window.frames_a_second, 1e3 * seconds / window.frames)


def measure_streams(setting: Setting, streams: tuple[int, ...] = STREAMS) -> Finding:
    """Run each sequence through Ray once, twice … at once; none waits for a place, as in a run it might."""
    tables, figures, plots = [], {}, {}
    for number, name in enumerate(setting.sequences):
        video = setting.endless_video(name)
        costs = {}
        for step, count in enumerate(streams):
            say(f"streams: {name}, {count} at once ({step + 1} of {len(streams)})")
            with pipeline(setting.config, setting.folder) as session:
                for _ in range(count):
                    session.start(partial(EndlessReader, video))
                costs[count] = StreamsCost.of(session.steady_window(setting.warm, setting.steady))
        most = most_frames_a_second(cores(), costs[streams[0]].cpu_ms)
        tables.append(streams_table(name, costs, most))
        figures[name] = {
            "most_frames_a_second": most,
            "streams": {str(count): asdict(cost) for count, cost in costs.items()},
        }
        plots[f"streams-{number}" if number else "streams"] = Plot(
            f"Streams at once on {cores()} cores: {name}",
            "streams",
            "frames/s of all together",
            list(costs),
            {
                "measured": [cost.frames_a_second for cost in costs.values()],
                "cores ÷ CPU time a frame": [most] * len(costs),
            },
            "lines",
        )
    return Finding(tuple(tables), figures, plots)


def most_frames_a_second(core_count: int, cpu_ms: float) -> float:
    """What the cores could do if they were busy with nothing else and never waited."""
    return 1e3 * core_count / cpu_ms


def streams_table(name: str, costs: Mapping[int, StreamsCost], most: float) -> str:
    """A row for each number of streams: rate, CPU time, and the rate against what the cores could do."""
    rows = [
        [
            str(count),
            format_number(cost.frames_a_second),
            format_number(cost.cpu_ms),
            f"{100 * cost.frames_a_second / most:.0f} %",
        ]
        for count, cost in costs.items()
    ]
    bound = f"of {most:.1f} frames/s ({cores()} cores ÷ CPU time of one stream)"
    return format_table([f"{name}: streams", "frames/s together", "CPU ms a frame", bound], rows)
