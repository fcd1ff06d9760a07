"""Labels one group of overlapping proposals: unaries, graph cut, cleaning, statistics of each layer (§7).

Proposals (:mod:`mlbs_actors.segmentation.proposals`) that touch are labelled together: an energy of their
cells and pixels, its graph cut, specks and holes, contact shadows.

Differs from the paper: see :mod:`mlbs_actors.segmentation.segmenter`, :mod:`mlbs_actors.segmentation.shadows`
and :mod:`mlbs_actors.segmentation.cleaning`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from time import perf_counter
from typing import NamedTuple

import numpy as np

from mlbs_actors.appearance.fusion import LIKELIHOOD
from mlbs_actors.cells import in_pixels
from mlbs_actors.config import SegmentationConfig, length_scale
from mlbs_actors.geometry.boxes import merge_boxes
from mlbs_actors.graphcut.energy import LabelCostEnergy
from mlbs_actors.graphcut.graph_cut import minimise
from mlbs_actors.kernels.jit import compiled
from mlbs_actors.messages import BACKGROUND, Array, Region
from mlbs_actors.segmentation.cleaning import clean_labels
from mlbs_actors.segmentation.contact_shadow import contact_shadow
from mlbs_actors.segmentation.contrast import COST_QUANTUM, contrast_weights, weights_by_distance
from mlbs_actors.segmentation.shadows import Darkening, darkening, ground_likelihoods
from mlbs_actors.segmentation.unaries import discount_shadows, proposed_costs, track_pulls

__all__ = ["LayerStatistics", "Proposals", "Scene", "label_proposals"]


@dataclass(frozen=True, slots=True)
class Scene:
    """Inputs that all groups of a frame share.

    Attributes
    ----------
    config : SegmentationConfig
    frame : (H, W, 3) uint8
        C-contiguous.
    positions : (n, 2) float32
        Trajectories, px.
    colours : (rows, columns, 3) uint8
        Means of the frame's cells.
    ground : (h, w, 4) float32 or None
        :func:`~mlbs_actors.segmentation.shadows.ground_colour`; None if shadows are not looked for.
    """

    config: SegmentationConfig
    frame: Array
    positions: Array
    colours: Array
    ground: Array | None


class Proposals(NamedTuple):
    """Boxes of cells that the layers of a group may win, and their costs there.

    Attributes
    ----------
    cost : (K, h, w) uint8
        Of :class:`~mlbs_actors.appearance.fusion.FusedCosts`.
    normaliser : (h, w) uint8
        Of the same.
    boxes : (K, 4) int64
        Of :func:`~mlbs_actors.segmentation.proposals.proposal_boxes`.
    tracks : (K, 2) int64
        First trajectory of each layer, and the one past its last.
    ids : (K,) uint16
        Of the layers, the background first.
    label_costs : (K,) float64
        h_k: cost of using each at all, px × nats at 640×480; 0 for the background.
    corner : (x, y)
        Position of ``cost`` in the frame, cells.
    side : int
        Of a cell, px.
    """

    cost: Array
    normaliser: Array
    boxes: Array
    tracks: Array
    ids: Array
    label_costs: Array
    corner: tuple[int, int]
    side: int


class LayerStatistics(NamedTuple):
    """Pixels that each layer has won in a label map.

    Attributes
    ----------
    bounds : (K, 4) int64
        Least x and y and largest x and y, px of the frame; meaningless for a layer without pixels.
    sums : (K, 3) int64
        Number of its pixels, 0 for the background; sums of their x and y.
    likelihood : (K,) float64
        Sum of their posteriors.
    """

    bounds: Array
    sums: Array
    likelihood: Array


def label_proposals(
    scene: Scene, proposals: Proposals, published: Array, stage_ms: dict[str, float]
) -> LayerStatistics:
    """Label the pixels in boxes around proposals that touch, one box after the other.

    Parameters
    ----------
    scene : Scene
    proposals : Proposals
    published : (H, W) uint16
        The label map, filled in here; background elsewhere.
    stage_ms : dict of str to float
        The time is added to "cut" and "cleaning".

    Returns
    -------
    LayerStatistics
        Of the K layers of the proposals.
    """
    config, side, shape = scene.config, proposals.side, published.shape
    scale, count = length_scale(*shape), len(proposals.ids)
    statistics = LayerStatistics(
        np.tile(np.array([2**31, 2**31, -1, -1]), (count, 1)), np.zeros((count, 3), np.int64), np.zeros(count)
    )
    for own, box in _touching(proposals):
        started = perf_counter()
        cells = Region(proposals.corner[0] + box.x, proposals.corner[1] + box.y, box.width, box.height)
        pixels = in_pixels(cells, side, shape)
        dark = None if scene.ground is None else darkening(scene.colours, scene.ground, cells, 1.0 / side)
        labelling = minimise(_energy(scene, proposals, own, box, pixels, dark), config.most_cut_whole)
        published[pixels.slices] = proposals.ids[own][labelling]
        cut = perf_counter()
        clean_labels(
            published,
            pixels.box,
            config.speck_px * scale**2,
            config.hole_px * scale**2,
            _object_tracks(scene.positions, proposals, own),
            config.stray_tracks,
        )
        labels = published[pixels.slices].copy()
        if dark is not None and config.contact_shadow > 0:
            strip = contact_shadow(labels, scene.frame[pixels.slices], dark, side, scale, config)
            labels[strip] = BACKGROUND
            published[pixels.slices] = labels
        _measure(labels, proposals, own, (box.x, box.y), statistics)
        stage_ms["cut"] += 1e3 * (cut - started)
        stage_ms["cleaning"] += 1e3 * (perf_counter() - cut)
    return statistics


def _touching(proposals: Proposals) -> Iterator[tuple[Array, Region]]:
    """Yield layers whose proposals touch, the background first, (k,) int64, and a box around them, in the
    cells of ``cost``."""
    _, rows, columns = proposals.cost.shape
    corners = np.ascontiguousarray(proposals.boxes[1:, [2, 0, 3, 1]])
    group = merge_boxes(corners, rows, columns)
    for first in np.flatnonzero(group == np.arange(group.size)).tolist():
        own = np.concatenate([[0], 1 + np.flatnonzero(group == first)])
        left, top, right, bottom = corners[first].tolist()
        yield own, Region(left, top, right - left, bottom - top)


@compiled
def _object_tracks(positions: Array, proposals: Proposals, own: Array) -> Array:
    """Return row, column and label of the trajectories of some layers but the first, the background."""
    count = 0
    for one in own[1:]:
        count += proposals.tracks[one, 1] - proposals.tracks[one, 0]
    tracks, written = np.empty((count, 3), np.int64), 0
    for one in own[1:]:
        for track in range(proposals.tracks[one, 0], proposals.tracks[one, 1]):
            tracks[written, 0] = np.int64(np.rint(positions[track, 1]))
            tracks[written, 1] = np.int64(np.rint(positions[track, 0]))
            tracks[written, 2] = proposals.ids[one]
            written += 1
    return tracks


def _energy(
    scene: Scene, proposals: Proposals, own: Array, box: Region, pixels: Region, dark: Darkening | None
) -> LabelCostEnergy:
    """Set up the energy of the labellings of a box, in ``COST_QUANTUM``."""
    config, side, shape = scene.config, proposals.side, scene.frame.shape[:2]
    costs, places = proposed_costs(proposals.cost, own, box.box, proposals.boxes)
    if dark is not None and config.shadow > 0:
        shadow, lit = ground_likelihoods(dark, config)
        strength = np.float32(config.shadow / COST_QUANTUM)
        discount_shadows(costs, places, shadow, lit, strength, config.shadow_body)
    pull = round(2.0 * config.track_cost / COST_QUANTUM)
    pulls = track_pulls(
        scene.positions, proposals.tracks[own], places * side, (pixels.x, pixels.y), shape, pull
    )
    contrast = weights_by_distance(config.contrast_strength, config.contrast_scale)
    label_costs = np.rint(proposals.label_costs[own] * (length_scale(*shape) ** 2 / COST_QUANTUM)).astype(
        np.int64
    )
    weights = contrast_weights(scene.frame, pixels.box, contrast)
    return LabelCostEnergy(costs, weights, label_costs, places, side, pulls)


@compiled
def _measure(
    labels: Array, proposals: Proposals, own: Array, corner: tuple[int, int], statistics: LayerStatistics
) -> None:
    """Add the pixels that some layers have won in a box of cells, which begins at a corner of ``cost``."""
    (left, top), side = corner, proposals.side
    corner_x, corner_y = (proposals.corner[0] + left) * side, (proposals.corner[1] + top) * side
    position = np.zeros(proposals.ids[own].max() + 1, np.int64)
    for one in own:
        position[proposals.ids[one]] = one
    for v in range(labels.shape[0]):
        row, floor, u, y = labels[v], proposals.normaliser[top + v // side, left:], 0, corner_y + v
        while u < row.size:
            label, start = row[u], u
            while u < row.size and row[u] == label:
                u += 1
            if label == BACKGROUND:
                continue
            one, length, first, last = position[label], u - start, corner_x + start, corner_x + u - 1
            bounds, sums = statistics.bounds[one], statistics.sums[one]
            bounds[0], bounds[1] = min(bounds[0], first), min(bounds[1], y)
            bounds[2], bounds[3] = max(bounds[2], last), max(bounds[3], y)
            sums[0] += length
            sums[1] += (first + last) * length // 2
            sums[2] += y * length
            costs = proposals.cost[one, top + v // side, left:]
            likelihood = statistics.likelihood[one]
            for cell in range(start // side, (u - 1) // side + 1):
                pixels = min(u, (cell + 1) * side) - max(start, cell * side)
                above = np.int64(costs[cell]) - np.int64(floor[cell])
                likelihood += pixels * LIKELIHOOD[max(above, np.int64(0))]
            statistics.likelihood[one] = likelihood
