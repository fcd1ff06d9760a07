"""The tables of the paper's evaluation (§8), with the figures of this program beside the published ones.

Published figures that are not known are left open (``-``), never estimated.

Differs from the paper: its overall means also cover five sequences of the Complex Background Data-set (drive,
forest, parking, store, traffic), which are left out here. Every mean over sequences, the published ones of
tables 1 and 2 too, is over the sequences that were run, so that both sides are judged on the same frames.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from orchestrator.evaluation.figures import format_number, format_table, mean_of_sequences
from orchestrator.evaluation.published_figures import (
    METHODS,
    MULTI_LABEL,
    SEQUENCES,
    STAGES,
    TIMED_SEQUENCE,
    PaperSequence,
    base_name,
    missing_sequences,
)
from orchestrator.evaluation.scoring import SequenceResult
from orchestrator.evaluation.sequence_scorer import RangeScore, SequenceScore

__all__ = [
    "Table",
    "moving_objects_table",
    "multi_label_table",
    "paper_tables",
    "time_table",
    "two_label_table",
]

OURS = "ours"

_RANGES: dict[str, Callable[[SequenceScore], RangeScore]] = {
    "first ten frames": lambda score: score.first_ten,
    "all frames": lambda score: score.all_frames,
}

#: A stage that the paper's total leaves out.
_FLOW = "flow"


@dataclass(frozen=True, slots=True)
class Table:
    """A table as text, with its notes below.

    Attributes
    ----------
    title : str
    headings : tuple of str
    rows : tuple of tuple of str
    notes : tuple of str
    """

    title: str
    headings: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    notes: tuple[str, ...] = ()

    def __str__(self) -> str:
        return "\n".join([self.title, "", format_table(self.headings, self.rows), *self.notes])


def paper_tables(results: Sequence[SequenceResult]) -> str:
    """Write all four tables, and which sequences are missing.

    Parameters
    ----------
    results : sequence of SequenceResult
        Of sequences of the paper, in any order.
    """
    tables = [
        two_label_table(results),
        moving_objects_table(results),
        multi_label_table(results),
        time_table(results),
    ]
    missing = missing_sequences([result.name for result in results])
    if missing:
        last = f"Sequences of the paper that are not there: {', '.join(missing)}."
    else:
        last = "All ten sequences are there."
    return "\n\n".join([*map(str, tables), last])


def two_label_table(results: Sequence[SequenceResult]) -> Table:
    """Make table 1: moving against not moving, sequence by sequence."""
    scores = _scores(results)
    rows = [
        (one.name, _percent(_two_label_f(scores, one)), *(_percent(f) for f in one.two_label_f))
        for one in SEQUENCES
    ]
    here = [one for one in SEQUENCES if one.name in scores]
    rows.append((f"mean of these {len(here)}", *_mean_row(scores, here)))
    if len(here) < len(SEQUENCES):
        rows.append((f"mean of all {len(SEQUENCES)}", "-", *_mean_row(scores, SEQUENCES)[1:]))
    return Table(
        "Table 1. Two-label F, %",
        ("sequence", OURS, *METHODS),
        tuple(rows),
        ("The paper's five sequences of the Complex Background Data-set are left out.",),
    )


def moving_objects_table(results: Sequence[SequenceResult]) -> Table:
    """Make table 2: the same by the number of objects that move at a time."""
    scores = _scores(results)
    rows = []
    for objects in sorted({one.moving_objects for one in SEQUENCES}):
        here = [one for one in SEQUENCES if one.moving_objects == objects and one.name in scores]
        names = ", ".join(one.name for one in here) or "-"
        rows.append((objects, *_mean_row(scores, here), names))
    return Table(
        "Table 2. Two-label F by the number of moving objects, %",
        ("objects", OURS, *METHODS, "sequences"),
        tuple(rows),
        ("Means over the sequences named, published figures too.",),
    )


def multi_label_table(results: Sequence[SequenceResult]) -> Table:
    """Make table 3: objects scored separately, in the first ten frames and in all."""
    scores = list(_scores(results).values())
    rows = []
    for frames, of_range in _RANGES.items():
        ranges = [of_range(score) for score in scores]
        ours = (
            (
                f"{OURS}, authors' code",
                mean_of_sequences(one.multi_precision_matlab for one in ranges),
                mean_of_sequences(one.multi_recall_matlab for one in ranges),
                mean_of_sequences(one.multi_f_matlab for one in ranges),
            ),
            (
                f"{OURS}, paper's text",
                mean_of_sequences(one.multi_precision for one in ranges),
                mean_of_sequences(one.multi_recall for one in ranges),
                mean_of_sequences(one.multi_f for one in ranges),
            ),
        )
        rows += [(frames, who, *(_percent(100 * value) for value in values)) for who, *values in ours]
        rows += [
            (frames, one.method, *(_percent(value) for value in (one.precision, one.recall, one.f)))
            for one in MULTI_LABEL
            if one.frames == frames
        ]
    return Table(
        "Table 3. Multi-label precision, recall and F, %",
        ("frames", "method", "P", "R", "F"),
        tuple(rows),
        (
            "Authors' code: counted as their published code does (multi_f_matlab), as published figures are.",
            "Paper's text: counted as it says (multi_f); a surplus layer counts as a lost object.",
            f"Ours: means over the {len(scores)} sequences here. Published: over all {len(SEQUENCES)}.",
            "A dash is a published figure that is not known here.",
        ),
    )


def time_table(results: Sequence[SequenceResult]) -> Table:
    """Make table 4: milliseconds a frame by the paper's stages.

    Stages of this program without a counterpart in the paper have rows of their own.
    """
    timed = [result for result in results if result.score is not None]
    stages = tuple(stage for one in STAGES for stage in one.stages)
    others = sorted({stage for result in timed for stage in result.stage_ms} - {*stages, _FLOW})
    lines = [(one.name, one.published_ms, one.stages) for one in STAGES]
    lines.append(("total", sum(one.published_ms for one in STAGES), stages))
    lines.append(("optical flow", math.nan, (_FLOW,)))
    lines += [(other, math.nan, (other,)) for other in others]
    rows = [
        (name, format_number(published), *_time_cells({r.name: _time_of(r, whose) for r in timed}))
        for name, published, whose in lines
    ]
    wall = {r.name: math.nan if r.ms_per_frame is None else r.ms_per_frame for r in timed}
    rows.append(("everything, in one process", "-", *_time_cells(wall)))
    homes = (
        f"{one.name} = {' + '.join(one.stages)}{f' ({one.remark})' if one.remark else ''}" for one in STAGES
    )
    return Table(
        "Table 4. Time of a frame, ms",
        ("stage", f"MLBS, {TIMED_SEQUENCE}", f"{OURS}, {TIMED_SEQUENCE}", f"{OURS}, mean"),
        tuple(rows),
        (
            "Stages of ours, by their names in a run's table of frames:",
            *(f"  {home}" for home in homes),
            "What layers do side by side counts once, for the slowest; in one process they do it in turn.",
            "The total leaves optical flow out, as the published one does.",
        ),
    )


def _time_cells(times: Mapping[str, float]) -> tuple[str, str]:
    """Return the time of the sequence that the paper timed, and the mean, of times by name."""
    published_for = (time for name, time in times.items() if base_name(name) == TIMED_SEQUENCE)
    return format_number(mean_of_sequences(published_for)), format_number(mean_of_sequences(times.values()))


def _scores(results: Sequence[SequenceResult]) -> dict[str, SequenceScore]:
    """Return scores by the paper's names, without failed sequences."""
    return {base_name(result.name): result.score for result in results if result.score is not None}


def _two_label_f(scores: Mapping[str, SequenceScore], sequence: PaperSequence) -> float:
    score = scores.get(sequence.name)
    return math.nan if score is None else 100 * score.all_frames.two_label_f


def _mean_row(scores: Mapping[str, SequenceScore], sequences: Sequence[PaperSequence]) -> tuple[str, ...]:
    """Average over some sequences: ours, then each method's."""
    ours = mean_of_sequences(_two_label_f(scores, one) for one in sequences)
    published = (
        mean_of_sequences(one.two_label_f[method] for one in sequences) for method in range(len(METHODS))
    )
    return (_percent(ours), *(_percent(mean) for mean in published))


def _time_of(result: SequenceResult, stages: Sequence[str]) -> float:
    """Sum the times of some stages, ms; NaN if the sequence has none of them."""
    known = [result.stage_ms[stage] for stage in stages if stage in result.stage_ms]
    return sum(known) if known else math.nan


def _percent(value: float) -> str:
    """Format two decimals, as the paper does; ``-`` for NaN."""
    return "-" if math.isnan(value) else f"{value:.2f}"
