"""The figures of sequences by name: the columns of the tables, their means, text and JSON types."""

from __future__ import annotations

import itertools
import math
import statistics
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict
from typing import Any

from orchestrator.evaluation.scoring import SequenceResult
from orchestrator.evaluation.sequence_scorer import SequenceScore
from orchestrator.evaluation.track_metrics import TrackScore

__all__ = [
    "COLUMNS",
    "TABLES",
    "format_number",
    "format_table",
    "mean_of_objects",
    "mean_of_sequences",
    "median_delay",
    "null_if_unknown",
    "results_as_json",
]

#: Heading of a column, and the function that computes its value.
Column = tuple[str, Callable[[SequenceResult, SequenceScore], float]]

_FIGURES: tuple[Column, ...] = (
    ("two_label_f", lambda result, score: 100 * score.all_frames.two_label_f),
    ("j", lambda result, score: 100 * score.all_frames.j),
    ("f", lambda result, score: 100 * score.all_frames.f),
    ("j&f", lambda result, score: 100 * score.all_frames.j_and_f),
    ("object_f", lambda result, score: 100 * score.all_frames.object_f),
    ("track_j", lambda result, score: 100 * score.track_j),
    ("multi_f", lambda result, score: 100 * score.all_frames.multi_f),
    ("multi_f_matlab", lambda result, score: 100 * score.all_frames.multi_f_matlab),
    ("extra", lambda result, score: score.extra_layers),
    ("false", lambda result, score: 100 * score.all_frames.false_area),
    ("ids_on", lambda result, score: score.ids_on),
    ("shared", lambda result, score: 100 * score.shared_ids),
    ("switches", lambda result, score: float(score.id_switches)),
    ("delay", lambda result, score: median_delay(score)),
    ("frames", lambda result, score: float(score.frames)),
    ("ms", lambda result, score: math.nan if result.ms_per_frame is None else result.ms_per_frame),
    (
        "cpu_ms",
        lambda result, score: math.nan if result.cpu_ms_per_frame is None else result.cpu_ms_per_frame,
    ),
)
_RANGES: tuple[Column, ...] = (
    ("precision", lambda result, score: 100 * score.all_frames.precision),
    ("recall", lambda result, score: 100 * score.all_frames.recall),
    ("f first ten", lambda result, score: 100 * score.first_ten.two_label_f),
    ("f after start", lambda result, score: 100 * score.after_start.two_label_f),
    ("object_f first ten", lambda result, score: 100 * score.first_ten.object_f),
    ("object_f after start", lambda result, score: 100 * score.after_start.object_f),
)
_DAVIS: tuple[Column, ...] = (
    ("j davis", lambda result, score: 100 * score.davis.j),
    ("j recall davis", lambda result, score: 100 * score.davis.j_recall),
    ("j decay davis", lambda result, score: 100 * score.davis.j_decay),
    ("f davis", lambda result, score: 100 * score.davis.f),
    ("f recall davis", lambda result, score: 100 * score.davis.f_recall),
    ("f decay davis", lambda result, score: 100 * score.davis.f_decay),
    ("j&f davis", lambda result, score: 100 * score.davis.j_and_f),
)


def _davis17(figures: Callable[[TrackScore], float]) -> Callable[[SequenceResult, SequenceScore], float]:
    """Return the column of a figure of the objects: its mean over them, percent."""
    return lambda result, score: 100 * mean_of_sequences(map(figures, score.davis_tracks))


#: Figures of DAVIS 2017's unsupervised task, of one object.
_TRACK_FIGURES: Mapping[str, Callable[[TrackScore], float]] = {
    "j": lambda track: track.j.mean,
    "j recall": lambda track: track.j.recall,
    "j decay": lambda track: track.j.decay,
    "f": lambda track: track.f.mean,
    "f recall": lambda track: track.f.recall,
    "f decay": lambda track: track.f.decay,
    "j&f": lambda track: track.j_and_f,
}
_DAVIS17: tuple[Column, ...] = (
    ("objects", lambda result, score: float(len(score.davis_tracks))),
    *((f"{heading} davis17", _davis17(figure)) for heading, figure in _TRACK_FIGURES.items()),
)

#: The tables of a report, in order.
TABLES = (_FIGURES, _RANGES, _DAVIS, _DAVIS17)

#: All columns by heading.
COLUMNS = dict(itertools.chain(*TABLES))


def median_delay(score: SequenceScore) -> float:
    """Return the median entry delay, frames; infinite if half are never found, NaN if none enter."""
    delays = [math.inf if delay is None else float(delay) for delay in score.entry_delay.values()]
    return statistics.median(delays) if delays else math.nan


def mean_of_sequences(values: Iterable[float]) -> float:
    """Return the unweighted mean of the known values; NaN if there are none."""
    known = [value for value in values if not math.isnan(value)]
    return sum(known) / len(known) if known else math.nan


def mean_of_objects(results: Iterable[SequenceResult]) -> dict[str, float]:
    """Average over all objects of all sequences, as DAVIS 2017 does, percent: ``j``, ``j recall``, …."""
    tracks = [one for result in results if result.score is not None for one in result.score.davis_tracks]
    means = {name: 100 * mean_of_sequences(map(figure, tracks)) for name, figure in _TRACK_FIGURES.items()}
    return {"objects": len(tracks), **means}


def format_table(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Format plain text columns: the first left-aligned, the others right-aligned."""
    widths = [max(len(row[column]) for row in [headings, *rows]) for column in range(len(headings))]
    return "\n".join(
        "  ".join([row[0].ljust(widths[0]), *(c.rjust(w) for c, w in zip(row[1:], widths[1:], strict=True))])
        for row in [headings, *rows]
    )


def format_number(value: float) -> str:
    """Format with one decimal at most; ``-`` for NaN, ``never`` for infinity."""
    if math.isnan(value):
        return "-"
    return "never" if math.isinf(value) else f"{round(value, 1):g}"


def results_as_json(results: Sequence[SequenceResult]) -> dict[str, Any]:
    """Return all figures of all sequences, and their means, in JSON types."""
    sequences = {result.name: _result_as_json(result) for result in results}
    scored = [(result, result.score) for result in results if result.score is not None]
    means = {
        heading: null_if_unknown(mean_of_sequences(value(result, score) for result, score in scored))
        for heading, value in COLUMNS.items()
    }
    objects = {heading: null_if_unknown(mean) for heading, mean in mean_of_objects(results).items()}
    return {"sequences": sequences, "mean": means, "davis17": objects}


def _result_as_json(result: SequenceResult) -> dict[str, Any]:
    record = asdict(result)
    if result.score is not None:
        for extra in record["score"]["extras"]:
            del extra["mask"]  # a picture, shown on the sheet
        del record["stems"], record["masks"], record["score"]["per_frame"]  # for other files and tables
        record["score"]["entry_delay"] = {str(k): v for k, v in result.score.entry_delay.items()}
    cleaned = null_if_unknown(record)
    assert isinstance(cleaned, dict)
    return cleaned


def null_if_unknown(value: Any) -> Any:
    """Replace NaN and infinity, which JSON does not have, by None."""
    if isinstance(value, dict):
        return {key: null_if_unknown(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [null_if_unknown(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
