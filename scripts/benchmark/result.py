"""What a measurement returns: tables to read, figures for a program, plots."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from benchmark.plots import Plot

__all__ = ["MeasurementResult"]


@dataclass(frozen=True)
class MeasurementResult:
    """Outcome of one measurement.

    Attributes
    ----------
    tables : tuple of str
    figures : dict
        As JSON can hold them; NaN for what is not known.
    plots : dict of str to Plot
        By the name of the file, without extension.
    """

    tables: tuple[str, ...]
    figures: dict[str, Any]
    plots: dict[str, Plot]
