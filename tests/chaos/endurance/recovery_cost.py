"""Measure the cost of recovery: the rate of a stream whose record survives a kill, beside one that would not.

Both write the same masks and tables, which is what the run is for. The difference is what only serves to
resume after a kill: waiting for the disk, and the snapshots. The two kinds of streams run alternately in one
session, so that other load of the machine affects both.
"""

from __future__ import annotations

import statistics
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from unittest import mock

from benchmark.through_ray.pipeline import Pipeline, pipeline
from mlbs_actors.actors.stream.protocol import Opening, StreamSink
from mlbs_actors.config import Config
from mlbs_actors.messages import LayerAppearance, Segmentation
from mlbs_actors.scenes.synthetic import scene
from mlbs_actors.source import SourceFrame
from orchestrator.evaluation.figures import format_table
from orchestrator.sinks.record import StreamRecord
from orchestrator.sources.opening import SceneReader

__all__ = ["CostFigures", "measure_cost"]

_WIDTH, _HEIGHT = 320, 240

_SAVE = frozenset({"masks", "parquet"})

#: Frames at the start that are not timed.
_WARM_FRAMES = 16


@dataclass(frozen=True, slots=True)
class CostFigures:
    """Rates of streams that were run alternately, one after the other.

    Attributes
    ----------
    safe, unsafe : tuple of float
        Label maps a second, of records that survive a kill and of those that do not.
    """

    safe: tuple[float, ...]
    unsafe: tuple[float, ...]

    @property
    def ratios(self) -> list[float]:
        """Return for each pair the rate with recovery over that without."""
        return [one / other for one, other in zip(self.safe, self.unsafe, strict=True)]

    def table(self) -> str:
        """Format the figures."""
        pairs = zip(self.safe, self.unsafe, self.ratios, strict=True)
        rows = [
            [str(number), f"{one:.2f}", f"{other:.2f}", f"{ratio:.3f}"]
            for number, (one, other, ratio) in enumerate(pairs, 1)
        ]
        rows.append(["median", "", "", f"{statistics.median(self.ratios):.3f}"])
        return format_table(["pair", "frames/s with recovery", "without", "ratio"], rows)


def measure_cost(pairs: int, frames: int, scratch: Path) -> CostFigures:
    """Run a scene repeatedly in one session, alternately with and without what recovery needs.

    Parameters
    ----------
    pairs, frames : int
        How often, and the length of the scene.
    scratch : Path
        From :func:`orchestrator.ray_session.ray_settings`.
    """
    rates: dict[Callable[[Path], StreamSink], list[float]] = {_safe: [], _UnsafeRecord: []}
    with pipeline(Config(), scratch) as session:
        _rate(session, _safe, 2 * _WARM_FRAMES)  # everything is compiled, and the pool is filled
        for pair in range(pairs):
            for kind in (_safe, _UnsafeRecord) if pair % 2 else (_UnsafeRecord, _safe):
                rates[kind].append(_rate(session, kind, frames))
    return CostFigures(tuple(rates[_safe]), tuple(rates[_UnsafeRecord]))


def _rate(session: Pipeline, open_record: Callable[[Path], StreamSink], frames: int) -> float:
    session.settle()
    number = session.start(partial(_reader, frames), open_record)
    session.run_to_end()
    timed = session.arrivals(number)[_WARM_FRAMES:]
    return (len(timed) - 1) / (timed[-1].seconds - timed[0].seconds)


def _reader(frames: int) -> SceneReader:
    return SceneReader(scene("demo", frames=frames, width=_WIDTH, height=_HEIGHT))


def _safe(folder: Path) -> StreamRecord:
    """Open a record as the command does, with snapshots, without derived outputs."""
    return StreamRecord(folder, folder.name, _SAVE)


class _UnsafeRecord(StreamRecord):
    """The same files and commits, but without waiting for the disk, and without snapshots."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder, folder.name, _SAVE)
        self.opening = Opening()

    def write(
        self, segmentation: Segmentation, frame: SourceFrame, background: LayerAppearance | None = None
    ) -> int:
        with _not_synced():
            return super().write(segmentation, frame, background)

    def close(self, *, whole: bool) -> int:
        with _not_synced():
            return super().close(whole=whole)


@contextmanager
def _not_synced() -> Iterator[None]:
    with mock.patch("os.fsync", return_value=None):
        yield
