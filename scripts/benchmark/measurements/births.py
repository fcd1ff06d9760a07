"""Measure how long a frame takes when an object enters, against the others."""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from itertools import pairwise

from benchmark.in_process.engine_run import EngineCall, play
from benchmark.plots import Plot
from benchmark.result import MeasurementResult
from benchmark.settings import Settings, report_progress
from benchmark.through_ray.endless_video import open_video, write_video
from benchmark.through_ray.pipeline import Arrival, pipeline
from mlbs_actors.warm_up import warm_coordinator, warm_segmenter
from orchestrator.evaluation.datasets import open_sequence
from orchestrator.evaluation.figures import format_number, format_table

__all__ = ["BirthCost", "FrameTime", "birth_cost", "measure_births", "times_in_process", "times_through_ray"]

#: Scenes in which objects enter: some time after each other, two soon after the start, 32 almost at once.
SCENES = ("traffic", "late-entry", "crowd")

_SIZE = (640, 480)


@dataclass(frozen=True, slots=True)
class FrameTime:
    """One frame's wall time, ms, and whether an object was seen in it for the first time."""

    frame: int
    wall_ms: float
    birth: bool


@dataclass(frozen=True, slots=True)
class BirthCost:
    """Times of the frames with a birth against those of all frames.

    Attributes
    ----------
    births : int
        Frames with at least one.
    median_ms : float
        Of all frames.
    longest_birth_ms, longest_other_ms : float
        Of the frames with and without a birth; NaN if there are none.
    """

    births: int
    median_ms: float
    longest_birth_ms: float
    longest_other_ms: float


def measure_births(
    settings: Settings, scenes: tuple[str, ...] = SCENES, size: tuple[int, int] = _SIZE
) -> MeasurementResult:
    """Play each scene once, in this process and through Ray.

    Through Ray a frame's time is that between its label map and the one before, as they are made, and the
    pool has the idle processes of a run before. In this process, as in those of Ray,
    the kernels have been loaded before: loading them is not a cost of a birth.
    """
    warm_coordinator()
    warm_segmenter()
    rows, figures, plots = [], {}, {}
    for number, name in enumerate(scenes):
        report_progress(f"births: {name} in this process ({number + 1} of {len(scenes)})")
        uri = f"synthetic:{name}?frames={settings.frames}&width={size[0]}&height={size[1]}"
        frames = list(settings.played(open_sequence(uri, None)))
        alone = times_in_process(play(frames, settings.config), settings.warm)
        report_progress(f"births: {name} through Ray ({number + 1} of {len(scenes)})")
        video = settings.folder / f"{name}.mp4"
        write_video(frames, video)
        with pipeline(settings.config, settings.folder) as session:
            session.start(partial(open_video, video), max_frames=settings.warm)
            session.run_to_end()
            session.settle()
            stream = session.start(partial(open_video, video))
            session.run_to_end()
            by_ray = times_through_ray(session.arrivals(stream), settings.warm)
        ways = {"in process": alone, "through Ray": by_ray}
        rows += [(name, way, birth_cost(times)) for way, times in ways.items()]
        figures[name] = {
            way: asdict(birth_cost(times)) | {"frames": [asdict(time) for time in times]}
            for way, times in ways.items()
        }
        plots[f"births-{name}"] = Plot(
            f"Wall time of each frame: {name}",
            "frame",
            "ms",
            [time.frame for time in alone],
            {way: _by_frame(times, alone) for way, times in ways.items()}
            | {f"births {way}": _by_frame(times, alone, births=True) for way, times in ways.items()},
            "lines",
        )
    return MeasurementResult((births_table(rows),), figures, plots)


def times_in_process(calls: Sequence[EngineCall], warm: int) -> list[FrameTime]:
    """Return the times after the warm calls; a birth counts for the call that returned its label map."""
    born = _births(frozenset().union(*call.objects) for call in calls)
    return [
        FrameTime(index, call.wall_ms, birth)
        for index, (call, birth) in enumerate(zip(calls, born, strict=True))
        if index >= warm
    ]


def times_through_ray(arrivals: Sequence[Arrival], warm: int) -> list[FrameTime]:
    """Return the time from each label map to the next, as they are made, after the warm ones."""
    born = _births(one.objects for one in arrivals)
    return [
        FrameTime(one.frame, 1e3 * (one.labelled - before.labelled), birth)
        for (before, one), birth in zip(pairwise(arrivals), born[1:], strict=True)
        if one.frame >= warm
    ]


def _births(objects: Iterable[frozenset[int]]) -> list[bool]:
    known: frozenset[int] = frozenset()
    born = []
    for seen in objects:
        born.append(not seen <= known)
        known |= seen
    return born


def birth_cost(times: Sequence[FrameTime]) -> BirthCost:
    """Return the median of all frames, and the longest with and without a birth."""
    births = [time.wall_ms for time in times if time.birth]
    others = [time.wall_ms for time in times if not time.birth]
    return BirthCost(
        len(births),
        statistics.median(time.wall_ms for time in times),
        max(births, default=math.nan),
        max(others, default=math.nan),
    )


def _by_frame(
    times: Sequence[FrameTime], frames: Sequence[FrameTime], *, births: bool = False
) -> list[float]:
    """Align times with the frames of others; NaN, which is not drawn, where there is none."""
    known = {time.frame: time.wall_ms for time in times if time.birth or not births}
    return [known.get(time.frame, math.nan) for time in frames]


def births_table(rows: Sequence[tuple[str, str, BirthCost]]) -> str:
    """Format a row for each scene and way to run."""
    cells = [
        [
            name,
            way,
            str(cost.births),
            format_number(cost.median_ms),
            format_number(cost.longest_birth_ms),
            "-" if math.isnan(cost.longest_birth_ms) else f"{cost.longest_birth_ms / cost.median_ms:.2f}",
            format_number(cost.longest_other_ms),
        ]
        for name, way, cost in rows
    ]
    headings = [
        "scene", "run", "frames with births", "median ms", "longest at a birth", "× median", "longest other"
    ]  # fmt: skip
    return format_table(headings, cells)
