"""Plots of the measurements, as PNG files; drawn by matplotlib, which only this needs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from mlbs_actors.errors import ConfigError

__all__ = ["Plot", "draw"]


@dataclass(frozen=True)
class Plot:
    """The data of a plot.

    Attributes
    ----------
    title, x_label, y_label : str
    x : sequence
        Numbers for lines, names for bars.
    series : mapping of str to sequence of float
        Name → a value for each x.
    form : {"lines", "bars"}
        Bars of one x stand side by side.
    """

    title: str
    x_label: str
    y_label: str
    x: Sequence[Any]
    series: Mapping[str, Sequence[float]]
    form: Literal["lines", "bars"]


def draw(plot: Plot, path: Path) -> None:
    """Write a plot as a PNG file.

    Raises
    ------
    ConfigError
        If the file cannot be written.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 5), layout="constrained")
    axes = figure.subplots()
    if plot.form == "lines":
        for name, values in plot.series.items():
            axes.plot(plot.x, values, marker="." if len(plot.x) > 16 else "o", label=name)
    else:
        width = 0.8 / len(plot.series)
        for number, (name, values) in enumerate(plot.series.items()):
            places = [place + (number + 0.5) * width - 0.4 for place in range(len(plot.x))]
            axes.bar(places, values, width, label=name)
        axes.set_xticks(range(len(plot.x)), plot.x, rotation=20, ha="right")
    axes.set(title=plot.title, xlabel=plot.x_label, ylabel=plot.y_label)
    axes.set_ylim(bottom=0)
    axes.grid(axis="y", alpha=0.3)
    if len(plot.series) > 1:
        axes.legend()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, dpi=120)
    except OSError as error:
        raise ConfigError(f"The plot cannot be written with --plots: {error}.") from error
