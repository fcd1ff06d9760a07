"""Measure several streams at once through Ray, against the best the cores could do, and against a model.

The model (:mod:`benchmark.measurements.node_model`) is given the cost of one stream alone. Where it predicts
the rates of several at once, its predictions for other nodes are credible: how many cameras they would serve.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from statistics import fmean

from benchmark.measurements.node_model import StageCosts, most_cameras, simulate
from benchmark.measurements.ray_cost import cpu_ms_by_kind, mean_of_kinds
from benchmark.plots import Plot
from benchmark.result import MeasurementResult
from benchmark.settings import Settings, report_progress
from benchmark.through_ray.endless_video import EndlessReader
from benchmark.through_ray.pipeline import ROUNDS, SteadyWindow, pipeline
from benchmark.through_ray.process_costs import cpu_growth
from orchestrator.evaluation.figures import format_number, format_table
from orchestrator.run.admission import cores
from orchestrator.run.need import PLACE_BYTES

__all__ = ["STREAMS", "StreamsCost", "fleet_table", "measure_streams", "most_frames_a_second"]

STREAMS = (1, 2, 4, 8)

#: Cores of the simulated nodes; number and picture rate of the cameras.
_NODES = (2, 8, 16, 64)
_CAMERAS, _CAMERA_RATE = 1000, 5.0


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
        """Derive the cost from a steady window."""
        seconds = sum(cpu_growth(window.before, window.after).values())
        return StreamsCost(window.frames_a_second, 1e3 * seconds / window.frames)

    @staticmethod
    def mean(costs: Sequence[StreamsCost]) -> StreamsCost:
        """Average the costs of several runs."""
        return StreamsCost(fmean(one.frames_a_second for one in costs), fmean(one.cpu_ms for one in costs))


def measure_streams(settings: Settings, streams: tuple[int, ...] = STREAMS) -> MeasurementResult:
    """Run each sequence through Ray once, twice … at once, without the admission control of a run.

    All streams are in one session, in which one, two … of them run alternately, so that a change of the
    machine's own speed affects all numbers alike. The means count.
    """
    tables, figures, plots = [], {}, {}
    for number, name in enumerate(settings.sequences):
        video = settings.endless_video(name)
        runs: dict[int, list[StreamsCost]] = {count: [] for count in streams}
        alone: list[Mapping[str, float]] = []
        activity = f"streams: {name}, {', '.join(map(str, streams))} at once, alternately"
        report_progress(f"{activity}: until all processes are there")
        with pipeline(settings.config, settings.folder) as session:
            numbers = [session.start(partial(EndlessReader, video)) for _ in range(max(streams))]
            groups = [numbers[:count] for count in streams]
            for round_number, windows in enumerate(
                session.alternating_windows(settings.warm, settings.steady, groups)
            ):
                report_progress(f"{activity} ({round_number + 1} of {ROUNDS} done)")
                for count, window in zip(streams, windows, strict=True):
                    runs[count].append(StreamsCost.of(window))
                alone.append(cpu_ms_by_kind(windows[0]))
                kinds = list(windows[0].kinds.values())
        objects = kinds.count("object layer") // len(numbers)
        one = StageCosts.of(mean_of_kinds(alone), objects)
        costs = {count: StreamsCost.mean(of_count) for count, of_count in runs.items()}
        most = most_frames_a_second(cores(), costs[streams[0]].cpu_ms)
        report_progress(f"streams: {name}, the model of nodes")
        modelled = {count: simulate(one, count, cores()).frames_a_second for count in streams}
        tables += [streams_table(name, costs, modelled, most), fleet_table(name, one)]
        figures[name] = {
            "most_frames_a_second": most,
            "modelled_frames_a_second": {str(count): rate for count, rate in modelled.items()},
            "streams": {str(count): asdict(cost) for count, cost in costs.items()},
        }
        plots[f"streams-{number}" if number else "streams"] = Plot(
            f"Streams at once on {cores()} cores: {name}",
            "streams",
            "frames/s of all together",
            list(costs),
            {
                "measured": [cost.frames_a_second for cost in costs.values()],
                "model": list(modelled.values()),
                "cores ÷ CPU time a frame": [most] * len(costs),
            },
            "lines",
        )
    return MeasurementResult(tuple(tables), figures, plots)


def most_frames_a_second(core_count: int, cpu_ms: float) -> float:
    """Return the rate of cores that do nothing else and never wait."""
    return 1e3 * core_count / cpu_ms


def streams_table(
    name: str, costs: Mapping[int, StreamsCost], modelled: Mapping[int, float], most: float
) -> str:
    """Format a row for each number of streams: rates, CPU time, and the rate against the best possible."""
    rows = [
        [
            str(count),
            format_number(cost.frames_a_second),
            format_number(modelled[count]),
            format_number(cost.cpu_ms),
            f"{100 * cost.frames_a_second / most:.0f} %",
        ]
        for count, cost in costs.items()
    ]
    bound = f"of {most:.1f} frames/s ({cores()} cores ÷ CPU time of one stream)"
    headings = [f"{name}: streams", "frames/s together", "model", "CPU ms a frame", bound]
    return format_table(headings, rows)


def fleet_table(name: str, costs: StageCosts, nodes: tuple[int, ...] = _NODES) -> str:
    """Format how many cameras nodes of some sizes serve, and how many nodes a thousand cameras need."""
    rows = []
    for node_cores in nodes:
        cameras = most_cameras(costs, node_cores, _CAMERA_RATE)
        run = simulate(costs, cameras, node_cores, _CAMERA_RATE)
        rows.append(
            [
                str(node_cores),
                str(cameras),
                f"{100 * run.frames_a_second * costs.together / (1e3 * node_cores):.0f} %",
                f"{100 * run.sink_busy:.0f} %",
                f"{cameras * PLACE_BYTES / 2**30:.0f}",
                str(-(-_CAMERAS // cameras)) if cameras else "-",
            ]
        )
    headings = [
        f"{name}: cores of a node (model)", f"cameras at {_CAMERA_RATE:g} frames/s", "cores busy",
        "sinks busy", "memory GiB", f"nodes for {_CAMERAS} cameras",
    ]  # fmt: skip
    return format_table(headings, rows)
