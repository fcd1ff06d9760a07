"""Frames that have been tracked and wait for their labels: at the start, and with a look-ahead (§4).

Differs from the paper: its program labels a frame with clusters of four frames later and says nothing of
the first ones. Here every frame gets its labels backwards along the trajectories that pass through it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mlbs_actors.messages import Array
from mlbs_actors.trajectories import TrajectoryState

__all__ = ["HeldFrame", "relabelled"]


@dataclass(frozen=True, slots=True)
class HeldFrame:
    """A frame that has been tracked and waits for its labels.

    Attributes
    ----------
    frame_index : int
    ids : (n,) int64
        Trajectories in this frame, ascending.
    positions, motions : (n, 2) float32
    labels : (n,) int64
        As known so far.
    evidence : (n,) float32
        As in :class:`~mlbs_actors.trajectories.TrajectoryState`.
    camera : (3, 3) float64
    flow : (h, w, 2) float16
    flow_reliable : (h, w) bool
    unexplained : (h, w) uint8
        As in :class:`~mlbs_actors.messages.FrameEvidence`.
    stage_ms : mapping of str to float
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
    stage_ms: Mapping[str, float]


def relabelled(
    frames: Sequence[HeldFrame], trajectories: TrajectoryState, labels: Array
) -> tuple[HeldFrame, ...]:
    """Give held frames the newest labels, backwards along the trajectories that still live.

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
