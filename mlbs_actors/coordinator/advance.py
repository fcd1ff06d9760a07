"""A picture of the scene: what becomes of the trajectories' labels, and when they are clustered."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from mlbs_actors.cells import cell_side
from mlbs_actors.clustering.affinity import displacement_spread
from mlbs_actors.clustering.label_index import UNLABELLED
from mlbs_actors.clustering.layer_registry import LayerRegistry
from mlbs_actors.clustering.two_views import Places
from mlbs_actors.config import Config, LayersConfig, length_scale
from mlbs_actors.coordinator.held_frames import first_frame, held_frame, relabelled
from mlbs_actors.coordinator.labelling import cluster, observe
from mlbs_actors.coordinator.matching import Match
from mlbs_actors.coordinator.state import EpochState, NewFrame
from mlbs_actors.flow.focus import focus_blocks
from mlbs_actors.messages import BACKGROUND, NO_PICTURE, FrameStatus, Segmentation
from mlbs_actors.stages import timed
from mlbs_actors.tracking.tracker import Tracked

__all__ = ["advance", "clustering_due", "follow_on"]


def follow_on(epoch: EpochState, new: NewFrame, match: Match, config: Config) -> None:
    """Make a picture the last one of its epoch: its trajectories carry the labels that they had."""
    tracked = match.tracked
    assert tracked is not None  # in a picture that is taken
    if match.flow is not None and epoch.pictures == 1 and epoch.held:
        _complete_first_frame(epoch, new, match, tracked, config)
    if epoch.pictures == 0:
        epoch.first = new.frame_index
    epoch.pictures, epoch.lost = epoch.pictures + 1, 0
    epoch.picture, epoch.astray = new.picture, match.astray
    if match.whole:
        epoch.view = new.picture
    epoch.fixed = tracked.fixed
    with timed(new.stage_ms, "tracking"):
        trajectories, survivors = tracked.trajectories, tracked.survivors
        labels = np.full(len(trajectories), UNLABELLED, np.int64)
        labels[: len(survivors)] = epoch.labels[survivors]
        static = np.full(len(trajectories), np.nan, np.float32)
        static[: len(survivors)] = epoch.static[survivors]
        epoch.trajectories, epoch.labels, epoch.static = trajectories, labels, static
        spread = displacement_spread(trajectories, config.affinity, length_scale(*epoch.shape))
        epoch.spreads = np.concatenate([[spread], epoch.spreads])[: config.trajectories.history_frames]
        newest, before = Places(trajectories.ids, trajectories.positions), epoch.places
        if tracked.swing is not None:
            before = tuple(one.without(tracked.swing) for one in before)
        epoch.places = (newest, *before)[: config.layers.scene_frames + 1]


def _complete_first_frame(
    epoch: EpochState, new: NewFrame, match: Match, tracked: Tracked, config: Config
) -> None:
    """Give the epoch's first picture, which has none before it, the motion to the second one."""
    assert match.flow is not None  # as in every picture but the first
    place = next(place for place, one in enumerate(epoch.held) if one.status not in NO_PICTURE)
    known = first_frame(
        epoch.held[place], match.flow, match.gray, new.picture.gray, tracked.camera, config.trajectories
    )
    epoch.held = (*epoch.held[:place], known, *epoch.held[place + 1 :])


def clustering_due(epoch: EpochState, frame_index: int, layers: LayersConfig) -> bool:
    """Cluster in every frame at first, while objects separate; later labels are kept for some frames."""
    age = frame_index - epoch.first
    if not epoch.clustered:
        return epoch.pictures >= layers.init_frames
    # A frame in which it was due may have been passed over.
    last = epoch.last_clustering - epoch.first
    return age < 2 * layers.init_frames or age // layers.clustering_period > last // layers.clustering_period


def advance(
    epoch: EpochState,
    new: NewFrame,
    match: Match,
    due: bool,
    feedback: Callable[[], Segmentation] | None,
    config: Config,
) -> None:
    """Label the trajectories of the last picture, and hold it for its evidence.

    Parameters
    ----------
    epoch : EpochState
        Its labels, registry and held frames are brought up to date.
    new : NewFrame
        The picture.
    match : Match
        How it followed the one before.
    due : bool
        Whether trajectories are to be clustered (:func:`clustering_due`).
    feedback : callable or None
        Returns a Segmentation shortly before; called late.
    config : Config
    """
    frame_index, tracked = new.frame_index, match.tracked
    assert tracked is not None  # in a picture that is taken
    carried = epoch.labels
    if due and not match.told and not epoch.clustered:
        # Nothing is known of what moves: all is background until the camera's motion is told.
        epoch.labels, epoch.clustered = np.full(len(epoch.labels), BACKGROUND, np.int64), True
        epoch.held = relabelled(epoch.held, epoch.trajectories, epoch.labels)
    if due and match.told:
        epoch.last_clustering = frame_index
        cluster(epoch, frame_index, feedback, config, new.stage_ms)
    elif epoch.clustered:
        latest = None if feedback is None else feedback()
        with timed(new.stage_ms, "clustering"):
            registry = LayerRegistry(config, epoch.shape, epoch.registry)
            observe(epoch, registry, carried, frame_index, latest, config)
    if epoch.clustered:
        epoch.focus = focus_blocks(
            tracked.against_camera.advantage,
            epoch.trajectories.positions,
            epoch.trajectories.motions,
            epoch.labels > BACKGROUND,
            cell_side(epoch.shape, config.grid.cell_px),
            config.flow,
        )
    status: FrameStatus = "ok" if match.told else "untracked"
    if epoch.pictures == 1:
        status = "cut" if epoch.cut else "ok"
    held = held_frame(
        frame_index, tracked, epoch.labels, match.flow, new.picture.colours, new.stage_ms, status, match.light
    )
    epoch.held = (*epoch.held, held)
