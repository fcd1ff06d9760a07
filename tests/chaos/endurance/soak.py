"""Run many long streams whose objects come and go, and sample the resources of its processes."""

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

__all__ = ["Sample", "SoakFigures", "growth", "memory_plot", "soak", "take_sample"]

#: Interval between two samples, s.
_SAMPLE_SECONDS = 5.0

#: First frames of a stream that do not count for the growth: buffers fill, objects are born.
_SETTLING_FRAMES = 100


@dataclass(frozen=True, slots=True)
class Sample:
    """Resources of the run at one moment.

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
    """Outcome of a soak.

    Attributes
    ----------
    samples : tuple of Sample
    label_maps, objects : int
        Committed, and found, over all streams.
    """

    samples: tuple[Sample, ...]
    label_maps: int
    objects: int

    def table(self) -> str:
        """Format the figures."""
        samples = self.samples
        largest = max(samples, key=lambda sample: sum(sample.memory.values()))
        kinds = sorted({kind for sample in samples for kind in sample.memory})
        rows = [
            [kind, f"{largest.memory.get(kind, 0.0):.0f}", _growth_text(samples, [kind])] for kind in kinds
        ]
        steady = [kind for kind in kinds if kind != LAYER]
        rows.append(["all but layers", _sum_text(largest, steady), _growth_text(samples, steady)])
        rows.append(["all", _sum_text(largest, kinds), _growth_text(samples, kinds)])
        frames, seconds = samples[-1].frames, samples[-1].seconds
        return "\n".join(
            (
                f"{frames} frames in {seconds:.0f} s, {self.label_maps} label maps, {self.objects} objects",
                f"processes {_range([sample.processes for sample in samples])}, "
                f"of them layers {_range([sample.layers for sample in samples])}, "
                f"descriptors {_range([sample.descriptors for sample in samples])}",
                format_table(["private memory", "MiB at most", "MiB per 1,000 frames"], rows),
            )
        )


def soak(streams: int, frames: int, folder: Path) -> SoakFigures:
    """Run streams at once in which objects drive through the scene, one after the other.

    Parameters
    ----------
    streams, frames : int
        How many, and the length of each.
    folder : Path
        For the run's files.

    Raises
    ------
    ExpectationError
        If the run does not end with every frame labelled.
    """
    names = [f"street{number}" for number in range(streams)]
    lines = [
        f"{name} 'synthetic:traffic?frames={frames}&width=320&height=240&seed={number}'"
        for number, name in enumerate(names)
    ]
    samples: list[Sample] = []
    began = time.monotonic()
    with ObservedRun(lines, folder) as run:
        while not run.ended:
            samples.append(take_sample(run, time.monotonic() - began))
            time.sleep(_SAMPLE_SECONDS)
        expect_end(run, 0)
        records = [content(run.output / name) for name in names]
    label_maps = sum(len(record["masks"]) for record in records)
    expect(label_maps == streams * frames, f"{label_maps} label maps of {streams * frames}")
    objects = sum(len({row["layer"] for row in record["layers"]}) for record in records)
    return SoakFigures(tuple(samples), label_maps, objects)


def take_sample(run: ObservedRun, seconds: float) -> Sample:
    """Sample a run's processes and its status."""
    tree = run.tree()
    kinds = kinds_of(tree, run.pid, {})
    status = run.status()
    memory = sum_by_kind({pid: private_bytes(pid) / 2**20 for pid in tree}, kinds)
    return Sample(
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


def growth(samples: Sequence[Sample], kinds: Sequence[str]) -> float:
    """Return the growth of the memory of processes, MiB per 1,000 frames; nan if it is not known.

    It is the slope of a least-squares fit over all stretches with the same streams at work, in as many
    processes and layers; each stretch has a level of its own. The number of processes is reported separately.
    """
    above, below = 0.0, 0.0
    start = 0
    for end in range(1, len(samples) + 1):
        if end < len(samples) and _at_work(samples[end]) == _at_work(samples[start]):
            continue
        stretch, start = samples[start:end], end
        if stretch[0].running and len(stretch) > 2:
            frames = _centred([sample.frames for sample in stretch])
            sizes = _centred([sum(sample.memory.get(kind, 0.0) for kind in kinds) for sample in stretch])
            above, below = above + float(frames @ sizes), below + float(frames @ frames)
    return 1000 * above / below if below else float("nan")


def _at_work(sample: Sample) -> tuple[frozenset[str], int, int]:
    return sample.running, sample.processes, sample.layers


def memory_plot(samples: Sequence[Sample]) -> Plot:
    """Return a plot of the memory of each kind of process over time."""
    kinds = sorted({kind for sample in samples for kind in sample.memory})
    series = {kind: [sample.memory.get(kind, 0.0) for sample in samples] for kind in kinds}
    series["all"] = [sum(sample.memory.values()) for sample in samples]
    minutes = [sample.seconds / 60 for sample in samples]
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


def _growth_text(samples: Sequence[Sample], kinds: Sequence[str]) -> str:
    value = growth(samples, kinds)
    return "unknown" if np.isnan(value) else f"{value:+.2f}"


def _sum_text(sample: Sample, kinds: Sequence[str]) -> str:
    return f"{sum(sample.memory.get(kind, 0.0) for kind in kinds):.0f}"


def _range(values: Sequence[int]) -> str:
    return f"{values[0]} at first, {max(values)} at most, {values[-1]} at last"
