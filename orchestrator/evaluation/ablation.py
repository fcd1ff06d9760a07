"""What each stage of the method gives: the method built up stage by stage, a row for each.

The first row has every stage off, each next row switches one more on, and the last is the whole method.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from orchestrator.evaluation.variants import Variant, VariantResults, variants_table

__all__ = ["STAGES", "Stage", "ablation_table", "ablation_variants"]


@dataclass(frozen=True, slots=True)
class Stage:
    """A part of the method that can be switched off.

    Attributes
    ----------
    name : str
        Names the row in which it comes in.
    off : tuple of str
        The ``section.key=value`` overrides that switch it off.
    """

    name: str
    off: tuple[str, ...] = ()


#: In the order in which they come in; the first is what is left without all the others.
STAGES: tuple[Stage, ...] = (
    Stage("trajectories + contrast cut alone"),
    Stage("+ appearance", ("posterior.appearance=0",)),
    Stage(
        "+ registration errors", ("appearance.registration_px=0", "appearance.background_registration_px=0")
    ),
    Stage("+ motion likelihood", ("posterior.motion=0",)),
    Stage("+ photometric advantage", ("posterior.photometric=0",)),
    Stage("+ distance from trajectories", ("posterior.distance=0",)),
    Stage("+ prior", ("posterior.prior=0",)),
    Stage("+ label cost", ("segmentation.label_cost=0",)),
    Stage("+ shadows", ("segmentation.shadow=0",)),
    Stage("+ contact shadows", ("segmentation.contact_shadow=0",)),
    Stage("+ cleaning", ("segmentation.speck_px=0", "segmentation.hole_px=0")),
)


def ablation_variants(overrides: Sequence[str], stages: Sequence[Stage] = STAGES) -> tuple[Variant, ...]:
    """The rows: each has all stages after its own switched off.

    Parameters
    ----------
    overrides : sequence of str
        Parameters of every row; a stage that is off is off whatever they say.
    stages : sequence of Stage

    Returns
    -------
    tuple of Variant
        One a stage, in their order.

    Notes
    -----
    Where two stages switch the same parameter, the earlier one decides while both are off: without it the
    later one has nothing to build on.
    """
    return tuple(
        Variant(
            stage.name,
            (*overrides, *(override for later in reversed(stages[row + 1 :]) for override in later.off)),
        )
        for row, stage in enumerate(stages)
    )


def ablation_table(rows: Sequence[VariantResults]) -> str:
    """The rows as text: how well movers and objects are found, and what is found too much or renamed."""
    return variants_table(rows, "stage", ("two_label_f", "object_f", "extra", "switches"))
