"""Other values of parameters: the engine with each of them, and how its figures differ from the default's."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from pathlib import Path

from mlbs_actors.config import load_config
from mlbs_actors.errors import ConfigError
from orchestrator.evaluation.comparison import difference_of, figures_by_sequence
from orchestrator.evaluation.figures import format_table
from orchestrator.evaluation.variants import Variant, VariantResults

__all__ = ["sweep_table", "sweep_variants"]

#: The row that the others are compared with.
DEFAULT = "default"


def sweep_variants(
    overrides: Sequence[str], swept: Sequence[str], config: Path | None = None
) -> tuple[Variant, ...]:
    """Make the rows: the parameters as they are, then each combination of other values.

    Parameters
    ----------
    overrides : sequence of str
        Parameters of every row.
    swept : sequence of str
        ``section.key=a,b,c`` each. A combination that is the default's is left out.
    config : Path or None
        YAML file with parameters of every row.

    Raises
    ------
    ConfigError
        If one is written otherwise, or a value cannot be used.
    """
    choices = []
    for text in swept:
        key, equals, values = text.partition("=")
        if not (equals and key and all(values.split(","))):
            raise ConfigError(f"Cannot use --sweep {text!r}; write it as in layers.lookahead=0,2,4.")
        choices.append([f"{key}={value}" for value in values.split(",")])
    default = load_config(config, overrides)
    combinations = (
        combination
        for combination in itertools.product(*choices)
        if load_config(config, [*overrides, *combination]) != default
    )
    return (
        Variant(DEFAULT, tuple(overrides)),
        *(Variant(" ".join(one), (*overrides, *one)) for one in combinations),
    )


def sweep_table(rows: Sequence[VariantResults], columns: Sequence[str]) -> str:
    """Format a row for each combination: means, and the difference from the default with its 95 % interval.

    Parameters
    ----------
    rows : sequence of VariantResults
        Those of :func:`sweep_variants`.
    columns : sequence of str
        Headings of :data:`orchestrator.evaluation.figures.COLUMNS`.
    """
    first = {column: figures_by_sequence(rows[0], column) for column in columns}
    lines = []
    for row in rows:
        line = [row.variant.name]
        for column in columns:
            mean = row.mean(column)
            line.append(f"{mean:.1f}" if math.isfinite(mean) else "-")
            if row is rows[0]:
                line += ["", ""]
                continue
            one = difference_of(figures_by_sequence(row, column), first[column])
            line.append(f"{one.mean:+.1f}" if one.sequences else "-")
            line.append(f"{one.low:+.1f} … {one.high:+.1f}" if one.sequences > 1 else "-")
        lines.append(line)
    headings = [heading for column in columns for heading in (column, "Δ", "95 %")]
    return format_table(["parameters", *headings], lines)
