"""How much of the disk a run's streams take, by frame and by day."""

from __future__ import annotations

import os
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mlbs_actors.record.commits import read_commits
from mlbs_actors.record.record_tables import read_table
from orchestrator.clips.packet_ring import PACKETS
from orchestrator.events.file_names import CLIPS, PICTURES
from orchestrator.events.scene import VIEWS
from orchestrator.sinks.overlay import overlays
from orchestrator.storage.snapshot_folder import SNAPSHOTS

__all__ = ["KINDS", "StreamUse", "bytes_by_kind", "stream_use"]

#: What grows with the frames.
KINDS = ("masks", "tables", "overlay", "background", "cutouts", "lists")

#: Folders of a stream that do not, as their oldest files are deleted or their number is bounded.
_BOUNDED = (SNAPSHOTS, PICTURES, VIEWS, CLIPS, PACKETS)

_NEWEST_ROWS = 20_000  # by which sizes and rates are measured
_DAY_SECONDS = 86_400


@dataclass(frozen=True, slots=True)
class StreamUse:
    """What one stream takes.

    Attributes
    ----------
    width, height : int
        px.
    rate : float
        Label maps a second, without the times of gaps.
    per_frame : mapping of str to float
        Bytes a label map, by kind.
    """

    width: int
    height: int
    rate: float
    per_frame: dict[str, float]

    def per_day(self, rate: float | None = None) -> float:
        """Return the bytes of a day at a rate, by default its own."""
        return sum(self.per_frame.values()) * (self.rate if rate is None else rate) * _DAY_SECONDS


def bytes_by_kind(folder: Path) -> Counter[str]:
    """Return the bytes of the files of a stream's folder, or of a segment's, by kind."""
    found: Counter[str] = Counter()
    for place, _, files in os.walk(folder):
        part = next(iter(Path(place).relative_to(folder).parts), None)
        for name in files:
            try:
                stat = Path(place, name).stat()
            except FileNotFoundError:
                continue  # published or deleted just now
            size = stat.st_size // stat.st_nlink  # a clip of several events has several names
            found[part if part in KINDS or part in _BOUNDED else _kind(name.lstrip("."))] += size
    return found


def _kind(name: str) -> str:
    stem = name.partition(".")[0].partition("-")[0]
    if stem in ("frames", "layers"):
        return "tables"
    return stem if stem in KINDS else "lists"


def stream_use(folder: Path) -> StreamUse | None:
    """Measure what a stream takes; None if its tables were not saved, or nothing is committed.

    Parameters
    ----------
    folder : Path
        Of the stream.
    """
    commits = read_commits(folder)
    rows = commits[-1].last + 1 - commits[0].first if commits else 0
    table = read_table(folder, "frames", max(commits[-1].last - _NEWEST_ROWS, 0)) if rows else None
    if table is None or not table.num_rows:
        return None
    labelled = table["name"].is_valid().to_numpy()
    if labelled.sum() < 2:
        return None
    pts = table["pts"].to_numpy()
    steps = np.diff(pts)[table["status"].to_numpy(zero_copy_only=False)[:-1] != "gap"]
    label_maps = rows * labelled.mean()
    found = bytes_by_kind(folder)
    per_frame = {kind: float(found[kind] / label_maps) for kind in KINDS if found[kind]}
    if (videos := overlays(folder)) and (shown := commits[-1].last + 1 - videos[0][0]) > 0:
        # The first one may be lost, with a run that was killed.
        per_frame["overlay"] = found["overlay"] / min(label_maps, shown * float(labelled.mean()))
    newest = table.filter(table["name"].is_valid()).slice(int(labelled.sum()) - 1).to_pylist()[0]
    return StreamUse(
        width=newest["width"],
        height=newest["height"],
        rate=float(labelled.sum() / max(steps.sum(), 1e-9)),
        per_frame=per_frame,
    )
