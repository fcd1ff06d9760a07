"""Sensitivity of the result to parameters and to accidents of the input: disturbed runs.

A run either scales parameters together or changes the input. Parameters are scaled from their current values,
so the table stays valid when a default changes.

No part of the engine draws random numbers whose seed could be changed: the eigensolver's start is fixed, and
OpenCV's RANSAC seeds itself anew in every call, whatever ``cv2.setRNGSeed`` says. In place of another seed
the first three rows and columns are cropped: that shifts all grids (of flow, seeds and motion fields)
relative to the picture, and changes every result that depends on small differences.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from mlbs_actors.config import Config, load_config
from orchestrator.evaluation.disturbed_footage import FOOTAGE
from orchestrator.evaluation.disturbed_sequences import (
    CroppedSequence,
    MirroredSequence,
    SelectedFrames,
    every_second_frame,
)
from orchestrator.evaluation.figures import format_number
from orchestrator.evaluation.sequences import SequenceChange
from orchestrator.evaluation.variants import Variant, VariantResults, variants_as_json, variants_table

__all__ = [
    "DISTURBANCES",
    "UNDISTURBED",
    "Disturbance",
    "disturbance_as_json",
    "disturbance_table",
    "disturbance_variants",
    "worst_run",
]


@dataclass(frozen=True, slots=True)
class Disturbance:
    """One disturbed run.

    Attributes
    ----------
    name : str
        Name of its row.
    parameters : tuple of str
        ``section.key`` of the parameters that are scaled together.
    factor : float
        Scale; integers stay integers.
    change : SequenceChange or None
        Change to every sequence.
    """

    name: str
    parameters: tuple[str, ...] = ()
    factor: float = 1.0
    change: SequenceChange | None = None


THRESHOLDS = (
    "affinity.cut_threshold",
    "layers.merge_distance",
    "layers.object_merge_distance",
    "layers.same_motion_distance",
    "layers.same_motion_border",
    "identity.step_ratio",
    "identity.apart",
    "layers.unexplained_noise",
    "layers.least_evidence",
    "trajectories.dense_advantage",
    "segmentation.contact_shadow",
)
TRAJECTORIES = ("trajectories.seed_spacing_px", "trajectories.consistency_px2", "affinity.radius_px")
WEIGHTS = (
    "posterior.appearance",
    "posterior.motion",
    "posterior.photometric",
    "posterior.prior",
    "posterior.distance",
    "segmentation.contrast_strength",
    "segmentation.shadow",
)
LIMITS = (
    "flow.focus_advantage",
    "flow.focus_least_blocks",
    "flow.focus_margin_blocks",
    "flow.focus_seam_blocks",
    "flow.focus_most",
    "trajectories.least_spacing_cells",
    "trajectories.least_dense_spacing_cells",
    "trajectories.square_tracks",
    "trajectories.evidence_forgetting",
    "trajectories.least_evidence_step",
    "trajectories.most_evidence_step",
    "trajectories.camera_inlier_px",
    "trajectories.camera_tracks",
    "trajectories.least_noise",
    "trajectories.most_noise",
    "trajectories.most_planar",
    "trajectories.least_epipolar",
    "trajectories.least_static",
    "affinity.firm_factor",
    "layers.spared_clusterings",
    "layers.speed_frames",
    "layers.least_border",
    "identity.least_inner",
    "identity.step_slope",
    "identity.free_gap",
    "identity.gap_slope",
    "identity.most_evidence",
    "identity.weight",
    "identity.fading",
    "identity.colour_likeness",
    "identity.colour_slope",
    "identity.place_px",
    "identity.place_slope",
    "identity.place_frames",
    "posterior.photometric_least_noise",
    "posterior.photometric_most_noise",
    "posterior.own_believed",
    "posterior.camera_believed",
    "posterior.covered_px",
    "segmentation.cut_whole",
    "segmentation.cut_whole_halved",
    "segmentation.cut_whole_coarse",
)
SHADOWS = (
    "segmentation.shadow_lightest",
    "segmentation.shadow_lightest_ramp",
    "segmentation.shadow_darkest",
    "segmentation.shadow_darkest_ramp",
    "segmentation.channel_spread",
    "segmentation.channel_noise",
    "segmentation.ground_px",
    "segmentation.ground_reach",
    "segmentation.ground_share",
    "segmentation.ground_variance",
    "segmentation.contact_dark",
    "segmentation.contact_smooth",
    "segmentation.contact_width",
    "segmentation.contact_gap_px",
    "segmentation.contact_edge_px",
)

DISTURBANCES: tuple[Disturbance, ...] = (
    Disturbance("thresholds × 0.8", THRESHOLDS, 0.8),
    Disturbance("thresholds × 1.2", THRESHOLDS, 1.2),
    Disturbance("trajectories × 0.8", TRAJECTORIES, 0.8),
    Disturbance("trajectories × 1.2", TRAJECTORIES, 1.2),
    Disturbance("weights, contrast × 0.8", WEIGHTS, 0.8),
    Disturbance("weights, contrast × 1.2", WEIGHTS, 1.2),
    Disturbance("limits × 0.8", LIMITS, 0.8),
    Disturbance("limits × 1.2", LIMITS, 1.2),
    Disturbance("shadows × 0.8", SHADOWS, 0.8),
    Disturbance("shadows × 1.2", SHADOWS, 1.2),
    Disturbance("every second frame", change=every_second_frame),
    Disturbance("first 3 frames left out", change=partial(SelectedFrames, first=3)),
    Disturbance("mirrored", change=MirroredSequence),
    Disturbance("cropped by 3 px (as another seed)", change=partial(CroppedSequence, pixels=3)),
    *(Disturbance(name, change=change) for name, change in FOOTAGE.items()),
)

#: The row that the others are compared with.
UNDISTURBED = "undisturbed"

_FIGURES = ("two_label_f", "object_f")


def disturbance_variants(
    overrides: Sequence[str], disturbances: Sequence[Disturbance] = DISTURBANCES
) -> tuple[Variant, ...]:
    """Make the rows: the undisturbed run, then the disturbed ones.

    Parameters
    ----------
    overrides : sequence of str
        Parameters of every row; scaling starts from them.
    disturbances : sequence of Disturbance

    Raises
    ------
    ConfigError
        If a key or value of the overrides is wrong.
    """
    config = load_config(None, overrides)
    return (
        Variant(UNDISTURBED, tuple(overrides)),
        *(
            Variant(
                disturbance.name,
                (*overrides, *(_scaled(config, name, disturbance.factor) for name in disturbance.parameters)),
                disturbance.change,
            )
            for disturbance in disturbances
        ),
    )


def _scaled(config: Config, parameter: str, factor: float) -> str:
    section, _, key = parameter.partition(".")
    value = getattr(getattr(config, section), key)
    return f"{parameter}={round(factor * value) if isinstance(value, int) else factor * value}"


def worst_run(runs: Sequence[VariantResults], figure: str) -> VariantResults | None:
    """Return the run with the lowest mean of a figure, the first of equals; None if no mean is known.

    A run in which a sequence failed is worse than all others.
    """
    for run in runs:
        if run.failed:
            return run
    known = [run for run in runs if not math.isnan(run.mean(figure))]
    return min(known, key=lambda run: run.mean(figure), default=None)


def disturbance_table(rows: Sequence[VariantResults]) -> str:
    """Format the rows, and the worst of the disturbed runs for each figure.

    Parameters
    ----------
    rows : sequence of VariantResults
        The undisturbed run first, as from :func:`disturbance_variants`.
    """
    lines = [variants_table(rows, "run", _FIGURES), ""]
    for figure in _FIGURES:
        worst = worst_run(rows[1:], figure)
        if worst is not None:
            mean = "failed" if worst.failed else format_number(worst.mean(figure))
            reference = format_number(rows[0].mean(figure))
            lines.append(f"worst {figure}: {worst.variant.name}, {mean} ({UNDISTURBED} {reference})")
    return "\n".join(lines)


def disturbance_as_json(rows: Sequence[VariantResults]) -> dict[str, Any]:
    """Return all figures of all rows, and the name of the worst run for each figure."""
    worst = {figure: worst_run(rows[1:], figure) for figure in _FIGURES}
    names = {figure: None if run is None else run.variant.name for figure, run in worst.items()}
    return {**variants_as_json(rows), "worst": names}
