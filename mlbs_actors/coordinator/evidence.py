"""The evidence of a frame that is no longer held: what the layers and the segmenter are sent."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mlbs_actors.clustering.label_index import distinct_labels
from mlbs_actors.clustering.layer_registry import LayerRegistry
from mlbs_actors.config import Config
from mlbs_actors.coordinator.held_frames import HeldFrame, by_layer
from mlbs_actors.coordinator.state import CoordinatorState
from mlbs_actors.messages import BACKGROUND, NO_PICTURE, FrameEvidence, LayerKind, LayerTracks

__all__ = ["frame_evidence", "is_at_rest"]

#: An object rests if less than this share of its trajectories has evidence of motion.
RESTING = 0.5


def frame_evidence(state: CoordinatorState, held: HeldFrame, config: Config) -> FrameEvidence:
    """Decide which layers a held frame has, and which trajectories are theirs.

    Parameters
    ----------
    state : CoordinatorState
        Its layers' last frames are brought up to date.
    held : HeldFrame
        The oldest.

    Returns
    -------
    FrameEvidence
    """
    epoch = state.epoch
    evidence = FrameEvidence(
        frame_index=held.frame_index,
        shape=epoch.shape,
        camera=held.camera,
        flow=held.flow,
        flow_reliable=held.flow_reliable,
        unexplained=held.unexplained,
        colours=held.colours,
        tracks=(),
        positions=held.positions,
        motions=held.motions,
        retired=(),
        latency_frames=state.next_frame - 1 - held.frame_index,
        stage_ms=held.stage_ms,
        # Before the first picture of an epoch there are no labels to carry.
        epoch=epoch.first if epoch.pictures else held.frame_index,
        status=held.status,
        light=held.light,
        fixed=held.fixed,
    )
    if held.status in NO_PICTURE:
        return evidence
    registry = LayerRegistry(config, epoch.shape, epoch.registry)
    owner = registry.layers_of(held.labels)
    live = sorted({BACKGROUND, *distinct_labels(owner), *registry.live_layers(held.frame_index)})
    retired = set(state.evaluated) - set(live)
    if held.frame_index == epoch.first:
        # All models are of another scene or size, the background's too.
        retired, state.evaluated = set(state.evaluated), {}
    # Where the camera's motion explains the image as well, a trajectory is no evidence of an object: flow
    # bleeds from an object over the smooth road beside it. But of an object at rest none is left.
    least = np.float32(config.layers.least_evidence)
    proof = held.evidence.copy()
    for layer in registry.lasting_layers():
        own = owner == layer
        if own.any() and (proof[own] >= least).mean() < RESTING:
            proof[own] = least
    positions, motions, starts = by_layer(np.array(live), owner, proof, least, held.positions, held.motions)
    tracks = []
    for one, start, end in zip(live, starts[:-1].tolist(), starts[1:].tolist(), strict=True):
        kind: LayerKind = (
            "background" if one == BACKGROUND else "other" if one == epoch.registry.other else "object"
        )
        tracks.append(LayerTracks(one, kind, state.evaluated.get(one, -1), start, end))
    state.evaluated = dict.fromkeys(live, held.frame_index)
    return replace(
        evidence,
        tracks=tuple(tracks),
        positions=positions,
        motions=motions,
        retired=tuple(sorted(retired)),
        resting=registry.resting_layers(),
        apart=epoch.repulsion.apart(live, config.identity.apart),
    )


def is_at_rest(state: CoordinatorState, config: Config) -> bool:
    """Whether nothing moves in the last picture: whatever is or may become an object has long rested.

    What has not moved often may still turn out to be a part of the scene, and is looked at on.
    """
    epoch = state.epoch
    if not epoch.clustered:
        return False
    registry = LayerRegistry(config, epoch.shape, epoch.registry)
    at_rest = {BACKGROUND, *(registry.lasting_layers() & set(registry.resting_layers()))}
    return at_rest.issuperset({*state.evaluated, *distinct_labels(epoch.labels)})
