"""The rows of ``counts.csv``: an hour of the whole picture, of a zone, or of a line."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable
from datetime import datetime, timezone

from mlbs_actors.extras import needing
from orchestrator.counts.tally import HOUR_SECONDS, HourCounts, PlaceCounts

with needing("read"):
    import pyarrow as pa
    from pyarrow import csv as arrow_csv

__all__ = ["HEADER", "counts_schema", "csv_rows", "table_of"]


def counts_schema() -> pa.Schema:
    """Return the columns of the table."""
    return pa.schema(
        [
            ("stream", pa.string()),
            ("hour", pa.int64()),
            ("begins", pa.timestamp("s", tz="UTC")),
            ("local", pa.string()),
            ("place", pa.string()),
            ("kind", pa.string()),
            *((name, pa.int64()) for name in ("born", "entered", "left", "crossed_left", "crossed_right")),
            ("mean_objects", pa.float64()),
            ("most_objects", pa.int64()),
            ("occupied_s", pa.float64()),
            ("seconds", pa.float64()),
            ("frames", pa.int64()),
            ("label_maps", pa.int64()),
            ("dropped_share", pa.float64()),
            ("dropped_share_around", pa.float64()),
        ]
    )


#: First line of the file.
HEADER = ",".join(counts_schema().names) + "\n"


def csv_rows(stream: str, hours: Iterable[HourCounts]) -> str:
    """Return the lines of some hours: of each the whole picture, then the other places by name."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    for hour in hours:
        for name, place in sorted(hour.places.items()):
            writer.writerow(
                [stream, *_when(hour), name, place.kind, *_counted(place), *_observed(hour, place)]
            )
    return text.getvalue()


def table_of(content: bytes) -> pa.Table:
    """Read what :data:`HEADER` and :func:`csv_rows` have written."""
    options = arrow_csv.ConvertOptions(column_types=counts_schema())
    return arrow_csv.read_csv(
        io.BytesIO(content),
        read_options=arrow_csv.ReadOptions(use_threads=False),
        parse_options=arrow_csv.ParseOptions(newlines_in_values=True),
        convert_options=options,
    )


def _when(hour: HourCounts) -> tuple[int | None, str | None, str | None]:
    if not hour.by_clock:
        return hour.hour, None, None
    begins = datetime.fromtimestamp(hour.hour * HOUR_SECONDS, timezone.utc)
    return None, begins.strftime("%Y-%m-%dT%H:%M:%SZ"), begins.astimezone().isoformat()


def _counted(place: PlaceCounts) -> tuple[int | None, ...]:
    born = place.born if place.kind == "picture" else None
    inside = (place.entered, place.left) if place.kind == "zone" else (None, None)
    crossed = (place.crossed_left, place.crossed_right) if place.kind == "line" else (None, None)
    return (born, *inside, *crossed)


def _observed(hour: HourCounts, place: PlaceCounts) -> tuple[float | None, ...]:
    there: tuple[float | None, ...] = (None, None, None)
    if place.kind != "line":
        mean = place.object_seconds / hour.seconds if hour.seconds else 0.0
        there = (round(mean, 3), place.most, round(place.occupied_seconds, 3))
    counted = place.born + place.entered + place.left + place.crossed_left + place.crossed_right
    return (
        *there,
        round(hour.seconds, 3),
        hour.frames,
        hour.label_maps,
        round(1 - hour.label_maps / hour.frames, 4) if hour.frames else 0.0,
        round(place.dropped_shares / counted, 4) if counted else None,
    )
