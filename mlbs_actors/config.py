"""Every parameter of the engine: frozen, validated, with its unit, meaning and paper section.

One set serves all videos. Lengths are stated in px of a 640×480 frame and scale with the frame's side
(:func:`length_scale`), so that the same object is treated alike at any resolution; in large frames they grow
less, so that smaller things are seen in them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Any, Literal

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from mlbs_actors.errors import ConfigError

__all__ = [
    "AffinityConfig",
    "AppearanceConfig",
    "Config",
    "FlowConfig",
    "GridConfig",
    "IdentityConfig",
    "LayersConfig",
    "MotionConfig",
    "PosteriorConfig",
    "SegmentationConfig",
    "TrajectoriesConfig",
    "detail",
    "length_scale",
    "load_config",
]


#: Beyond so many sides of the reference frame a frame is large.
LARGE = 1.3


def length_scale(height: int, width: int) -> float:
    """How many px of an ``height`` × ``width`` frame make one px of the 640×480 reference frame.

    The side of a square of the same area counts in full up to ``LARGE`` sides of the reference frame (about
    960×540), and beyond that with a power of 0.4: what is filmed at 1920×1080 is filmed for its detail.
    """
    side = math.sqrt(height * width / (640 * 480))
    return side if side <= LARGE else LARGE * (side / LARGE) ** 0.4


def detail(height: int, width: int) -> float:
    """By how much things are smaller, in proportion, that a frame of this size is to show; 1 if not large."""
    return math.sqrt(height * width / (640 * 480)) / length_scale(height, width)


class _Section(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class GridConfig(_Section):
    """The cells of a frame: the one grid of flow, trajectories' evidence, posteriors and colours."""

    cell_px: float = Field(
        2.1,
        gt=0,
        le=24,
        description="Side of the square of pixels that share flow, posterior and samples, px.",
    )


class FlowConfig(_Section):
    """Dense optical flow (§3): dense inverse search (DIS) where the authors use LDOF."""

    method: Literal["search", "opencv"] = Field(
        "search", description="Our own dense inverse search, or OpenCV's, which takes about twice the time."
    )
    finest_scale: int = Field(
        0,
        ge=0,
        le=3,
        description="Own search, and OpenCV's: last level of the pyramid, 0 = the cells themselves.",
    )
    search_iterations: int = Field(6, ge=1, description="Own search: gradient descent iterations of a patch.")
    refinement_iterations: int = Field(
        1, ge=0, description="Own search: iterations of variational refinement."
    )
    patch_stride_px: int = Field(
        5, ge=1, le=8, description="Own search: distance of patches (which are 8 px wide)."
    )
    first_search_iterations: int = Field(
        16, ge=1, description="The same in the frames that are held until the first clustering."
    )
    first_refinement_iterations: int = Field(3, ge=0, description="The same there.")
    first_patch_stride_px: int = Field(3, ge=1, le=8, description="The same there.")
    focus_advantage: float = Field(
        0.5,
        description="8×8 cells need the finest level if flow explained them better by this, × noise.",
    )
    focus_least_blocks: int = Field(3, ge=1, description="Fewer adjacent ones are taken for noise.")
    focus_margin_blocks: int = Field(2, ge=0, description="Margin around them, in blocks.")
    focus_seam_blocks: float = Field(
        4.0,
        ge=0,
        description="Cost of a seam between two boxes for each pair of blocks that it separates, in blocks.",
    )
    focus_most: float = Field(
        0.7, ge=0, le=1, description="Above this share of the frame, all of it is searched."
    )


class TrajectoriesConfig(_Section):
    """Point trajectories (§3, after Sundaram, Brox, Keutzer, ECCV 2010)."""

    seed_spacing_px: float = Field(
        10.0, gt=1, description="Grid on which points without a live track near are seeded."
    )
    dense_spacing_px: float = Field(
        4.0, gt=1, description="The same where the camera's motion fails to explain the image."
    )
    dense_advantage: float = Field(
        3.0,
        description="It fails where the flow explains the image better by this, × noise; in large frames "
        "less, as few cells of a small thing say so.",
    )
    consistency_relative: float = Field(
        0.01, ge=0, description="Forward–backward error allowed, × (|w|²+|w'|²)."
    )
    consistency_px2: float = Field(0.5, ge=0, description="Forward–backward error allowed besides, px².")
    boundary_relative: float = Field(0.01, ge=0, description="Squared flow gradient allowed, × |w|².")
    boundary_absolute: float = Field(0.002, ge=0, description="Squared flow gradient allowed besides.")
    most_mismatch: float = Field(
        8.0,
        gt=0,
        description="A point is lost where even the flow leaves this much of the image unexplained, × noise.",
    )
    history_frames: int = Field(24, ge=2, description="Frames of motion that a trajectory remembers.")
    least_spacing_cells: float = Field(3.0, gt=0, description="Least spacing of seeds, cells.")
    least_dense_spacing_cells: float = Field(2.0, gt=0, description="The same on the dense grid, cells.")
    square_tracks: int = Field(7, ge=1, description="Most trajectories of a square of 8×8 cells.")
    evidence_forgetting: float = Field(
        0.05,
        ge=0,
        le=1,
        description="Share of a trajectory's evidence against the camera that is forgotten per frame.",
    )
    least_evidence_step: float = Field(-2.0, description="Lower bound of what one frame adds to it, × noise.")
    most_evidence_step: float = Field(8.0, description="Upper bound of what one frame adds to it, × noise.")
    camera_inlier_px: float = Field(
        1.0, gt=0, description="Reprojection error of an inlier of the camera's motion, px."
    )
    camera_tracks: int = Field(
        12, ge=4, description="With fewer, the camera's motion is a translation, not a homography."
    )
    least_noise: float = Field(
        2.0, gt=0, description="Least noise estimate of the camera's evidence, grey levels."
    )
    most_noise: float = Field(
        3.5, gt=0, description="Largest noise estimate of the camera's evidence, grey levels."
    )
    most_planar: float = Field(
        0.6,
        ge=0,
        le=1,
        description="Largest share of points that obey the homography of a camera that drives.",
    )
    least_epipolar: float = Field(
        0.7,
        ge=0,
        le=1,
        description="Least share of points that obey one epipolar geometry if the camera drives.",
    )
    least_static: float = Field(
        0.5,
        ge=0,
        le=1,
        description="Least share of those that move as static points do if the camera drives.",
    )


class AffinityConfig(_Section):
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


class LayersConfig(_Section):
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


class IdentityConfig(_Section):
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


class MotionConfig(_Section):
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


class AppearanceConfig(_Section):
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


class PosteriorConfig(_Section):
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


class SegmentationConfig(_Section):
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


class Config(_Section):
    """All parameters of one stream."""

    grid: GridConfig = GridConfig()
    flow: FlowConfig = FlowConfig()
    trajectories: TrajectoriesConfig = TrajectoriesConfig()
    affinity: AffinityConfig = AffinityConfig()
    layers: LayersConfig = LayersConfig()
    identity: IdentityConfig = IdentityConfig()
    motion: MotionConfig = MotionConfig()
    appearance: AppearanceConfig = AppearanceConfig()
    posterior: PosteriorConfig = PosteriorConfig()
    segmentation: SegmentationConfig = SegmentationConfig()


def load_config(path: str | Path | None = None, overrides: Sequence[str] = ()) -> Config:
    """Read parameters from a YAML file and ``section.key=value`` overrides.

    Parameters
    ----------
    path : path or None
        YAML file with any subset of the parameters; None for the defaults.
    overrides : sequence of str
        For example ``["layers.lookahead=4"]``; applied after the file.

    Returns
    -------
    Config

    Raises
    ------
    ConfigError
        If the file cannot be read, or a key or value is wrong.
    """
    values: dict[str, Any] = {}
    if path is not None:
        try:
            loaded = yaml.safe_load(Path(path).read_text(encoding="utf-8"))
        except OSError as error:
            raise ConfigError(f"The configuration {path} cannot be read: {error.strerror}.") from None
        except UnicodeDecodeError:
            raise ConfigError(f"The configuration {path} cannot be read: it is no text in UTF-8.") from None
        except yaml.YAMLError as error:
            raise ConfigError(f"The configuration {path} cannot be read: {error}.") from error
        if loaded is not None and not isinstance(loaded, dict):
            raise ConfigError(f"The configuration {path} must hold sections of key: value pairs.")
        values = loaded or {}
    for override in overrides:
        name, equals, text = override.partition("=")
        section, dot, key = name.strip().partition(".")
        if not (equals and dot and section and key):
            raise ConfigError(f"Cannot use --set {override!r}; write it as in layers.lookahead=4.")
        group = values.get(section) or {}
        if not isinstance(group, dict):
            raise ConfigError(f"The section {section!r} must hold key: value pairs.")
        try:
            values = {**values, section: {**group, key: yaml.safe_load(text)}}
        except yaml.YAMLError as error:
            raise ConfigError(f"The value in --set {override!r} cannot be read: {error}.") from error
    try:
        return Config.model_validate(values)
    except ValidationError as error:
        problems = "; ".join(
            _problem(problem["type"], problem["loc"], problem["msg"]) for problem in error.errors()
        )
        raise ConfigError(f"The configuration cannot be used: {problems}.") from error


def _problem(kind: str, place: tuple[int | str, ...], message: str) -> str:
    name = ".".join(str(part) for part in place)
    if kind == "model_type":
        return f"the section {name!r} must hold key: value pairs"
    if kind != "extra_forbidden":
        return f"{name}: {message}"
    section = Config.model_fields.get(str(place[0])) if len(place) > 1 else None
    fields = type(section.default).model_fields if section else Config.model_fields
    near = get_close_matches(str(place[-1]), [str(field) for field in fields], 1)
    meant = f"; did you mean {'.'.join([*(str(part) for part in place[:-1]), near[0]])}?" if near else ""
    return f"there is no parameter {name}{meant} (all of them: configs/default.yaml)"
