"""Methods side by side on the same sequences: their figures, and their differences from the first method.

A mean difference is given with a 95 % interval: that of the means of sequences drawn at random, with
replacement, from those there are (the percentile bootstrap; always the same draws). It says how much the
choice of sequences matters, not how much one run of a method does. Of fewer than about eight sequences it is
too narrow; in how many sequences a figure is higher says something of those few, too.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from orchestrator.evaluation.figures import COLUMNS, mean_of_sequences, null_if_unknown
from orchestrator.evaluation.variants import VariantResults, variants_as_json

__all__ = [
    "ComparisonTable",
    "Difference",
    "compared",
    "comparison_as_json",
    "comparison_text",
    "difference_of",
    "figures_by_sequence",
]

_DRAWS = 10_000
_OUTSIDE = 2.5  # percent on either side of the interval
_FEW = 8  # sequences below which the interval is too narrow to rely on


@dataclass(frozen=True, slots=True)
class Difference:
    """How a figure of one method differs from that of another, over the sequences that both have.

    Attributes
    ----------
    mean, low, high : float
        Mean difference and its 95 % interval, in the figure's unit; NaN without sequences, the interval of
        one sequence as well.
    higher, sequences : int
        In how many sequences the figure is higher, and of how many.
    """

    mean: float
    low: float
    high: float
    higher: int
    sequences: int


@dataclass(frozen=True, slots=True)
class ComparisonTable:
    """A table with a group of columns for each method.

    Attributes
    ----------
    groups : tuple of (str, tuple of str)
        Method, and the headings of its columns.
    rows : tuple of (str, tuple of str)
        Sequence, and a cell for each column of all groups.
    closing : tuple of (str, tuple of str)
        The same of what is said of all sequences: means, intervals, counts.
    """

    groups: tuple[tuple[str, tuple[str, ...]], ...]
    rows: tuple[tuple[str, tuple[str, ...]], ...]
    closing: tuple[tuple[str, tuple[str, ...]], ...]


def figures_by_sequence(row: VariantResults, column: str) -> dict[str, float]:
    """Return a figure of each sequence that could be scored, where it is known and finite."""
    values = {
        result.name: COLUMNS[column](result, result.score)
        for result in row.results
        if result.score is not None
    }
    return {name: value for name, value in values.items() if math.isfinite(value)}


def difference_of(figures: Mapping[str, float], reference: Mapping[str, float]) -> Difference:
    """Compare a figure of two methods.

    Parameters
    ----------
    figures, reference : mapping of str to float
        Sequence → figure; sequences that only one of them has do not count.
    """
    differences = np.array([value - reference[name] for name, value in figures.items() if name in reference])
    count = len(differences)
    if not count:
        return Difference(math.nan, math.nan, math.nan, 0, 0)
    low = high = math.nan
    if count > 1:
        drawn = np.random.default_rng(0).integers(count, size=(_DRAWS, count))
        low, high = np.percentile(differences[drawn].mean(axis=1), [_OUTSIDE, 100 - _OUTSIDE]).tolist()
    return Difference(float(differences.mean()), low, high, int((differences > 0).sum()), count)


def compared(methods: Sequence[VariantResults], columns: Sequence[str]) -> ComparisonTable:
    """Lay methods side by side.

    Parameters
    ----------
    methods : sequence of VariantResults
        Of the same sequences; differences are to the first. Means are over the sequences of all of them.
    columns : sequence of str
        Headings of :data:`orchestrator.evaluation.figures.COLUMNS`.
    """
    names = [result.name for result in methods[0].results]
    blocks = [_Block.of(methods[0], method, column, methods) for method in methods for column in columns]
    groups = tuple(
        (
            method.variant.name,
            tuple(heading for column in columns for heading in ((column,) if place == 0 else (column, "Δ"))),
        )
        for place, method in enumerate(methods)
    )
    common = sum(
        all(method.results[row].score is not None for method in methods) for row in range(len(names))
    )
    closing = [(f"mean of {common}", _joined(block.mean() for block in blocks))]
    if len(methods) > 1:
        closing.append(("95 % interval", _joined(block.interval() for block in blocks)))
        closing.append(("higher in", _joined(block.higher() for block in blocks)))
    rows = tuple((name, _joined(block.row(name) for block in blocks)) for name in names)
    return ComparisonTable(groups, rows, tuple(closing))


@dataclass(frozen=True, slots=True)
class _Block:
    """One figure of one method: its column, and the one of differences unless it is the first method."""

    figures: Mapping[str, float]
    reference: Mapping[str, float] | None
    common: frozenset[str]

    @classmethod
    def of(
        cls, first: VariantResults, method: VariantResults, column: str, methods: Sequence[VariantResults]
    ) -> _Block:
        known = [figures_by_sequence(one, column).keys() for one in methods]
        return cls(
            figures_by_sequence(method, column),
            None if method is first else figures_by_sequence(first, column),
            frozenset(known[0]).intersection(*known[1:]),
        )

    def row(self, sequence: str) -> tuple[str, ...]:
        value = self.figures.get(sequence, math.nan)
        if self.reference is None:
            return (_plain(value),)
        return _plain(value), _signed(value - self.reference.get(sequence, math.nan))

    def mean(self) -> tuple[str, ...]:
        mean = mean_of_sequences(self.figures[name] for name in self.common)
        if self.reference is None:
            return (_plain(mean),)
        return _plain(mean), _signed(self._difference().mean)

    def interval(self) -> tuple[str, ...]:
        if self.reference is None:
            return ("",)
        one = self._difference()
        return "", "" if math.isnan(one.low) else f"{_signed(one.low)} … {_signed(one.high)}"

    def higher(self) -> tuple[str, ...]:
        if self.reference is None:
            return ("",)
        one = self._difference()
        return "", f"{one.higher} of {one.sequences}"

    def _difference(self) -> Difference:
        assert self.reference is not None
        figures = {name: value for name, value in self.figures.items() if name in self.common}
        return difference_of(figures, self.reference)


def _joined(cells: Iterable[tuple[str, ...]]) -> tuple[str, ...]:
    return tuple(cell for block in cells for cell in block)


def _plain(value: float) -> str:
    return f"{value:.1f}" if math.isfinite(value) else "-"


def _signed(value: float) -> str:
    return f"{value:+.1f}" if math.isfinite(value) else "-"


def comparison_text(table: ComparisonTable) -> str:
    """Write a table as text, the names of the methods above their columns."""
    headings = ("sequence", *(heading for _, group in table.groups for heading in group))
    lines = [headings, *((name, *cells) for name, cells in (*table.rows, *table.closing))]
    widths = [max(len(line[column]) for line in lines) for column in range(len(headings))]
    above, column = [" " * widths[0]], 1
    for name, group in table.groups:
        width = sum(widths[column : column + len(group)]) + 2 * (len(group) - 1)
        widths[column] += max(len(name) - width, 0)  # a name longer than its columns
        above.append(name.ljust(max(width, len(name))))
        column += len(group)
    written = [
        "  ".join(
            [line[0].ljust(widths[0]), *(cell.rjust(w) for cell, w in zip(line[1:], widths[1:], strict=True))]
        )
        for line in lines
    ]
    text = "\n".join(line.rstrip() for line in ("  ".join(above), *written))
    if len(table.groups) > 1 and len(table.rows) < _FEW:
        text += f"\nOf fewer than {_FEW} sequences the interval is too narrow to rely on."
    return text


def comparison_as_json(methods: Sequence[VariantResults]) -> dict[str, Any]:
    """Return all figures of all methods, and their differences from the first, in JSON types."""
    first = {column: figures_by_sequence(methods[0], column) for column in COLUMNS}
    differences = {}
    for method in methods[1:]:
        own = {column: figures_by_sequence(method, column) for column in COLUMNS}
        differences[method.variant.name] = {
            column: _as_json(own[column], first[column]) for column in COLUMNS
        }
    return {**variants_as_json(methods), "differences": differences}


def _as_json(figures: Mapping[str, float], reference: Mapping[str, float]) -> Any:
    one = difference_of(figures, reference)
    return null_if_unknown(
        {
            "mean": one.mean,
            "interval": [one.low, one.high],
            "higher": one.higher,
            "sequences": {
                name: value - reference[name] for name, value in figures.items() if name in reference
            },
        }
    )
