"""What is behind a hole in a rigid scene: first how far away it is, then what the sources show there."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from mlbs_actors.messages import Array
from orchestrator.make.background_motion import CELL, continued, to_pixels
from orchestrator.make.background_samples import Sample, at_points, sampled
from orchestrator.make.depth_sweep import swept
from orchestrator.make.holes import Hole
from orchestrator.make.planes import LEAST_POINTS
from orchestrator.make.scene_geometry import RigidScene
from orchestrator.make.source_frames import Source, chosen_sources

__all__ = ["samples_in_scene"]

#: Points further from a hole's region say nothing of it, px of the sketch.
NEAR_PX = 24
#: Pixels of a hole by which its sources are chosen, at most.
LOOKED_AT = 1500
#: Samples of a hole, at which no more are taken for what those before do not show.
SAMPLES = 24
#: Frames after which a source counts for half.
FRAMES = 200


def samples_in_scene(index: int, hole: Hole, scene: RigidScene, sources: Sequence[Source]) -> list[Sample]:
    """Sample the sources that show what is behind a hole of a frame that has a place in the scene.

    Parameters
    ----------
    index : int
        The frame's.
    hole : Hole
    scene : RigidScene
    sources : sequence of Source
        Those that have no place in the scene are left out.

    Returns
    -------
    list of Sample
        Empty if too little is known of the scene there.
    """
    region = hole.region
    corner = np.array([region.x, region.y], np.float32)
    at, inverse = scene.points_of(index)
    end = corner + np.array([region.width, region.height])
    near = np.all((at > corner - NEAR_PX) & (at < end + NEAR_PX), axis=1)
    at, inverse = at[near], inverse[near]
    usable = {one.index: one for one in sources if one.index in scene.numbers and one.index != index}
    if len(at) < LEAST_POINTS or not usable:
        return []
    relations = {other: scene.relation(index, other) for other in usable}
    nearness = {other: 1.0 / (1.0 + abs(other - index) / FRAMES) for other in usable}
    pixels = hole.at + corner

    def chosen(which: Array, depth: Array, left: Sequence[Source]) -> list[Source]:
        some = which[:: max(1, len(which) // LOOKED_AT)]
        places = {one.index: relations[one.index].places(pixels[some], depth[some]) for one in left}
        return chosen_sources(left, {**places, index: pixels[some]}, nearness, index)

    everything = np.arange(len(pixels))
    rough = at_points(_rough(hole, at, inverse), hole.at)
    first = chosen(everything, rough, list(usable.values()))
    if not first:
        return []
    whole = swept(hole, first, [relations[one.index] for one in first], at, inverse)
    depth = at_points(whole, hole.at, cv2.INTER_NEAREST)
    samples: list[Sample] = []
    unseen = np.ones(len(pixels), np.bool_)
    while unseen.any() and len(samples) < SAMPLES:
        more = chosen(everything[unseen], depth, list(usable.values()))
        if not more:
            break
        for one in more:
            del usable[one.index]
            there = relations[one.index].places(hole.pixels(), whole)
            samples.append(sampled(hole, one, there, nearness[one.index]))
            unseen &= samples[-1].weight == 0
    return samples


def _rough(hole: Hole, at: Array, inverse: Array) -> Array:
    """Continue the inverse depths of points over a hole's region, (h, w) float32."""
    region = hole.region
    rows, columns = region.height // CELL, region.width // CELL
    cell = np.floor((at - (region.x, region.y)) / CELL).clip(0, (columns - 1, rows - 1)).astype(int)
    sums = np.zeros((rows, columns, 2), np.float32)
    np.add.at(sums, (cell[:, 1], cell[:, 0]), np.stack([inverse, np.ones(len(at))], axis=1))
    count = sums[..., 1:]
    known = continued(sums[..., :1] / np.maximum(count, 1), np.minimum(count, 1)[..., 0], floor=0.05)
    return to_pixels(known)
