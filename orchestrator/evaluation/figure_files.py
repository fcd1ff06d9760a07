"""Files of figures: JSON, CSV frame by frame or by sequence, and tables for a paper as LaTeX.

Where there are several methods or variants, CSV files begin with the column ``method``.
"""

from __future__ import annotations

import csv
import io
import itertools
import json
import math
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

from mlbs_actors.errors import ConfigError
from orchestrator.evaluation.comparison import ComparisonTable
from orchestrator.evaluation.figures import COLUMNS, mean_of_sequences, null_if_unknown
from orchestrator.evaluation.scoring import SequenceResult
from orchestrator.evaluation.sequence_scorer import FrameScore, SequenceScore
from orchestrator.evaluation.variants import VariantResults

__all__ = ["write_comparison_latex", "write_csv", "write_json", "write_latex", "write_summary"]

_MATH = {"Δ": r"$\Delta$", "j": r"$\mathcal{J}$", "f": r"$\mathcal{F}$", "j&f": r"$\mathcal{J}\&\mathcal{F}$"}
_ESCAPED = str.maketrans({character: f"\\{character}" for character in "_&%#$"})


def write_json(path: Path, figures: Any) -> None:
    """Write figures as JSON.

    Raises
    ------
    ConfigError
        If the file cannot be written.
    """
    _write(path, json.dumps(null_if_unknown(figures), indent=1, allow_nan=False) + "\n")


def write_csv(path: Path, rows: Sequence[VariantResults]) -> None:
    """Write a row for each frame with truth: figures in percent, the labels, and which fits which object.

    Raises
    ------
    ConfigError
        If the file cannot be written.
    """
    headings = ["sequence", "frame", "j", "f", "two_label_f", "object_f", "ids", "matches"]
    _write_rows(
        path, headings, rows, lambda result, score: (_frame_row(result, frame) for frame in score.per_frame)
    )


def _frame_row(result: SequenceResult, frame: FrameScore) -> list[str]:
    figures = (frame.j, frame.f, frame.two_label_f, frame.object_f)
    matches = (f"{truth}:{'-' if label is None else label}" for truth, label in frame.matches.items())
    return [
        result.name,
        result.stems[frame.index],
        *("" if math.isnan(value) else f"{100 * value:.2f}" for value in figures),
        " ".join(map(str, frame.labels)),
        " ".join(matches),
    ]


def write_summary(path: Path, rows: Sequence[VariantResults]) -> None:
    """Write a row for each sequence, with all columns of the tables.

    Raises
    ------
    ConfigError
        If the file cannot be written.
    """

    def row(result: SequenceResult, score: SequenceScore) -> list[list[str]]:
        values = (value(result, score) for value in COLUMNS.values())
        return [[result.name, *("" if math.isnan(value) else f"{value:.3f}" for value in values)]]

    _write_rows(path, ["sequence", *COLUMNS], rows, row)


def _write_rows(
    path: Path,
    headings: Sequence[str],
    rows: Sequence[VariantResults],
    cells: Callable[[SequenceResult, SequenceScore], Iterable[Sequence[str]]],
) -> None:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    named = any(row.variant.name for row in rows)
    writer.writerow(["method", *headings] if named else headings)
    for row in rows:
        for result in row.results:
            for line in cells(result, result.score) if result.score is not None else ():
                writer.writerow([row.variant.name, *line] if named else line)
    _write(path, text.getvalue())


def write_latex(path: Path, results: Sequence[SequenceResult], columns: Sequence[str]) -> None:
    """Write a table of sequences and their mean, for the package booktabs.

    Parameters
    ----------
    path : Path
    results : sequence of SequenceResult
    columns : sequence of str
        Headings of :data:`orchestrator.evaluation.figures.COLUMNS`.

    Raises
    ------
    ConfigError
        If the file cannot be written.
    """
    scored = [(result, result.score) for result in results if result.score is not None]
    values = [[COLUMNS[heading](result, score) for heading in columns] for result, score in scored]
    lines = [
        r"% \usepackage{booktabs}",
        rf"\begin{{tabular}}{{l{'r' * len(columns)}}}",
        r"\toprule",
        _row("sequence", [_heading(heading) for heading in columns]),
        r"\midrule",
        *(_row(result.name, map(_number, row)) for (result, _), row in zip(scored, values, strict=True)),
    ]
    if len(values) > 1:
        means = (mean_of_sequences(column) for column in zip(*values, strict=True))
        lines += [r"\midrule", _row("mean", map(_number, means))]
    _write(path, "\n".join([*lines, r"\bottomrule", r"\end{tabular}"]) + "\n")


def write_comparison_latex(path: Path, table: ComparisonTable) -> None:
    """Write methods side by side, for the package booktabs.

    Raises
    ------
    ConfigError
        If the file cannot be written.
    """
    widths = [len(headings) for _, headings in table.groups]
    methods = [
        rf"\multicolumn{{{width}}}{{c}}{{{name.translate(_ESCAPED)}}}"
        for (name, _), width in zip(table.groups, widths, strict=True)
    ]
    ends = list(itertools.accumulate(widths, initial=1))
    rules = [rf"\cmidrule(lr){{{first + 1}-{last}}}" for first, last in itertools.pairwise(ends)]
    headings = [_heading(heading) for _, group in table.groups for heading in group]
    lines = [
        r"% \usepackage{booktabs}",
        rf"\begin{{tabular}}{{l{'r' * sum(widths)}}}",
        r"\toprule",
        _row("", methods),
        "".join(rules),
        _row("sequence", headings),
        r"\midrule",
        *(_row(name, map(_cell, cells)) for name, cells in table.rows),
        r"\midrule",
        *(_row(name, map(_cell, cells)) for name, cells in table.closing),
        r"\bottomrule",
        r"\end{tabular}",
    ]
    _write(path, "\n".join(lines) + "\n")


def _cell(text: str) -> str:
    """Write a cell of a table of text with LaTeX's dashes and signs."""
    if text == "-":
        return "--"
    return " ".join(f"${word}$" if word[0] in "+-" else word for word in text.split()).replace("…", r"\dots")


def _row(name: str, cells: Iterable[str]) -> str:
    return " & ".join([name.translate(_ESCAPED), *cells]) + r" \\"


def _heading(heading: str) -> str:
    """Write a heading such as ``j davis`` with symbols of mathematics."""
    return " ".join(_MATH.get(word, word.translate(_ESCAPED)) for word in heading.split(" "))


def _number(value: float) -> str:
    return f"{value:.1f}" if math.isfinite(value) else "--"


def _write(path: Path, text: str) -> None:
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"The figures cannot be written: {error}.") from error
