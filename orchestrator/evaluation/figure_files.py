"""Files of figures: all of them as JSON, frame by frame as CSV, and a table for a paper as LaTeX."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from mlbs_actors.errors import ConfigError
from orchestrator.evaluation.figures import COLUMNS, mean_of_sequences, null_if_unknown
from orchestrator.evaluation.scoring import SequenceResult

__all__ = ["write_csv", "write_json", "write_latex"]

_MATH = {"j": r"$\mathcal{J}$", "f": r"$\mathcal{F}$", "j&f": r"$\mathcal{J}\&\mathcal{F}$"}
_ESCAPED = str.maketrans({character: f"\\{character}" for character in "_&%#$"})


def write_json(path: Path, figures: Any) -> None:
    """Write figures as JSON.

    Raises
    ------
    ConfigError
        If the file cannot be written.
    """
    _write(path, json.dumps(null_if_unknown(figures), indent=1, allow_nan=False) + "\n")


def write_csv(path: Path, results: Sequence[SequenceResult]) -> None:
    """Write a row for each frame with truth: figures in percent, the labels, and which fits which object.

    Raises
    ------
    ConfigError
        If the file cannot be written.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["sequence", "frame", "j", "f", "two_label_f", "object_f", "ids", "matches"])
    for result in results:
        for frame in result.score.per_frame if result.score is not None else ():
            figures = (frame.j, frame.f, frame.two_label_f, frame.object_f)
            matches = (f"{truth}:{'-' if label is None else label}" for truth, label in frame.matches.items())
            writer.writerow(
                [
                    result.name,
                    result.stems[frame.index],
                    *("" if math.isnan(value) else f"{100 * value:.2f}" for value in figures),
                    " ".join(map(str, frame.labels)),
                    " ".join(matches),
                ]
            )
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
