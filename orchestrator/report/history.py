"""The history of a stream from its record: its frames, the lives of its layers, the time of each stage."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa

from mlbs_actors.messages import Array
from mlbs_actors.record.commits import read_commits
from mlbs_actors.record.edits import NO_EDITS, Edits
from mlbs_actors.record.frame_row import FrameRow
from mlbs_actors.record.record_tables import read_rows, read_table
from orchestrator.sinks.object_list import ObjectList, SeenObject

__all__ = ["LONG_SECONDS", "MOST_FRAMES", "StageTimes", "StreamHistory", "frame_ranges", "read_history"]

#: Objects that were seen for a shorter time are limbs, glimpses and errors for the most part, s.
LONG_SECONDS = 1.0

#: Most frames in the history of a camera: reading its weeks would take minutes. The newest ones count.
MOST_FRAMES = 50_000

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
class StageTimes:
    """Wall time of one stage, ms: mean over the frames that had it, and per frame (0 without it)."""

    stage: str
    mean: float
    percentile_95: float
    by_frame: Array


@dataclass(frozen=True, slots=True)
class StreamHistory:
    """The history of a stream, as far as it is committed; of a record in segments the newest frames of it.

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
    lives : tuple of SeenObject
        In ascending id, which is the order of their births.
    rests : mapping of int to list of (int, int)
        Id → first and last frame of each time in which that object rested.
    stages : tuple of StageTimes
    """

    frames: Array
    pts: Array
    objects: Array
    latency_frames: Array
    unusual: tuple[tuple[str, tuple[int, ...]], ...]
    lost: tuple[tuple[str, tuple[int, ...]], ...]
    gaps: tuple[tuple[float, float], ...]
    lives: tuple[SeenObject, ...]
    rests: Mapping[int, list[tuple[int, int]]]
    stages: tuple[StageTimes, ...]

    @property
    def long_lives(self) -> list[SeenObject]:
        """The objects that were seen for :data:`LONG_SECONDS` or longer."""
        return [life for life in self.lives if life.seconds >= LONG_SECONDS]

    def seconds_at(self, frame: int) -> float:
        """Return the time of a frame with a label map, s."""
        return float(self.pts[np.searchsorted(self.frames, frame)])

    def objects_in(self, frame: int) -> list[int]:
        """Ids of the objects that are seen in a frame."""
        return [
            life.layer for life in self.lives if any(first <= frame <= last for first, last in life.spans)
        ]


def read_history(folder: Path, edits: Edits = NO_EDITS) -> StreamHistory | None:
    """Read a stream's tables; None if they were not saved, or nothing is committed.

    Parameters
    ----------
    folder : Path
        Of the stream.
    edits : Edits
        Corrections of its ids.
    """
    commits = read_commits(folder)
    in_segments = bool(commits) and commits[-1].segment is not None
    begin = max(commits[-1].last + 1 - MOST_FRAMES, 0) if in_segments else 0
    table = read_table(folder, "frames", begin)
    if not table.num_rows:
        return None
    frames, status = table["frame"].to_numpy(), np.asarray(table["status"].to_pylist())
    ok = table["name"].is_valid().to_numpy()
    unusual, lost = (_by_status(frames[those], status[those]) for those in (ok & (status != "ok"), ~ok))
    pts = table["pts"].to_numpy()
    gaps = zip(
        pts[status == "gap"].tolist(), np.append(pts[1:], pts[-1])[status == "gap"].tolist(), strict=True
    )
    rests: dict[int, list[tuple[int, int]]] = {}
    counts: list[int] = []
    rows = _noting(edits.applied(read_rows(folder, begin)), rests, counts)
    lives = ObjectList().add(rows).objects
    return StreamHistory(
        frames=frames[ok],
        pts=pts[ok],
        objects=np.array(counts, np.int32),
        latency_frames=_numbers(table, "latency_frames")[ok].astype(np.int32),
        unusual=unusual,
        lost=lost,
        gaps=tuple(gaps),
        lives=tuple(lives),
        rests=rests,
        stages=_stages(table.filter(pa.array(ok))),
    )


def _noting(
    rows: Iterable[FrameRow], rests: dict[int, list[tuple[int, int]]], counts: list[int]
) -> Iterator[FrameRow]:
    """Pass rows on; note when objects rest, and the number of objects in each label map."""
    before = None  # the label map before
    for row in rows:
        for layer in row.result.layers if row.result else ():
            if layer.state == "resting":
                spans = rests.setdefault(layer.layer, [])
                if spans and spans[-1][1] == before:
                    spans[-1] = spans[-1][0], row.frame
                else:
                    spans.append((row.frame, row.frame))
        if row.result:
            before = row.frame
            counts.append(len(row.result.layers))
        yield row


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
