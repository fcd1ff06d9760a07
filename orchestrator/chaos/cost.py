"""What recovery costs: the rate of a stream whose record survives a kill, beside one that keeps nothing."""

from __future__ import annotations

import statistics
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from mlbs_actors.actors.stream_protocol import StreamSink
from mlbs_actors.config import Config
from orchestrator.benchmark.empty_parts import EmptySink
from orchestrator.benchmark.pipeline import Pipeline, pipeline
from orchestrator.evaluation.figures import format_table
from orchestrator.sinks.record import StreamRecord
from orchestrator.sources.opening import SceneReader
from orchestrator.sources.synthetic import scene

__all__ = ["CostFigures", "measure_cost"]

_WIDTH, _HEIGHT = 320, 240

#: Frames of the start, that are not timed.
_WARM_FRAMES = 16


@dataclass(frozen=True, slots=True)
class CostFigures:
    """Rates of streams that were run alternately, one after the other.

    Attributes
    ----------
    recorded, unrecorded : tuple of float
        Label maps a second.
    """

    recorded: tuple[float, ...]
    unrecorded: tuple[float, ...]

    @property
    def ratios(self) -> list[float]:
        """Of each pair, the rate with recovery over that without."""
        return [one / other for one, other in zip(self.recorded, self.unrecorded, strict=True)]

    def table(self) -> str:
        """The figures as text."""
        pairs = zip(self.recorded, self.unrecorded, self.ratios, strict=True)
        rows = [
            [str(number), f"{one:.2f}", f"{other:.2f}", f"{ratio:.3f}"]
            for number, (one, other, ratio) in enumerate(pairs, 1)
        ]
        rows.append(["median", "", "", f"{statistics.median(self.ratios):.3f}"])
        return format_table(["pair", "frames/s with recovery", "without", "ratio"], rows)


def measure_cost(pairs: int, frames: int, scratch: Path) -> CostFigures:
    """Run a scene again and again in one session, in turn with and without record and snapshots.

    Parameters
    ----------
    pairs, frames : int
        How often, and the length of the scene.
    scratch : Path
        From :func:`orchestrator.ray_session.ray_settings`.
    """
    rates: dict[Callable[[Path], StreamSink], list[float]] = {_record: [], _nothing: []}
    with pipeline(Config(), scratch) as session:
        _rate(session, _nothing, 2 * _WARM_FRAMES)  # everything is compiled, and the pool is filled
        for pair in range(pairs):
            for kind in (_record, _nothing) if pair % 2 else (_nothing, _record):
                rates[kind].append(_rate(session, kind, frames))
    return CostFigures(tuple(rates[_record]), tuple(rates[_nothing]))


def _rate(session: Pipeline, open_record: Callable[[Path], StreamSink], frames: int) -> float:
    session.settle()
    number = session.start(partial(_reader, frames), open_record)
    session.run_to_end()
    timed = session.arrivals(number)[_WARM_FRAMES:]
    return (len(timed) - 1) / (timed[-1].seconds - timed[0].seconds)


def _reader(frames: int) -> SceneReader:
    return SceneReader(scene("demo", frames=frames, width=_WIDTH, height=_HEIGHT))


def _record(folder: Path) -> StreamRecord:
    """A record as the command keeps it, without what is derived from it; with snapshots."""
    return StreamRecord(folder, folder.name, frozenset({"masks", "parquet"}))


def _nothing(folder: Path) -> EmptySink:
    return EmptySink()
