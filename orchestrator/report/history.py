"""The history of a stream from its record: its frames, the lives of its layers, the time of each stage."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa

from mlbs_actors.messages import Array
from orchestrator.report.endings import ENDING_COLUMNS, Ending, ending
from orchestrator.sinks.record_tables import read_table

__all__ = ["LayerLife", "StageTimes", "StreamHistory", "frame_ranges", "read_history"]

#: Stages in the order of processing; others come after these.
_ORDER = (
    "flow",
    "tracking",
    "affinity",
    "clustering",
    "update",
    "gabp",
    "posterior",
    "fusion",
    "cut",
    "cleaning",
)


@dataclass(frozen=True, slots=True)
class LayerLife:
    """When one object was seen.

    Attributes
    ----------
    layer : int
    kind : str
    spans : tuple of (int, int)
        First and last frame of every unbroken stretch; between them it was hidden, or not found.
    frames : int
        Frames in which it owns pixels.
    mean_area : float
        px, over these.
    ending : Ending
    """

    layer: int
    kind: str
    spans: tuple[tuple[int, int], ...]
    frames: int
    mean_area: float
    ending: Ending


@dataclass(frozen=True, slots=True)
class StageTimes:
    """Wall time of one stage, ms: mean over the frames that had it, and per frame (0 without it)."""

    stage: str
    mean: float
    percentile_95: float
    by_frame: Array


@dataclass(frozen=True, slots=True)
class StreamHistory:
    """The history of a stream, as far as it is committed.

    Attributes
    ----------
    frames : (n,) int64
        Those with a label map.
    pts : (n,) float64
        s.
    objects : (n,) int32
        Objects in each of them.
    latency_frames : (n,) int32
    unusual : tuple of (str, tuple of int)
        By status, the frames with a label map that are no ordinary picture.
    lost : tuple of (str, tuple of int)
        By status, the frames without a label map.
    gaps : tuple of (float, float)
        Begin and end of each time without pictures, s.
    lives : tuple of LayerLife
        In ascending id, which is the order of their births.
    stages : tuple of StageTimes
    """

    frames: Array
    pts: Array
    objects: Array
    latency_frames: Array
    unusual: tuple[tuple[str, tuple[int, ...]], ...]
    lost: tuple[tuple[str, tuple[int, ...]], ...]
    gaps: tuple[tuple[float, float], ...]
    lives: tuple[LayerLife, ...]
    stages: tuple[StageTimes, ...]

    def objects_in(self, frame: int) -> list[int]:
        """Ids of the objects that are seen in a frame."""
        return [
            life.layer for life in self.lives if any(first <= frame <= last for first, last in life.spans)
        ]


def read_history(folder: Path) -> StreamHistory | None:
    """Read a stream's tables; None if they were not saved, or nothing is committed.

    Parameters
    ----------
    folder : Path
        Of the stream.
    """
    table = read_table(folder, "frames")
    if not table.num_rows:
        return None
    frames, status = table["frame"].to_numpy(), np.asarray(table["status"].to_pylist())
    ok = table["name"].is_valid().to_numpy()
    unusual, lost = (_by_status(frames[those], status[those]) for those in (ok & (status != "ok"), ~ok))
    pts = table["pts"].to_numpy()
    gaps = zip(
        pts[status == "gap"].tolist(), np.append(pts[1:], pts[-1])[status == "gap"].tolist(), strict=True
    )
    layers = read_table(folder, "layers", [*ENDING_COLUMNS, "kind"])
    shapes = np.stack([_numbers(table, side)[ok].astype(np.int64) for side in ("height", "width")], axis=1)
    return StreamHistory(
        frames=frames[ok],
        pts=pts[ok],
        objects=_numbers(table, "layers")[ok].astype(np.int32),
        latency_frames=_numbers(table, "latency_frames")[ok].astype(np.int32),
        unusual=unusual,
        lost=lost,
        gaps=tuple(gaps),
        lives=_lives(layers, frames[ok], shapes),
        stages=_stages(table.filter(pa.array(ok))),
    )


def _by_status(frames: Array, status: Array) -> tuple[tuple[str, tuple[int, ...]], ...]:
    return tuple((name, tuple(frames[status == name].tolist())) for name in np.unique(status).tolist())


def frame_ranges(frames: tuple[int, ...]) -> list[tuple[int, int]]:
    """List first and last of every run of consecutive frames, given in ascending order."""
    numbers = np.asarray(frames)
    breaks = np.flatnonzero(np.diff(numbers) > 1) + 1
    return [(int(run[0]), int(run[-1])) for run in np.split(numbers, breaks) if len(run)]


def _numbers(table: pa.Table, column: str) -> Array:
    """Return a column as float64, NaN for null."""
    numbers: Array = table[column].cast(pa.float64()).to_numpy()
    return numbers


def _lives(table: pa.Table, frames: Array, shapes: Array) -> tuple[LayerLife, ...]:
    if not table.num_rows:
        return ()
    layer, frame = table["layer"].to_numpy(), table["frame"].to_numpy()
    area, kind = table["area"].to_numpy(), np.asarray(table["kind"].to_pylist())
    order = np.lexsort((frame, layer))
    starts = np.flatnonzero(np.diff(layer[order], prepend=-1))
    lives = []
    for rows in np.split(order, starts[1:]):
        # Counted in frames with a label map: an undecodable frame does not hide an object.
        place = np.searchsorted(frames, frame[rows])
        pieces = np.split(frame[rows], np.flatnonzero(np.diff(place) > 1) + 1)
        spans = tuple((int(piece[0]), int(piece[-1])) for piece in pieces)
        first, last = int(rows[0]), int(rows[-1])
        how = ending(last, table, frames, shapes)
        lives.append(
            LayerLife(int(layer[first]), str(kind[first]), spans, len(rows), float(area[rows].mean()), how)
        )
    return tuple(lives)


def _stages(table: pa.Table) -> tuple[StageTimes, ...]:
    names = [name.removeprefix("ms_") for name in table.column_names if name.startswith("ms_")]
    names.sort(key=lambda name: _ORDER.index(name) if name in _ORDER else len(_ORDER))
    stages = []
    for name in names:
        times = _numbers(table, f"ms_{name}")
        known = times[~np.isnan(times)]
        if known.any():
            by_frame = np.nan_to_num(times)
            stages.append(StageTimes(name, float(known.mean()), float(np.percentile(known, 95)), by_frame))
    return tuple(stages)
