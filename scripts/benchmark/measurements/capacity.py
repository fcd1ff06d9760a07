"""Measure how many frames a second one stream does, by size and objects, and how many cameras a core serves.

Everything that a user pays for counts: an H.264 file is decoded, and the parts are written that a run without
``--save`` writes. The scene has the same objects, relative to the picture, in each size.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from statistics import fmean

from benchmark.measurements.ray_cost import SteadyCost
from benchmark.plots import Plot
from benchmark.result import MeasurementResult
from benchmark.settings import Settings, report_progress
from benchmark.through_ray.endless_video import EndlessReader
from benchmark.through_ray.pipeline import pipeline
from orchestrator.evaluation.datasets import open_sequence
from orchestrator.evaluation.figures import format_number
from orchestrator.run.admission import cores

__all__ = ["Capacity", "cameras_a_core", "capacity_table", "measure_capacity"]

SIZES = ((640, 480), (1280, 720), (1920, 1080), (3840, 2160))
OBJECTS = (1, 3, 8, 16)
CAMERA_RATES = (5, 10, 25)

#: Share of the cores' time that several streams at once make use of, as ``--measure streams`` finds.
EFFICIENCY = 0.9

#: Length of the scene, which is played forward and back: where it turns, some of many objects may be lost.
_SCENE_FRAMES = 60


@dataclass(frozen=True, slots=True)
class Capacity:
    """One stream in steady state.

    Attributes
    ----------
    frames_a_second : float
        Alone on this machine.
    cpu_ms : float
        CPU time of all processes, ms a frame.
    found : float
        Mean number of objects found.
    """

    frames_a_second: float
    cpu_ms: float
    found: float


def measure_capacity(
    settings: Settings,
    sizes: Sequence[tuple[int, int]] = SIZES,
    objects: Sequence[int] = OBJECTS,
) -> MeasurementResult:
    """Run the scene ``steady-crowd`` in each size, (width, height) px, with each number of objects.

    Of smaller sizes than the largest more frames are timed, with as many pixels in all.
    """
    measured: dict[str, dict[int, Capacity]] = {}
    most_pixels = max(width * height for width, height in sizes)
    for width, height in sizes:
        size = f"{width}×{height}"
        measured[size] = {}
        for count in objects:
            report_progress(f"capacity: {size}, {count} objects")
            frames = settings.steady * round(most_pixels / (width * height))
            measured[size][count] = _capacity(settings, width, height, count, frames)
    plot = Plot(
        f"One stream on {cores()} cores, decoding and writing included",
        "megapixels",
        "frames/s",
        [width * height / 1e6 for width, height in sizes],
        {
            f"{count} objects": [by_objects[count].frames_a_second for by_objects in measured.values()]
            for count in objects
        },
        "lines",
    )
    figures = {
        size: {
            str(count): asdict(one)
            | {"cameras_a_core": {str(rate): cameras_a_core(one, rate) for rate in CAMERA_RATES}}
            for count, one in by_objects.items()
        }
        for size, by_objects in measured.items()
    }
    return MeasurementResult((capacity_table(measured),), figures, {"capacity": plot})


def _capacity(settings: Settings, width: int, height: int, objects: int, frames: int) -> Capacity:
    name = f"synthetic:steady-crowd?frames={_SCENE_FRAMES}&width={width}&height={height}&objects={objects}"
    video = replace(settings, sequences={name: open_sequence(name, None)}).endless_video(name)
    with pipeline(settings.config, settings.folder) as session:
        stream = session.start(partial(EndlessReader, video))
        window = session.steady_window(settings.warm, frames)
        arrivals = session.arrivals(stream)
    found = fmean(len(one.objects) for one in arrivals if window.begin < one.seconds <= window.end)
    video.unlink()
    cost = SteadyCost.of(window)
    return Capacity(cost.frames_a_second, cost.all_cpu_ms, found)


def cameras_a_core(capacity: Capacity, rate: float) -> float:
    """Return how many cameras of that many pictures a second a core serves; 0 if one stream is too slow.

    Of the cores' time only what several streams make use of counts. Below 1 a camera needs several cores.
    """
    if capacity.frames_a_second < rate:
        return 0.0
    return EFFICIENCY * 1e3 / (rate * capacity.cpu_ms)


def capacity_table(measured: Mapping[str, Mapping[int, Capacity]]) -> str:
    """Format a row for each size and number of objects, as Markdown."""
    headings = [
        "size", "objects", "found", f"frames/s on {cores()} cores", "CPU ms a frame",
        *(f"cameras a core at {rate} frames/s" for rate in CAMERA_RATES),
    ]  # fmt: skip
    rows = [
        [
            size,
            str(count),
            format_number(one.found),
            format_number(one.frames_a_second),
            format_number(one.cpu_ms),
            *(_cameras(cameras_a_core(one, rate)) for rate in CAMERA_RATES),
        ]
        for size, by_objects in measured.items()
        for count, one in by_objects.items()
    ]
    return "\n".join(map(_markdown, [headings, ["---"] * len(headings), *rows]))


def _cameras(count: float) -> str:
    return f"{count:.2g}" if count else "–"


def _markdown(cells: Iterable[str]) -> str:
    return f"| {' | '.join(cells)} |"
