"""Parameters of a layer: its motion field, its colours, its posterior (§5, §6)."""

from __future__ import annotations

from pydantic import Field

from mlbs_actors.config.parameters import Parameters

__all__ = ["AppearanceConfig", "MotionConfig", "PosteriorConfig"]


class MotionConfig(Parameters):
    """Motion field of a layer (§5, the paper's Gaussian belief propagation)."""

    grid_px: float = Field(18.0, ge=4, description="Spacing of the field's grid, px; rounded to whole cells.")
    variance_grid_px: float = Field(
        32.0, ge=8, description="Spacing of the grid of the marginal variances, px; rounded to whole cells."
    )
    smoothness_std_px: float = Field(0.5, gt=0, description="σ_m: difference of neighbouring nodes, px.")
    point_std_px: float = Field(0.5, gt=0, description="σ_p: a trajectory's error, px.")
    prior_std_px: float = Field(
        20.0, gt=0, description="Weak prior on the camera's motion where nothing is known, px."
    )
    robust_px: float = Field(
        1.5, gt=0, description="Misfit at which a trajectory keeps a quarter of its weight, px."
    )
    flow_std_px: float = Field(1.0, gt=0, description="Error of the dense flow, px.")


class AppearanceConfig(Parameters):
    """Kernel density of a layer's colours (§6.2)."""

    samples: int = Field(16, ge=1, le=255, description="N: samples kept a cell.")
    bandwidth_floor: float = Field(5.0, gt=0, description="Least kernel bandwidth, grey levels.")
    registration_px: float = Field(
        1.0,
        ge=0,
        description="An object's registration error: bandwidths grow by it × the gradient, px.",
    )
    background_registration_px: float = Field(0.6, ge=0, description="The same for the background, px.")
    half_confidence_samples: float = Field(
        2.0, gt=0, description="Samples at which a pixel's model is trusted half."
    )
    warp: bool = Field(
        True, description="Whether a layer's samples and its last posterior move along with it (§6.1)."
    )


class PosteriorConfig(Parameters):
    """Weights and bounds of a layer's unnormalised posterior (§6)."""

    appearance: float = Field(0.2, ge=0, description="Weight of the colour likelihood.")
    appearance_cap: float = Field(
        3.0, gt=0, description="Most that a matching colour counts against the uniform one, nats."
    )
    motion: float = Field(
        0.06, ge=0, description="Weight of the flow's agreement with the layer's motion field."
    )
    motion_floor: float = Field(
        0.05,
        gt=0,
        lt=1,
        description="Likelihood of a flow that contradicts the background's field.",
    )
    object_motion_floor: float = Field(
        0.4, gt=0, lt=1, description="The same for an object: its limbs move in ways of their own."
    )
    photometric: float = Field(
        0.25, ge=0, description="Weight of how much better an object's motion explains the image."
    )
    photometric_cap: float = Field(3.0, gt=0, description="Most that it counts, × noise.")
    photometric_least_noise: float = Field(
        1.5, gt=0, description="Lower bound of the noise estimate, grey levels."
    )
    photometric_most_noise: float = Field(
        3.0, gt=0, description="Upper bound of the noise estimate, grey levels."
    )
    own_believed: float = Field(
        4.0, ge=0, description="Error at which an object's own motion is not trusted at all, × noise."
    )
    camera_believed: float = Field(2.5, ge=0, description="The same for the camera's motion, × noise.")
    prior: float = Field(0.02, ge=0, description="Weight of the warped posterior of the last frame.")
    prior_floor: float = Field(0.1, gt=0, lt=1, description="Least prior.")
    neutral_prior: float = Field(0.5, gt=0, le=1, description="Prior where the layer was not before.")
    distance: float = Field(0.1, ge=0, description="Cost of an object away from its trajectories, nats.")
    near_px: float = Field(
        10.0, ge=0, description="Distance from its trajectories up to which it costs nothing, px."
    )
    fade_px: float = Field(
        20.0, gt=0, description="Further distance over which the cost rises to all of it, px."
    )
    close_px: float = Field(
        20.0,
        ge=0,
        description="Half the width of gaps between its trajectories that belong to an object, px.",
    )
    keep_off_px: float = Field(
        40.0,
        ge=0,
        description="Within this of an object the background learns only beside its own trajectories, px.",
    )
    learn_px: float = Field(6.0, ge=0, description="An object learns only this near to its trajectories, px.")
    offset: float = Field(4.0, ge=0, description="Added to every cost so that it is not negative, nats.")
    region_margin_px: float = Field(
        32.0, ge=0, description="Margin of an object's region around its trajectories and pixels, px."
    )
    covered_margin_px: float = Field(
        5.0,
        ge=0,
        description="The same, if it is less, where trajectories that move alike cover an object that "
        "touches no border, px.",
    )
    covered_px: float = Field(
        100.0, ge=0, description="Most pixels per trajectory of an object that is covered, px²."
    )
