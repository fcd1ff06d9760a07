"""CSV: one table of all streams, a row for each frame and object."""

from __future__ import annotations

import csv
from pathlib import Path

from mlbs_actors.record.recorded_stream import recorded_stream, streams_of

__all__ = ["write_csv"]

_COLUMNS = (
    *("stream", "frame", "seconds", "id", "kind", "state"),
    *("x", "y", "w", "h", "area", "cx", "cy", "vx", "vy", "confidence", "score"),
)


def write_csv(run: Path, out: Path) -> None:
    """Write the columns of the tables that people read, with the time of the frame in seconds.

    Parameters
    ----------
    run : Path
    out : Path
        The CSV file.
    """
    with out.open("w", encoding="utf-8", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(_COLUMNS)
        for name in streams_of(run):
            for frame in recorded_stream(run / name):
                for one in frame.objects:
                    measured = (*one.centroid, *one.velocity, one.confidence, one.score)
                    table.writerow(
                        [
                            *(name, frame.index, round(frame.pts, 6), one.layer, one.kind, one.state),
                            *(*one.region.box, one.area, *(round(value, 2) for value in measured)),
                        ]
                    )
