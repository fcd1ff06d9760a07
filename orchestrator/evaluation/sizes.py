"""Accuracy and cost by working size: the engine on pictures of other sizes, scored in their own.

Pictures are shrunk as ``--max-side`` of a run does it, or enlarged, which shows what the size alone changes
where there is no finer detail to see. Label maps are brought back to the size of the truth by nearest
neighbour.
"""

from __future__ import annotations

from collections.abc import Sequence

from orchestrator.evaluation.figures import format_number, format_table
from orchestrator.evaluation.variants import Variant, VariantResults

__all__ = ["size_variants", "sizes_table"]

#: Figures of the table.
FIGURES = ("two_label_f", "j&f", "object_f", "track_j", "extra", "cpu_ms")


def size_variants(overrides: Sequence[str], longer_sides: Sequence[int]) -> tuple[Variant, ...]:
    """Make the rows: the pictures as they are, then each size, the smallest first."""
    sizes = [Variant(f"{side} px", tuple(overrides), longer_side=side) for side in sorted(set(longer_sides))]
    return (Variant("as it is", tuple(overrides)), *sizes)


def sizes_table(rows: Sequence[VariantResults]) -> str:
    """Format a row per size: means over the sequences, and the CPU time relative to the pictures as they are.

    Parameters
    ----------
    rows : sequence of VariantResults
        Those of :func:`size_variants`.
    """
    whole = rows[0].mean("cpu_ms")
    lines = [
        [
            row.variant.name,
            *(format_number(row.mean(figure)) for figure in FIGURES),
            f"{row.mean('cpu_ms') / whole:.2f}",
        ]
        for row in rows
    ]
    return format_table(["longer side", *FIGURES, "relative"], lines)
