"""Plots of figures, as PNG for looking and PDF for papers; drawn by matplotlib, which only this needs."""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING

from mlbs_actors.errors import ConfigError
from orchestrator.evaluation.precision_recall import precision_recall
from orchestrator.evaluation.variants import VariantResults

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["write_plots"]

_SUFFIXES = (".png", ".pdf")

#: Styles of lines, so that they can be told apart without their colours.
_LINES = ("-", "--", "-.", ":")


def write_plots(folder: Path, rows: Sequence[VariantResults]) -> list[Path]:
    """Draw figures over time for each sequence, and precision over recall if scores are known.

    Parameters
    ----------
    folder : Path
        Gets ``NAME-over-time`` and ``precision-recall``, each as PNG and PDF.
    rows : sequence of VariantResults
        Of the same sequences: a line each.

    Returns
    -------
    list of Path
        The files.

    Raises
    ------
    ConfigError
        If they cannot be written.
    """
    figures = {}
    for place, result in enumerate(rows[0].results):
        if any(row.results[place].score is not None for row in rows):
            stem = re.sub(r"[^\w.-]", "-", result.name)
            figures[f"{stem}-over-time"] = _over_time(result.name, place, rows)
    if any(precision_recall(row.results) is not None for row in rows):
        figures["precision-recall"] = _precision_recall(rows)
    from matplotlib import rc_context

    paths = []
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, figure in figures.items():
            for suffix in _SUFFIXES:
                paths.append(folder / f"{name}{suffix}")
                # Same figures, same bytes.
                metadata = {"CreationDate": None} if suffix == ".pdf" else {}
                # Journals refuse PDF with fonts of Type 3, which are the default.
                with rc_context({"pdf.fonttype": 42}):
                    figure.savefig(paths[-1], dpi=120, metadata=metadata)
    except OSError as error:
        raise ConfigError(f"The plots cannot be written to {folder}: {error}.") from error
    return paths


def _over_time(name: str, place: int, rows: Sequence[VariantResults]) -> Figure:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 5), layout="constrained")
    panels = figure.subplots(2, 1, sharex=True)
    for row, line in zip(rows, cycle(_LINES)):
        result = row.results[place]
        score = result.score
        if score is None:
            continue
        frames = _numbers(result.stems, [frame.index for frame in score.per_frame])
        marker = "." if len(frames) < 80 else ""
        style = {"label": row.variant.name or None, "marker": marker, "linestyle": line}
        panels[0].plot(frames, [100 * frame.j for frame in score.per_frame], **style)
        panels[1].plot(frames, [100 * frame.f for frame in score.per_frame], **style)
    for panel, heading in zip(panels, ("j", "f"), strict=True):
        panel.set(ylabel=f"{heading}, %", ylim=(-2, 102))
        panel.grid(alpha=0.3)
        panel.margins(x=0)
    panels[1].set_xlabel("frame")
    figure.suptitle(name)
    if len(rows) > 1:
        panels[0].legend()
    return figure


def _numbers(stems: Sequence[str], indices: Sequence[int]) -> list[int]:
    """Return the numbers of pictures: those in their names if all are numbers, else their places."""
    named = [stems[index] for index in indices if index < len(stems)]
    if len(named) == len(indices) and all(stem.isdecimal() for stem in named):
        return [int(stem) for stem in named]
    return list(indices)


def _precision_recall(rows: Sequence[VariantResults]) -> Figure:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6, 5), layout="constrained")
    axes = figure.subplots()
    for row, line in zip(rows, cycle(_LINES)):
        curve = precision_recall(row.results)
        if curve is None:
            continue
        label = f"{row.variant.name}, average precision {100 * curve.average_precision:.1f}".lstrip(", ")
        axes.plot(100 * curve.recall, 100 * curve.precision, marker=".", linestyle=line, label=label)
    axes.set(
        xlabel="recall, %",
        ylabel="precision, %",
        xlim=(0, 102),
        ylim=(0, 102),
        title="masks by the score of their object",
    )
    axes.grid(alpha=0.3)
    axes.legend()
    return figure
