"""Parameters of the segmentation: shadows, the graph cut, what is cleaned away (§6, §7)."""

from __future__ import annotations

from pydantic import Field

from mlbs_actors.config.parameters import Parameters

__all__ = ["SegmentationConfig"]


class SegmentationConfig(Parameters):
    """Posterior, data costs and the label-cost graph cut (§6, §7)."""

    contrast_strength: float = Field(
        1.8, ge=0, description="Cost of a boundary between pixels of one colour: more is smoother, nats."
    )
    contrast_scale: float = Field(
        300.0, gt=0, description="Squared colour difference across a boundary at which its cost falls to 1/e."
    )
    track_cost: float = Field(1.0, ge=0, description="|c|: pull of a labelled trajectory at its pixel, nats.")
    shadow: float = Field(
        0.15, ge=0, description="Cost of an object in a likely cast shadow; 0 = none is looked for, nats."
    )
    shadow_body: float = Field(
        0.05,
        ge=0,
        le=0.5,
        description="Least share of what could cast a shadow in that and the shadow together; twice as much "
        "surely casts it.",
    )
    contact_shadow: float = Field(
        0.12,
        ge=0,
        le=1,
        description="Greatest height of a contact shadow, as a share of its object's; 0 = none.",
    )
    shadow_lightest: float = Field(-0.1, lt=0, description="Log darkening at which a shadow begins.")
    shadow_lightest_ramp: float = Field(0.15, gt=0, description="Range over which that becomes certain.")
    shadow_darkest: float = Field(-2.2, lt=0, description="Log darkening at which a shadow ends.")
    shadow_darkest_ramp: float = Field(0.3, gt=0, description="Range over which it fades out.")
    channel_spread: float = Field(
        0.25, ge=0, description="Largest difference of a shadow's log darkening between channels."
    )
    channel_noise: float = Field(6.0, ge=0, description="What is added to that in the dark, grey levels.")
    ground_px: float = Field(
        16.0, ge=0, description="Pixels nearer to an object's trajectory do not count as ground, px."
    )
    ground_reach: float = Field(
        1.5, gt=0, description="Standard deviation over which ground is searched for first, × 8 cells."
    )
    ground_share: float = Field(0.05, gt=0, le=1, description="Least share of ground within that reach.")
    ground_variance: float = Field(
        0.04, gt=0, description="Variance of the ground's log colour above which no shadow is certain."
    )
    contact_dark: float = Field(-0.7, lt=0, description="Log darkening of a contact shadow.")
    contact_smooth: float = Field(
        6.0, ge=0, description="Its steepest mean gradient over 5×5 px, grey levels/px."
    )
    contact_width: float = Field(0.3, ge=0, description="Its least width, in heights of its object.")
    contact_gap_px: float = Field(6.0, ge=0, description="Its largest distance from the ground, px.")
    contact_edge_px: float = Field(
        4.0, ge=0, description="Width of its edges, which are neither smooth nor flat, px."
    )
    stray_tracks: int = Field(
        3,
        ge=1,
        description="So many trajectories of another object make a part of a mask that holds none of its own "
        "that object's.",
    )
    label_cost: float = Field(
        20.0, ge=0, description="h_k: cost of using a new layer's label at all, px × nats."
    )
    label_cost_frames: int = Field(
        20, ge=0, description="A layer that first owned pixels so many frames ago has no such cost."
    )
    cut_whole: int = Field(2048, ge=1, description="Most pixels that are cut without a coarser level.")
    cut_whole_halved: int = Field(1024, ge=1, description="The same for an image that was halved once.")
    cut_whole_coarse: int = Field(
        9216, ge=1, description="The same for one halved more often: legs are thinner than large blocks."
    )
    speck_px: float = Field(50.0, ge=0, description="Smaller components of an object are cleaned away, px².")
    hole_px: float = Field(200.0, ge=0, description="Smaller holes of the background are filled, px².")

    @property
    def most_cut_whole(self) -> tuple[int, int, int]:
        """The limits by number of halvings; the last is for all further ones."""
        return self.cut_whole, self.cut_whole_halved, self.cut_whole_coarse
