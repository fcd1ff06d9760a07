"""The contribution of each stage: the method built up stage by stage, then without one part at a time.

The first row has every stage off, each next row of :data:`STAGES` switches one more on, and the last of them
is the whole method. The rows of :data:`PARTS` follow; each is the whole method without that one part.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from orchestrator.evaluation.variants import Variant, VariantResults, variants_table

__all__ = ["PARTS", "STAGES", "Stage", "ablation_table", "ablation_variants"]


@dataclass(frozen=True, slots=True)
class Stage:
    """A part of the method that can be switched off.

    Attributes
    ----------
    name : str
        Name of the row that adds it.
    off : tuple of str
        The ``section.key=value`` overrides that switch it off.
    """

    name: str
    off: tuple[str, ...] = ()


#: In the order in which they are added; the first remains without all the others.
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


#: More frames than any sequence has.
_NEVER = 1_000_000

_NO_SPLITS = (f"layers.probation_frames={_NEVER}", f"layers.part_probation_frames={_NEVER}")

#: Parts that the whole method is tried without.
PARTS: tuple[Stage, ...] = (
    # Edges this stiff leave a field one degree of freedom an axis: its shift from its prior. The prior of an
    # object is a single motion, that of the background the camera's homography.
    Stage("without motion field (rigid)", ("motion.smoothness_std_px=0.001",)),
    # All standard deviations divided by 128: the mean stays what it is, to the bit, as only the ratios of the
    # precisions count, and the variance falls to 1/16,384.
    Stage(
        "without variance of the motion",
        (
            "motion.smoothness_std_px=0.00390625",
            "motion.point_std_px=0.00390625",
            "motion.prior_std_px=0.15625",
        ),
    ),
    Stage("without warp of the model", ("appearance.warp=false",)),
    # No candidate that a later clustering finds outlasts its probation.
    Stage("without splits", _NO_SPLITS),
    # Nor is there a later clustering, from the tenth frame on.
    Stage("without splits, propagation", (*_NO_SPLITS, f"layers.clustering_period={_NEVER}")),
    Stage("with absorbing propagation", ("affinity.propagation=absorbing",)),
    Stage("without label cost", ("segmentation.label_cost=0",)),
)


def ablation_variants(
    overrides: Sequence[str], stages: Sequence[Stage] = STAGES, parts: Sequence[Stage] = PARTS
) -> tuple[Variant, ...]:
    """Make the rows: one for each stage, with all later stages off, then one without each part.

    Parameters
    ----------
    overrides : sequence of str
        Parameters of every row; stages that are off stay off regardless.
    stages, parts : sequence of Stage

    Returns
    -------
    tuple of Variant
        In the order of the stages, then of the parts.

    Notes
    -----
    Where two stages switch the same parameter, the earlier one decides while both are off: without it the
    later one has nothing to build on.
    """
    built_up = (
        Variant(
            stage.name,
            (*overrides, *(override for later in reversed(stages[row + 1 :]) for override in later.off)),
        )
        for row, stage in enumerate(stages)
    )
    left_out = (Variant(part.name, (*overrides, *part.off)) for part in parts)
    return (*built_up, *left_out)


def ablation_table(rows: Sequence[VariantResults]) -> str:
    """Write the rows as text: scores of movers and objects, extra layers and changed ids."""
    return variants_table(rows, "stage", ("two_label_f", "object_f", "extra", "switches"))
