"""Parameters of the clustering, and of the layers that come of it (§4)."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from mlbs_actors.config.parameters import Parameters

__all__ = ["AffinityConfig", "IdentityConfig", "LayersConfig"]


class AffinityConfig(Parameters):
    """Affinities between trajectories, and their clustering (§4)."""

    neighbours: int = Field(20, ge=1, description="Nearest trajectories each one is compared with.")
    radius_px: float = Field(
        67.0, gt=0, description="Spatial scale of the affinity, and the largest distance of a pair."
    )
    motion_floor_px: float = Field(1.5, gt=0, description="Least spread of two-frame displacements, px.")
    motion_relative: float = Field(
        0.1, ge=0, description="Spread of displacements as a share of the camera's motion."
    )
    object_relative: float = Field(
        0.15, ge=0, description="Spread of displacements inside an object as a share of its own motion."
    )
    motion_factor: float = Field(
        0.5, gt=0, description="Motion distance is in units of this × the spread of displacements."
    )
    forgetting: float = Field(
        0.005, ge=0, lt=1, description="Share of a past motion distance forgotten a frame."
    )
    cut_threshold: float = Field(
        1e-2, gt=0, description="A cluster is split while its best N-cut is below this."
    )
    cut_side_tracks: int = Field(12, ge=2, description="Least trajectories on either side of a split.")
    firm_factor: float = Field(
        3.0, ge=1, description="A cluster is firm if its best N-cut is certainly above this × the threshold."
    )
    propagation: Literal["soft", "absorbing"] = Field(
        "soft", description="Random walk with soft restart, or the paper's absorbing one."
    )
    restart: float = Field(0.3, gt=0, lt=1, description="Restart probability of the soft random walk.")


class LayersConfig(Parameters):
    """Births, merges, dormancy and retirement of layers (§4)."""

    init_frames: int = Field(5, ge=1, le=5, description="Frames held before the first clustering (n_init).")
    lookahead: int = Field(0, ge=0, description="Frames by which every label is delayed.")
    max_layers: int = Field(
        33, ge=2, description="Most layers of a stream with the background; smaller objects share 'other'."
    )
    clustering_period: int = Field(
        3, ge=1, description="Frames from one clustering to the next (1 at the start)."
    )
    spared_clusterings: int = Field(
        3, ge=0, description="Clusterings in which an object skips the N-cut test after it was firm in one."
    )
    young_frames: int = Field(6, ge=0, description="Age below which a label can be merged by motion.")
    least_moving: float = Field(
        0.25, ge=0, le=1, description="Share of its life in which a label must have moved to count as older."
    )
    moving_clusterings: int = Field(
        10, ge=1, description="What has moved in so many clusterings counts as older however long it rests."
    )
    merge_quantile: float = Field(
        0.3, ge=0, le=1, description="Quantile of motion distances across a border."
    )
    merge_distance: float = Field(1.2, ge=0, description="Labels below it at that quantile are one.")
    object_merge_distance: float = Field(6.0, ge=0, description="The same between two objects.")
    merge_border: float = Field(
        6.0, ge=0, description="Border edges of two objects to merge, × √(trajectories of the younger)."
    )
    speed_frames: int = Field(
        3, ge=1, description="Frames over which a speed against the camera is averaged."
    )
    camera_px: float = Field(
        0.6, ge=0, description="A young label moves at least this much against the camera, px/frame."
    )
    camera_relative: float = Field(
        0.06, ge=0, description="... and at least this share of the camera's own motion."
    )
    scene_frames: int = Field(
        4, ge=1, description="Frames over which depth alone may explain a label's motion."
    )
    scene_obeying: float = Field(
        0.75,
        ge=0,
        le=1,
        description="Share of the trajectories that one rigid scene explains, to tell anything.",
    )
    scene_odds: float = Field(
        1.5, ge=0, description="Log-odds that it is static from which on a layer does not move, nats."
    )
    same_motion_distance: float = Field(
        2.5, ge=0, description="Objects of any age but long-lived ones are one below it at that quantile."
    )
    same_motion_frames: int = Field(30, ge=0, description="Objects that are both older than this stay two.")
    same_motion_border: float = Field(
        1.0, ge=0, description="Border edges of two such objects, × √(trajectories of the younger)."
    )
    least_border: int = Field(5, ge=1, description="Fewer border edges of two such objects are not evidence.")
    unexplained_noise: float = Field(
        4.0, gt=0, description="The camera's motion fails to explain a place where it errs by this, × noise."
    )
    least_evidence: float = Field(
        2.0, description="A moving trajectory counts from this much evidence against the camera, × noise."
    )
    probation_frames: int = Field(2, ge=0, description="Frames a split must last before it becomes a layer.")
    part_probation_frames: int = Field(
        30, ge=0, description="The same for what falls off an object; until then it is a part of it."
    )
    min_tracks: int = Field(5, ge=1, description="A layer with fewer trajectories falls asleep.")
    coast_frames: int = Field(
        10, ge=0, description="Frames a layer without trajectories stays awake while it owns pixels."
    )
    dormant_frames: int = Field(
        90, ge=0, description="Frames a vanished layer is remembered that has moved often."
    )
    fleeting_frames: int = Field(
        30, ge=0, description="The same for one that has not; at most as long as the others."
    )


class IdentityConfig(Parameters):
    """Which clusters are one thing, and which are two (§4)."""

    inner_quantile: float = Field(
        0.9, ge=0, le=1, description="Quantile of motion distances inside a label: how much it bends."
    )
    least_inner: float = Field(0.3, gt=0, description="Motion distance that is noise inside a label.")
    step_ratio: float = Field(
        4.9, gt=0, description="Step ÷ bending at which two things are as likely as one."
    )
    step_slope: float = Field(1.8, ge=0, description="Log-likelihood ratio for each e-fold more, nats.")
    free_gap: float = Field(
        0.5, ge=0, description="Gap between a part and the rest that says nothing, × the larger one's size."
    )
    gap_slope: float = Field(5.0, ge=0, description="Log-likelihood ratio for each size more, nats.")
    most_evidence: float = Field(
        3.0,
        gt=0,
        description="Most evidence of one clustering, or of a lost object's colours or place, nats.",
    )
    weight: float = Field(0.5, gt=0, description="Weight of a clustering: their errors are alike.")
    fading: float = Field(0.8, ge=0, lt=1, description="Share of the log-odds that is left at the next one.")
    colour_likeness: float = Field(
        0.65,
        ge=0,
        le=1,
        description="Bhattacharyya coefficient of a lost object's colours and a new one's that says nothing.",
    )
    colour_slope: float = Field(7.0, ge=0, description="Log-likelihood ratio for each unit more, nats.")
    place_px: float = Field(
        80.0, gt=0, description="Distance from a lost object's place at which it says nothing, px."
    )
    place_slope: float = Field(2.0, ge=0, description="Log-likelihood ratio for each e-fold less, nats.")
    place_frames: float = Field(40.0, gt=0, description="Frames after which place says half as much.")
    apart: float = Field(
        1.5, description="Log-odds from which on labels are two things: they are one four times as often."
    )

    def bounded(self, evidence: float) -> float:
        """Limit a log-likelihood ratio, in nats, so that no single term decides."""
        return min(max(evidence, -self.most_evidence), self.most_evidence)
