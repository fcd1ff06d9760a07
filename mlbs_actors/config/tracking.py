"""Parameters of what precedes the clustering: the grid of cells, the flow, the trajectories (§3)."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from mlbs_actors.config.parameters import Parameters

__all__ = ["FlowConfig", "GridConfig", "TrajectoriesConfig"]


class GridConfig(Parameters):
    """The cells of a frame: the one grid of flow, trajectories' evidence, posteriors and colours."""

    cell_px: float = Field(
        2.1,
        gt=0,
        le=24,
        description="Side of the square of pixels that share flow, posterior and samples, px.",
    )


class FlowConfig(Parameters):
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


class TrajectoriesConfig(Parameters):
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
