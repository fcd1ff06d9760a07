"""Frames that are tracked and held until they can be labelled: at the start, and with look-ahead (§4).

Differs from the paper: its program labels a frame with clusters of four frames later and says nothing of
the first ones. Here every frame gets its labels backwards along the trajectories that pass through it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from mlbs_actors.clustering.label_index import UNLABELLED, label_places
from mlbs_actors.config import TrajectoriesConfig
from mlbs_actors.flow.consistency import DenseFlow
from mlbs_actors.footage.light import unchanged
from mlbs_actors.geometry.interpolation import sample_flow, sample_map
from mlbs_actors.kernels.jit import compiled
from mlbs_actors.messages import BACKGROUND, UNEXPLAINED_STEP, Array, FrameStatus
from mlbs_actors.tracking.camera import camera_evidence
from mlbs_actors.tracking.tracker import Tracked
from mlbs_actors.tracking.trajectories import TrajectoryState

__all__ = ["HeldFrame", "by_layer", "first_frame", "held_frame", "no_picture", "relabelled"]


@dataclass(frozen=True, slots=True)
class HeldFrame:
    """A frame that has been tracked and is held until it can be labelled.

    Attributes
    ----------
    frame_index : int
    ids : (n,) int64
        Trajectories in this frame, ascending.
    positions, motions : (n, 2) float32
    labels : (n,) int64
        The newest known.
    evidence : (n,) float32
        As in :class:`~mlbs_actors.tracking.trajectories.TrajectoryState`.
    camera : (3, 3) float64
    flow : (h, w, 2) float32
    flow_reliable : (h, w) bool
    unexplained : (h, w) uint8
    colours : (h, w, 3) uint8
        As in :class:`~mlbs_actors.messages.FrameEvidence`.
    stage_ms : mapping of str to float
    status : FrameStatus
        Without a picture there is nothing else.
    light : (3, 256) or (0, 256) uint8
        As in :class:`~mlbs_actors.messages.FrameEvidence`.
    fixed : (h, w) or (0, 0) bool
        As in :class:`~mlbs_actors.messages.FrameEvidence`.
    """

    frame_index: int
    ids: Array
    positions: Array
    motions: Array
    labels: Array
    evidence: Array
    camera: Array
    flow: Array
    flow_reliable: Array
    unexplained: Array
    colours: Array
    stage_ms: Mapping[str, float]
    status: FrameStatus
    light: Array
    fixed: Array


def held_frame(
    frame_index: int,
    tracked: Tracked,
    labels: Array,
    flow: DenseFlow | None,
    colours: Array,
    stage_ms: Mapping[str, float],
    status: FrameStatus,
    light: Array,
) -> HeldFrame:
    """Collect what is held of the newest frame; ``flow`` is None in the first of an epoch."""
    trajectories, unexplained = tracked.trajectories, tracked.against_camera.unexplained
    fixed, size = tracked.fixed.cells, unexplained.shape
    if not fixed.any():
        fixed = np.zeros((0, 0), bool)
    reliable = np.zeros(size, bool) if flow is None else flow.backward_reliable
    return HeldFrame(
        frame_index,
        trajectories.ids,
        trajectories.positions,
        trajectories.motions,
        labels,
        trajectories.evidence,
        tracked.camera,
        np.zeros((*size, 2), np.float32) if flow is None else flow.backward,
        reliable & ~fixed if fixed.size else reliable,
        _quantised(unexplained),
        colours,
        stage_ms,
        status,
        light,
        fixed,
    )


def no_picture(frame_index: int, status: FrameStatus) -> HeldFrame:
    """What is kept of a frame that shows nothing new."""
    nowhere = np.zeros((0, 2), np.float32)
    return HeldFrame(
        frame_index,
        np.zeros(0, np.int64),
        nowhere,
        nowhere,
        np.zeros(0, np.int64),
        np.zeros(0, np.float32),
        np.eye(3),
        np.zeros((0, 0, 2), np.float32),
        np.zeros((0, 0), bool),
        np.zeros((0, 0), np.uint8),
        np.zeros((0, 0, 3), np.uint8),
        {},
        status,
        unchanged(),
        np.zeros((0, 0), bool),
    )


def first_frame(
    held: HeldFrame, flow: DenseFlow, gray: Array, following: Array, camera: Array, config: TrajectoriesConfig
) -> HeldFrame:
    """Complete an epoch's first frame, which has none before it, with the motion from the second one.

    Parameters
    ----------
    held : HeldFrame
    flow : DenseFlow
        To the second frame.
    gray, following : (h, w) uint8
        The two frames as the flow sees them.
    camera : (3, 3) float64
        Takes pixels of the second frame to the first.

    Returns
    -------
    HeldFrame
    """
    forwards = np.linalg.inv(camera)
    evidence = camera_evidence(following, gray, forwards, flow.forward, flow.side, config)
    advantage = sample_map(evidence.advantage, held.positions, flow.side)
    return replace(
        held,
        motions=-sample_flow(flow.forward, held.positions, flow.side),
        evidence=np.clip(advantage, config.least_evidence_step, config.most_evidence_step),
        camera=camera,
        flow=-flow.forward,
        flow_reliable=flow.forward_reliable(),
        unexplained=_quantised(evidence.unexplained),
    )


def relabelled(
    frames: Sequence[HeldFrame], trajectories: TrajectoryState, labels: Array
) -> tuple[HeldFrame, ...]:
    """Update the labels of held frames, backwards along the trajectories that still live.

    Parameters
    ----------
    frames : sequence of HeldFrame
    trajectories : TrajectoryState
        The newest.
    labels : (n,) int64
        Theirs.

    Returns
    -------
    tuple of HeldFrame
        A trajectory that has ended keeps the label it had last.
    """
    result = []
    for held in frames:
        place = np.minimum(np.searchsorted(trajectories.ids, held.ids), max(len(trajectories) - 1, 0))
        alive = np.zeros(len(held.ids), bool)
        if len(trajectories):
            alive = trajectories.ids[place] == held.ids
        newest, most = held.labels.copy(), held.evidence.copy()
        newest[alive] = labels[place[alive]]
        most[alive] = np.maximum(most[alive], trajectories.evidence[place[alive]])
        result.append(replace(held, labels=newest, evidence=most))
    return tuple(result)


@compiled
def by_layer(
    live: Array, owner: Array, evidence: Array, least: np.float32, positions: Array, motions: Array
) -> tuple[Array, Array, Array]:
    """Sort positions and motions by layer; return where each of the live layers starts, too, (k + 1).

    Trajectories of no layer, or of an object with less than the least evidence, are left out.
    """
    place, starts = label_places(owner, live), np.zeros(live.size + 1, np.int64)
    for i in range(owner.size):
        if owner[i] == BACKGROUND or (owner[i] != UNLABELLED and evidence[i] >= least):
            starts[place[i] + 1] += 1
        else:
            place[i] = -1
    starts = np.cumsum(starts)
    following = starts.copy()
    there, moved = np.empty((starts[-1], 2), np.float32), np.empty((starts[-1], 2), np.float32)
    for i in range(owner.size):
        if place[i] >= 0:
            at = following[place[i]]
            for axis in range(2):
                there[at, axis], moved[at, axis] = positions[i, axis], motions[i, axis]
            following[place[i]] += 1
    return there, moved, starts


def _quantised(unexplained: Array) -> Array:
    return np.asarray(cv2.convertScaleAbs(unexplained, alpha=1.0 / UNEXPLAINED_STEP))
