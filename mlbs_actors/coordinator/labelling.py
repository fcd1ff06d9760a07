"""Which trajectory belongs to which layer: one clustering of a stream (§4).

:func:`cluster` goes from the affinities to the labels, step by step: carry the last labels on, split
clusters, judge which move, merge those that do not or that move together, and let the registry decide which
are layers. Each step is explained in its own module.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.sparse as sp

from mlbs_actors.cells import cell_side
from mlbs_actors.clustering.affinity import trajectory_graph
from mlbs_actors.clustering.label_index import UNLABELLED, distinct_labels
from mlbs_actors.clustering.layer_registry import LayerRegistry
from mlbs_actors.clustering.motion_merging import merge_by_motion
from mlbs_actors.clustering.parts import objects_beneath
from mlbs_actors.clustering.reidentification import colours_at
from mlbs_actors.clustering.rigid_scene import scene_evidence
from mlbs_actors.clustering.splitting import (
    background_first,
    background_kept,
    bled_trajectories,
    label_speeds,
    least_object_speed,
    outgrowing,
    propagate_labels,
    residual_speed,
    split_labels,
    split_origins,
)
from mlbs_actors.config import Config, length_scale
from mlbs_actors.coordinator.held_frames import relabelled
from mlbs_actors.coordinator.state import EpochState
from mlbs_actors.messages import BACKGROUND, Array, Segmentation
from mlbs_actors.stages import timed

__all__ = ["cluster", "observe"]


def cluster(
    epoch: EpochState,
    frame_index: int,
    feedback: Callable[[], Segmentation] | None,
    config: Config,
    stage_ms: dict[str, float],
) -> None:
    """Decide the label of every live trajectory, and with it which layers live.

    Parameters
    ----------
    epoch : EpochState
        Its labels, registry and held frames are brought up to date.
    frame_index : int
    feedback : callable or None
        Returns a Segmentation shortly before; called late.
    config : Config
    stage_ms : dict of str to float
    """
    registry = LayerRegistry(config, epoch.shape, epoch.registry)
    with timed(stage_ms, "affinity"):
        missing = config.trajectories.history_frames - len(epoch.spreads)
        spreads = np.concatenate([epoch.spreads, np.full(missing, epoch.spreads[-1])])
        graph = trajectory_graph(epoch.trajectories, spreads, epoch.shape, config.affinity)
        affinity = graph.matrix()
    with timed(stage_ms, "clustering"):
        speed = residual_speed(epoch.trajectories, config.layers.speed_frames)
        split, origins = _split(epoch, registry, affinity, speed, config)
        ages = registry.ages(frame_index)
        speeds = label_speeds(speed, split)
        least = least_object_speed(epoch.trajectories, split, config.layers, length_scale(*epoch.shape))
        relative = {label: one / least for label, one in speeds.items()}
        young = {label for label in speeds if ages.get(label, 0) < config.layers.young_frames}
        scene = scene_evidence(
            epoch.places,
            split,
            registry.known_labels(),
            relative,
            epoch.fixed.cells,
            epoch.shape,
            epoch.focal_length,
            config.layers,
        )
        epoch.focal_length = scene.focal_length
        epoch.static = scene.gathered(epoch.static, split, config.identity)
        odds = scene.odds(epoch.static, split)
        repulsion = epoch.repulsion.gathered(
            graph, split, epoch.trajectories.positions, registry.origins() | origins, config
        )
        young -= registry.parts() | {new for new, origin in origins.items() if origin > BACKGROUND}
        speeds = _judged(epoch, registry, split, young, speeds, least, odds, config)
        registry.judge(speeds, least)
        labels = merge_by_motion(graph, split, ages, speeds, least, config.layers, repulsion)
        gone = set(speeds) - distinct_labels(labels)
        registry.forget({label: int(labels[split == label][0]) for label in gone})
    latest = None if feedback is None else feedback()
    with timed(stage_ms, "clustering"):
        positions, motions = epoch.trajectories.positions, epoch.trajectories.motions
        new = registry.unknown(labels)
        origins |= objects_beneath(new, labels, positions, motions, frame_index, latest)
        # Objects of the first clustering date from the first frame.
        labels = registry.admit(labels, frame_index if epoch.clustered else epoch.first, origins)
        epoch.repulsion = repulsion.renamed(_names(split, labels, registry))
        observe(epoch, registry, labels, frame_index, latest, config)
        probation = config.layers.probation_frames if epoch.clustered else 0
        candidates = epoch.labels
        parted = {
            label
            for label, origin in registry.origins().items()
            if epoch.repulsion.between(label, origin) > config.identity.apart
        }
        epoch.labels = registry.promote(candidates, frame_index, probation, parted)
        epoch.registry = registry.state
        epoch.repulsion = epoch.repulsion.renamed(_names(candidates, epoch.labels, registry))
    epoch.clustered = True
    epoch.held = relabelled(epoch.held, epoch.trajectories, epoch.labels)


def _names(before: Array, after: Array, registry: LayerRegistry) -> dict[int, int]:
    """Map the labels before a step to those after it: where most of the trajectories of each have gone."""
    names = {}
    for label in distinct_labels(before):
        now = after[(before == label) & (after != UNLABELLED)]
        if now.size:
            values, counts = np.unique(now, return_counts=True)
            names[label] = int(values[np.argmax(counts)])
    return names | {label: label for label in registry.state.labels.tolist()}


def observe(
    epoch: EpochState,
    registry: LayerRegistry,
    labels: Array,
    frame_index: int,
    latest: Segmentation | None,
    config: Config,
) -> None:
    """Record in the registry where the labels (n,) int64 are; parameters as of :func:`cluster`."""
    published = [] if latest is None else [one.layer for one in latest.layers]
    positions, motions = epoch.trajectories.positions, epoch.trajectories.motions
    colours = colours_at(epoch.picture.colours, positions, cell_side(epoch.shape, config.grid.cell_px))
    epoch.labels = registry.observe(labels, positions, motions, colours, frame_index, published)
    epoch.registry = registry.state


def _split(
    epoch: EpochState, registry: LayerRegistry, affinity: sp.csr_array, speed: Array, config: Config
) -> tuple[Array, dict[int, int]]:
    """Carry the labels on and split them; return the labels, and from which each new one was split off."""
    scale = length_scale(*epoch.shape)
    spacing = config.trajectories.seed_spacing_px * scale
    bled = bled_trajectories(epoch.trajectories, speed, config.layers, scale)
    if not epoch.clustered:
        labels, _ = split_labels(affinity, np.full(len(bled), UNLABELLED), config.affinity, 0, bled)
        return background_first(labels, epoch.trajectories, scale, spacing), {}
    carried = propagate_labels(affinity, epoch.labels, config.affinity)
    fresh = max(registry.state.next_layer, int(carried.max(initial=0)) + 1)
    labels, firm = split_labels(affinity, carried, config.affinity, fresh, bled, registry.spared_labels())
    registry.spare(firm)
    origins = split_origins(carried, labels)
    parts = {label for label, origin in origins.items() if origin == BACKGROUND}
    return background_kept(labels, parts, epoch.trajectories, scale, spacing), origins


def _judged(
    epoch: EpochState,
    registry: LayerRegistry,
    labels: Array,
    young: set[int],
    speeds: dict[int, float],
    least: float,
    odds: dict[int, float],
    config: Config,
) -> dict[int, float]:
    """Return how fast each label moves by itself, px/frame.

    That is its speed, but 0 for what is more likely static by its log-odds, and at least ``least``, the speed
    of an object, for a label of ``young`` that is not: one that is no part of an object.
    """
    layers = registry.layer_labels()
    static = {
        one for one, weight in odds.items() if weight > (config.layers.scene_odds if one in layers else 0)
    }
    moving = dict.fromkeys(young - static, least)
    if epoch.clustered:
        spacing = config.trajectories.seed_spacing_px * length_scale(*epoch.shape)
        static |= outgrowing(labels, young - layers, epoch.trajectories.positions, spacing, epoch.shape)
    return speeds | moving | dict.fromkeys(static, 0.0)
