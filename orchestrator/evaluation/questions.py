"""What the engine can be asked by running it in several variants: ``--ablate``, ``--disturb`` and others."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from orchestrator.evaluation.ablation import ablation_table, ablation_variants
from orchestrator.evaluation.comparison import comparison_as_json
from orchestrator.evaluation.disturbance import disturbance_as_json, disturbance_table, disturbance_variants
from orchestrator.evaluation.options import COMPARED_COLUMNS
from orchestrator.evaluation.sizes import size_variants, sizes_table
from orchestrator.evaluation.sweep import sweep_table, sweep_variants
from orchestrator.evaluation.variants import Variant, VariantResults, variants_as_json

__all__ = ["Question", "question_of"]


@dataclass(frozen=True, slots=True)
class Question:
    """Variants of the engine, and what is made of their results.

    Attributes
    ----------
    variants : callable
        From the overrides of all rows to the rows.
    table : callable
        From the results to text.
    as_json : callable
        From the results to JSON types.
    changes_frames : bool
        Whether variants see other pictures, which stored flow would not fit.
    tells_time : bool
        Whether the table has times, so that kernels are to be loaded before.
    """

    variants: Callable[[Sequence[str]], Sequence[Variant]]
    table: Callable[[Sequence[VariantResults]], str]
    as_json: Callable[[Sequence[VariantResults]], dict[str, Any]] = variants_as_json
    changes_frames: bool = False
    tells_time: bool = False


def question_of(options: argparse.Namespace) -> Question | None:
    """Return what the command line asks, None if it is a single run of the engine."""
    if options.ablate:
        return Question(ablation_variants, ablation_table)
    if options.disturb:
        return Question(disturbance_variants, disturbance_table, disturbance_as_json, changes_frames=True)
    if options.sizes:
        variants = partial(size_variants, longer_sides=options.sizes)
        return Question(variants, sizes_table, changes_frames=True, tells_time=True)
    if options.sweep:
        variants = partial(sweep_variants, swept=options.sweep, config=options.config)
        table = partial(sweep_table, columns=options.columns or COMPARED_COLUMNS)
        return Question(variants, table, comparison_as_json)
    return None
