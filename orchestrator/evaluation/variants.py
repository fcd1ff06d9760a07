"""Variants of the engine or of its input, compared on the same sequences.

All variants share one pool of processes, so a core that is done with one variant takes work of the next.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from multiprocessing import get_context
from typing import Any

from orchestrator.evaluation.figures import (
    COLUMNS,
    format_number,
    format_table,
    mean_of_sequences,
    null_if_unknown,
    results_as_json,
)
from orchestrator.evaluation.scoring import EngineSetup, SequenceResult, engine_result
from orchestrator.evaluation.sequences import SequenceChange

__all__ = ["Variant", "VariantResults", "run_variants", "variants_as_json", "variants_table"]

_Call = tuple[str, EngineSetup, tuple[str, ...], SequenceChange | None, int | None]


@dataclass(frozen=True, slots=True)
class Variant:
    """The engine with some parameters, on sequences that may be changed first.

    Attributes
    ----------
    name : str
        Name of its row in the table; empty if there is only one variant.
    overrides : tuple of str
        ``section.key=value``, later ones win.
    change : SequenceChange or None
        Change to every sequence.
    longer_side : int or None
        Of the pictures that the engine is given, px; None: as they are.
    """

    name: str
    overrides: tuple[str, ...] = ()
    change: SequenceChange | None = None
    longer_side: int | None = None


@dataclass(frozen=True, slots=True)
class VariantResults:
    """The outcome of one variant: a result for each sequence, in the order asked for."""

    variant: Variant
    results: tuple[SequenceResult, ...]

    @property
    def failed(self) -> bool:
        """Whether some sequence could not be scored."""
        return any(result.score is None for result in self.results)

    def mean(self, heading: str) -> float:
        """Average a column over the sequences; NaN if one failed, as other sequences would be compared."""
        return math.nan if self.failed else mean_of_sequences(_value(r, heading) for r in self.results)


def run_variants(
    variants: Sequence[Variant],
    sequences: Sequence[str],
    setup: EngineSetup,
    jobs: int,
    prepare: Callable[[], None] | None = None,
) -> list[VariantResults]:
    """Run and score every variant on every sequence; report progress on stderr.

    Parameters
    ----------
    variants : sequence of Variant
    sequences : sequence of str
        Names, as for :func:`orchestrator.evaluation.datasets.open_sequence`.
    setup : EngineSetup
        The folder of contact sheets is for a single variant, as they are named after the sequences only.
    jobs : int
        Processes at the same time; 1: all in this process.
    prepare : callable or None
        Called once in each process before its first run; a function of a module.

    Returns
    -------
    list of VariantResults
        In the order of the variants.
    """
    calls: list[_Call] = [
        (name, setup, variant.overrides, variant.change, variant.longer_side)
        for variant in variants
        for name in sequences
    ]
    results: dict[int, SequenceResult] = {}
    for place, result in _as_they_end(calls, jobs, prepare):
        results[place] = result
        variant = variants[place // len(sequences)]
        what = f"{variant.name}, {result.name}" if variant.name else result.name
        outcome = "failed" if result.error else "done"
        print(f"{len(results)} of {len(calls)}: {what}: {outcome}", file=sys.stderr, flush=True)
    in_order = iter([results[place] for place in range(len(calls))])
    return [VariantResults(variant, tuple(next(in_order) for _ in sequences)) for variant in variants]


def _as_they_end(
    calls: Sequence[_Call], jobs: int, prepare: Callable[[], None] | None
) -> Iterator[tuple[int, SequenceResult]]:
    """Yield each call's index and result, in the order in which they end."""
    if jobs == 1 or len(calls) == 1:
        if prepare is not None:
            prepare()
        for place, call in enumerate(calls):
            yield place, engine_result(*call)
        return
    # Fresh processes: an engine's threads and compiled functions do not survive a fork.
    workers = min(jobs, len(calls))
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn"), initializer=prepare) as pool:
        places = {pool.submit(engine_result, *call): place for place, call in enumerate(calls)}
        for future in as_completed(places):
            yield places[future], future.result()


def variants_table(rows: Sequence[VariantResults], heading: str, means: Sequence[str]) -> str:
    """Format one row per variant: means of these columns, then two_label_f of each sequence.

    Parameters
    ----------
    rows : sequence of VariantResults
        All of the same sequences, at least one.
    heading : str
        Of the column of names.
    means : sequence of str
        Headings of :data:`orchestrator.evaluation.figures.COLUMNS`.
    """
    names = [result.name for result in rows[0].results]
    lines = [
        [
            row.variant.name,
            *(format_number(row.mean(column)) for column in means),
            *(format_number(_value(result, "two_label_f")) for result in row.results),
        ]
        for row in rows
    ]
    return format_table([heading, *means, *names], lines)


def variants_as_json(rows: Sequence[VariantResults]) -> dict[str, Any]:
    """Return all figures of all variants in JSON types."""
    return {
        "rows": [
            {
                "name": row.variant.name,
                "overrides": list(row.variant.overrides),
                **results_as_json(row.results),
                "mean": {heading: null_if_unknown(row.mean(heading)) for heading in COLUMNS},
            }
            for row in rows
        ]
    }


def _value(result: SequenceResult, heading: str) -> float:
    return math.nan if result.score is None else COLUMNS[heading](result, result.score)
