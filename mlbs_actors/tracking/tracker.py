"""A frame's trajectories: carried along the flow, compared with the camera's motion, and seeded anew (§3).

Differs from the paper, which follows points by the flow alone: the camera's own motion, and where it fails to
explain the image, are found here once a frame, and every trajectory accumulates that as evidence. A camera
that drives has no homography; where an epipolar geometry explains more
(:mod:`mlbs_actors.tracking.epipolar`), that is used.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from mlbs_actors.cells import cell_side
from mlbs_actors.config import Config, length_scale
from mlbs_actors.flow.consistency import DenseFlow
from mlbs_actors.footage.fixed import FixedState, fixed_cells
from mlbs_actors.geometry.homography import homography_motion
from mlbs_actors.geometry.interpolation import sample_map
from mlbs_actors.messages import Array
from mlbs_actors.tracking.camera import CameraEvidence, camera_evidence, camera_homography, explained_share
from mlbs_actors.tracking.density import within_room
from mlbs_actors.tracking.epipolar import forward_motion, static_motion
from mlbs_actors.tracking.rolling_shutter import Swing, swing_of_rows
from mlbs_actors.tracking.seeding import seed_trajectories
from mlbs_actors.tracking.trajectories import (
    TrajectoryState,
    advance_trajectories,
    evenly_spread,
    selected,
    with_residuals,
)

__all__ = ["Tracked", "Transition", "track"]


@dataclass(frozen=True, slots=True)
class Transition:
    """How the frame before becomes the new one.

    Attributes
    ----------
    previous : (h, w) uint8
        The frame before, as the flow sees it.
    flow : DenseFlow
        Between the two.
    """

    previous: Array
    flow: DenseFlow


@dataclass(frozen=True, slots=True)
class Tracked:
    """Trajectories after a frame.

    Attributes
    ----------
    trajectories : TrajectoryState
        At this frame: the survivors, then those that begin in it.
    survivors : (m,) intp
        Indices of the survivors in the arrays of the frame before, ascending.
    camera : (3, 3) float64
        :func:`~mlbs_actors.tracking.camera.camera_homography`, backward.
    swing : Swing or None
        What the rows move beside that.
    against_camera : CameraEvidence
        0 everywhere in a frame without flow, and where the picture is fixed.
    fixed : FixedState
    """

    trajectories: TrajectoryState
    survivors: Array
    camera: Array
    swing: Swing | None
    against_camera: CameraEvidence
    fixed: FixedState


def track(
    before: TrajectoryState,
    background: Array,
    fixed: FixedState,
    transition: Transition | None,
    gray: Array,
    shape: tuple[int, int],
    config: Config,
    follow: Callable[[TrajectoryState], tuple[TrajectoryState, Array]] | None = None,
) -> Tracked:
    """Follow the trajectories into a frame.

    Parameters
    ----------
    before : TrajectoryState
        At the frame before.
    background : (n,) bool
        Which of them determine the camera's motion.
    fixed : FixedState
        Of the frame before; of this one without a transition.
    transition : Transition or None
        None in the first frame.
    gray : (h, w) uint8
        The frame, as the flow sees it.
    shape : (int, int)
        (H, W) of the full frame.
    follow : callable, optional
        Carries the trajectories on in place of the flow and decides which are lost, as
        :func:`~mlbs_actors.tracking.trajectories.follow_trajectories` does.

    Returns
    -------
    Tracked
    """
    scale, settings = length_scale(*shape), config.trajectories
    side = cell_side(shape, config.grid.cell_px)
    spacing = settings.seed_spacing_px * scale
    trajectories, survivors = before, np.arange(len(before))
    if transition is not None:
        trajectories, survivors = (
            advance_trajectories(before, transition.flow, shape) if follow is None else follow(before)
        )
    informative = (trajectories.ages > 0) & background[survivors]
    voters = evenly_spread(trajectories.positions, informative, 2 * spacing)
    places, motions = trajectories.positions[voters], trajectories.motions[voters]
    camera = camera_homography(places, motions, scale, settings)
    explained = explained_share(camera, places, motions, scale, settings)
    planar, swing = explained > settings.most_planar, None
    found = None if planar else swing_of_rows(places, motions, explained, shape[0], scale, settings)
    if found is not None:
        swing, camera = found
    nothing = np.zeros(gray.shape, np.float32)
    against_camera = CameraEvidence(nothing, nothing, np.zeros(gray.shape, np.uint8))
    if transition is not None:
        rows = None if swing is None else swing.at(side * np.arange(gray.shape[0]))
        against_camera = camera_evidence(
            transition.previous, gray, camera, transition.flow.backward, side, settings, rows
        )
        fixed = fixed_cells(fixed, gray, against_camera.difference)
        if fixed.cells.any():
            against_camera = _scene_only(against_camera, fixed.cells)
            covered = sample_map(fixed.cells.astype(np.float32), trajectories.positions, side)
            in_scene = np.flatnonzero(covered < 0.5)
            trajectories, survivors = selected(trajectories, in_scene), survivors[in_scene]
        unexplained, advantage = (
            sample_map(one, trajectories.positions, side)
            for one in (against_camera.unexplained, against_camera.advantage)
        )
        if follow is None:
            mismatch = unexplained - advantage  # of the flow
            same = np.flatnonzero(mismatch <= settings.most_mismatch)
            trajectories, survivors = selected(trajectories, same), survivors[same]
        stays = within_room(
            trajectories.positions, trajectories.ages, settings.history_frames, gray.shape, side,
            settings.square_tracks,
        )  # fmt: skip
        trajectories, survivors = selected(trajectories, stays), survivors[stays]
    flow = None if transition is None else transition.flow
    trajectories = seed_trajectories(
        trajectories, gray, flow, shape, side, settings, against_camera.advantage, fixed.cells
    )
    advantage = sample_map(against_camera.advantage, trajectories.positions, side)
    predicted = homography_motion(camera, trajectories.positions)
    if swing is not None:
        predicted += swing.at(trajectories.positions[:, 1])
    everywhere = evenly_spread(trajectories.positions, trajectories.ages > 0, 2 * spacing)
    driving = None
    if not planar and swing is None:  # else all that the homography does not explain are objects
        driving = forward_motion(
            trajectories.positions[everywhere], trajectories.motions[everywhere], camera, shape, settings
        )
    if driving is not None:
        predicted = static_motion(driving, trajectories.positions, trajectories.motions)
        obeying = np.hypot(*(trajectories.motions - predicted).T) < scale
        advantage = np.where(obeying, 0.0, advantage)
    trajectories = with_residuals(trajectories, predicted, advantage, settings)
    return Tracked(trajectories, survivors, camera, swing, against_camera, fixed)


def _scene_only(evidence: CameraEvidence, fixed: Array) -> CameraEvidence:
    """What is fixed in the picture is no evidence."""
    return replace(
        evidence,
        unexplained=np.where(fixed, np.float32(0), evidence.unexplained),
        advantage=np.where(fixed, np.float32(0), evidence.advantage),
    )
