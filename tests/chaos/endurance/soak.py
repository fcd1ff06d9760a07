"""Many long streams whose objects come and go: what the run's processes take over time."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmark.plots import Plot
from benchmark.through_ray.process_costs import LAYER, kinds_of, private_bytes, sum_by_kind
from chaos.harness.observed_run import ObservedRun, content, expect
from chaos.harness.scenario import expect_end
from mlbs_actors.messages import Array
from orchestrator.evaluation.figures import format_table

__all__ = ["Look", "SoakFigures", "growth", "look_at", "memory_plot", "soak"]

#: Between two looks, s.
_LOOK_SECONDS = 5.0

#: Frames of a stream that its growth is told without: buffers fill, objects are born.
_SETTLING_FRAMES = 100


@dataclass(frozen=True, slots=True)
class Look:
    """The run at one moment.

    Attributes
    ----------
    seconds : float
        Since its start, s.
    frames : int
        Read so far, of all streams.
    running : frozenset of str
        Streams at work that have settled.
    memory : dict of str to float
        Private memory of all processes of a kind, MiB.
    processes, layers, descriptors : int
        Of the run; processes that are layers, spare ones too; open files of all processes.
    """

    seconds: float
    frames: int
    running: frozenset[str]
    memory: dict[str, float]
    processes: int
    layers: int
    descriptors: int


@dataclass(frozen=True, slots=True)
class SoakFigures:
    """What a soak showed.

    Attributes
    ----------
    looks : tuple of Look
    label_maps, objects : int
        Committed, and found, over all streams.
    """

    looks: tuple[Look, ...]
    label_maps: int
    objects: int

    def table(self) -> str:
        """The figures as text."""
        looks = self.looks
        largest = max(looks, key=lambda look: sum(look.memory.values()))
        kinds = sorted({kind for look in looks for kind in look.memory})
        rows = [[kind, f"{largest.memory.get(kind, 0.0):.0f}", _growth_text(looks, [kind])] for kind in kinds]
        steady = [kind for kind in kinds if kind != LAYER]
        rows.append(["all but layers", _sum_text(largest, steady), _growth_text(looks, steady)])
        rows.append(["all", _sum_text(largest, kinds), _growth_text(looks, kinds)])
        frames, seconds = looks[-1].frames, looks[-1].seconds
        return "\n".join(
            (
                f"{frames} frames in {seconds:.0f} s, {self.label_maps} label maps, {self.objects} objects",
                f"processes {_range([look.processes for look in looks])}, "
                f"of them layers {_range([look.layers for look in looks])}, "
                f"descriptors {_range([look.descriptors for look in looks])}",
                format_table(["private memory", "MiB at most", "MiB per 1,000 frames"], rows),
            )
        )


def soak(streams: int, frames: int, folder: Path) -> SoakFigures:
    """Run streams through which objects drive, one after the other.

    Parameters
    ----------
    streams, frames : int
        How many, and the length of each.
    folder : Path
        For the run's files.

    Raises
    ------
    NotHeldError
        If the run does not end with every frame labelled.
    """
    names = [f"street{number}" for number in range(streams)]
    lines = [
        f"{name} 'synthetic:traffic?frames={frames}&width=320&height=240&seed={number}'"
        for number, name in enumerate(names)
    ]
    looks: list[Look] = []
    began = time.monotonic()
    with ObservedRun(lines, folder) as run:
        while not run.ended:
            looks.append(look_at(run, time.monotonic() - began))
            time.sleep(_LOOK_SECONDS)
        expect_end(run, 0)
        records = [content(run.output / name) for name in names]
    label_maps = sum(len(record["masks"]) for record in records)
    expect(label_maps == streams * frames, f"{label_maps} label maps of {streams * frames}")
    objects = sum(len({row["layer"] for row in record["layers"]}) for record in records)
    return SoakFigures(tuple(looks), label_maps, objects)


def look_at(run: ObservedRun, seconds: float) -> Look:
    """Look at a run's processes and its status."""
    tree = run.tree()
    kinds = kinds_of(tree, run.pid, {})
    status = run.status()
    memory = sum_by_kind({pid: private_bytes(pid) / 2**20 for pid in tree}, kinds)
    return Look(
        seconds=seconds,
        frames=sum(stream["read"] for stream in status.values()),
        running=frozenset(
            name
            for name, stream in status.items()
            if stream["state"] == "running" and stream["read"] >= _SETTLING_FRAMES
        ),
        memory=memory,
        processes=len(tree),
        layers=sum(kind == LAYER for kind in kinds.values()),
        descriptors=sum(_descriptors(pid) for pid in tree),
    )


def growth(looks: Sequence[Look], kinds: Sequence[str]) -> float:
    """Growth of the memory of processes, MiB per 1,000 frames; nan if nothing can be told.

    The line of least squares through all stretches over which the same streams are at work, in as many
    processes and layers: each has a level of its own. That processes become more is told by their number.
    """
    above, below = 0.0, 0.0
    start = 0
    for end in range(1, len(looks) + 1):
        if end < len(looks) and _at_work(looks[end]) == _at_work(looks[start]):
            continue
        stretch, start = looks[start:end], end
        if stretch[0].running and len(stretch) > 2:
            frames = _centred([look.frames for look in stretch])
            sizes = _centred([sum(look.memory.get(kind, 0.0) for kind in kinds) for look in stretch])
            above, below = above + float(frames @ sizes), below + float(frames @ frames)
    return 1000 * above / below if below else float("nan")


def _at_work(look: Look) -> tuple[frozenset[str], int, int]:
    return look.running, look.processes, look.layers


def memory_plot(looks: Sequence[Look]) -> Plot:
    """The memory of each kind of process over time."""
    kinds = sorted({kind for look in looks for kind in look.memory})
    series = {kind: [look.memory.get(kind, 0.0) for look in looks] for kind in kinds}
    series["all"] = [sum(look.memory.values()) for look in looks]
    minutes = [look.seconds / 60 for look in looks]
    return Plot("Private memory of the run's processes", "minutes", "MiB", minutes, series, "lines")


def _centred(values: Sequence[float]) -> Array:
    array = np.asarray(values, np.float64)
    centred: Array = array - array.mean()
    return centred


def _descriptors(pid: int) -> int:
    try:
        return len([*Path(f"/proc/{pid}/fd").iterdir()])
    except OSError:
        return 0  # it has ended meanwhile


def _growth_text(looks: Sequence[Look], kinds: Sequence[str]) -> str:
    value = growth(looks, kinds)
    return "unknown" if np.isnan(value) else f"{value:+.2f}"


def _sum_text(look: Look, kinds: Sequence[str]) -> str:
    return f"{sum(look.memory.get(kind, 0.0) for kind in kinds):.0f}"


def _range(values: Sequence[int]) -> str:
    return f"{values[0]} at first, {max(values)} at most, {values[-1]} at last"
