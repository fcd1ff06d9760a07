"""From what layers claim to their labels and what these look like, a group of regions in one function (§7).

Claims that touch are labelled together (:mod:`mlbs_actors.segmentation.region_groups`). They are small, and
many steps lead from the layers' costs to a label map: to hand arrays from one of them to the next by way of
Python took a quarter of a further object's time in the segmenter. What is seldom stays with
:mod:`mlbs_actors.segmentation.segmenter`: a cut that has to be done in the general way, and contact shadows.

Differs from the paper: see :mod:`mlbs_actors.segmentation.segmenter`, :mod:`mlbs_actors.segmentation.shadows`
and :mod:`mlbs_actors.segmentation.cleaning`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mlbs_actors.appearance.fusion import LIKELIHOOD
from mlbs_actors.graphcut.level_cut import label_levels
from mlbs_actors.kernels.jit import compiled
from mlbs_actors.messages import BACKGROUND, Array
from mlbs_actors.segmentation.cleaning import clean_labels
from mlbs_actors.segmentation.contact_shadow import Seen, look_over, nothing_seen
from mlbs_actors.segmentation.contrast import weights_of
from mlbs_actors.segmentation.region_groups import merge_boxes
from mlbs_actors.segmentation.shadows import darkened, likelihood_of_shadow
from mlbs_actors.segmentation.unaries import claimed_costs

__all__ = ["Claims", "CutRules", "Ground", "Tally", "cut_claims", "label_claims", "publish_claims", "tally"]


#: Left, top, width and height, cells of :attr:`Claims.cost`.
Box = tuple[int, int, int, int]
#: Unary costs, pair weights, label costs, extras and places of a
#: :class:`~mlbs_actors.graphcut.energy.LabelCostEnergy` with the claims' cells.
Energy = tuple[Array, Array, Array, Array, Array]
#: The fields of a :class:`~mlbs_actors.segmentation.shadows.Darkening` in these cells; without a row if
#: shadows are not looked for.
Darkness = tuple[Array, Array, Array, Array]


class Claims(NamedTuple):
    """What the layers of a group of regions claim and say; for compiled functions.

    Attributes
    ----------
    cost : (K, h, w) uint8
        Of :class:`~mlbs_actors.appearance.fusion.FusedCosts`.
    normaliser : (h, w) uint8
        Of the same.
    boxes : (K, 4) int64
        Of :func:`~mlbs_actors.segmentation.proposals.claims_of_layers`.
    tracks : (K, 2) int64
        Which trajectories are each layer's: the first one, and the one past the last.
    ids : (K,) uint16
        Of the layers, the background first.
    corner : (x, y)
        Where ``cost`` begins in the frame, cells.
    side : int
        Of a cell, px.
    """

    cost: Array
    normaliser: Array
    boxes: Array
    tracks: Array
    ids: Array
    corner: tuple[int, int]
    side: int


class Tally(NamedTuple):
    """What the labels of each layer look like; for compiled functions, which fill it in.

    Attributes
    ----------
    bounds : (K, 4) int64
        Least x and y and largest x and y, px of the frame; without a meaning for a layer without pixels.
    sums : (K, 3) int64
        Number of its pixels, 0 for the background; sums of their x and y.
    likelihood : (K,) float64
        Sum of their posteriors.
    """

    bounds: Array
    sums: Array
    likelihood: Array

    @classmethod
    def of_nothing(cls, layers: int) -> Tally:
        """What is to be filled in for so many layers."""
        return cls(np.zeros((layers, 4), np.int64), np.zeros((layers, 3), np.int64), np.zeros(layers))


class Ground(NamedTuple):
    """What shadows are told by; for compiled functions.

    Attributes
    ----------
    means : (rows, columns, 3) uint8
        Of the frame's cells.
    weights : (n,) int32
        :func:`~mlbs_actors.segmentation.shadows.blur_weights`.
    colour : (h, w, 4) float32
        :func:`~mlbs_actors.segmentation.shadows.ground_colour`; without a row if shadows are not looked for.
    strength : float32
        What a certain shadow costs an object, ``COST_QUANTUM``.
    """

    means: Array
    weights: Array
    colour: Array
    strength: np.float32


class CutRules(NamedTuple):
    """What holds for all cuts of a stream; for compiled functions.

    Attributes
    ----------
    contrast : (2, n) int32
        :func:`~mlbs_actors.segmentation.contrast.weights_by_distance`.
    label_cost : int
        Of every label but the background's, ``COST_QUANTUM``.
    pull : int
        What a trajectory's own label saves at its pixel, ``COST_QUANTUM``.
    most_cut_whole : tuple of int
    max_sweeps : int
        Of :func:`~mlbs_actors.graphcut.level_cut.label_levels`.
    """

    contrast: Array
    label_cost: int
    pull: int
    most_cut_whole: tuple[int, ...]
    max_sweeps: int


@compiled
def label_claims(
    frame: Array, claims: Claims, positions: Array, ground: Ground, rules: CutRules,
    limits: tuple[float, float], published: Array, tallied: Tally,
) -> tuple[list[tuple[Array, Box, Energy, Darkness]], list[tuple[Array, Box, Seen]]]:  # fmt: skip
    """Label the pixels in boxes around claims that touch, one box after the other.

    Parameters
    ----------
    frame : (H, W, 3) uint8
        C-contiguous.
    claims : Claims
    positions : (n, 2) float32
        Trajectories, px of the frame.
    ground : Ground
    rules : CutRules
    limits : (float, float)
        Components of an object and of the background below these areas are removed, px².
    published : (H, W) uint16
        The label map, filled in in all boxes but those that are not solved.
    tallied : Tally
        Filled in for the layers of the same.

    Returns
    -------
    unsolved : list of (own, box, energy, dark)
        What has to be labelled in the general way, and published then: which layers claim, the background
        first, (k,) int64, a box around their claims, and what :func:`cut_claims` tells of it.
    shady : list of (own, box, seen)
        Where pieces of objects may be contact shadows: the same, and what
        :func:`~mlbs_actors.segmentation.contact_shadow.look_over` has seen in that box of the label map.
    """
    # Lists of nothing, by which Numba knows the types.
    none, plain, nowhere = np.zeros(0, np.int64), np.zeros((0, 0), np.float32), (0, 0, 0, 0)
    no_energy = (
        np.zeros((0, 0, 0), np.int32), np.zeros((0, 0, 0), np.int32), none, np.zeros((0, 4), np.int64),
        np.zeros((0, 4), np.int64),
    )  # fmt: skip
    unsolved = [(none, nowhere, no_energy, (plain, plain, plain, plain)) for _ in range(0)]
    shady = [(none, nowhere, nothing_seen()) for _ in range(0)]
    _, rows, columns = claims.cost.shape
    corners = claims.boxes[1:][:, np.array([2, 0, 3, 1])]
    group = merge_boxes(corners, rows, columns)
    for first in range(group.size):
        if group[first] != first:
            continue
        members = 1 + np.flatnonzero(group == first)
        own = np.zeros(1 + members.size, np.int64)
        own[1:] = members
        left, top, right, bottom = corners[first]
        box = (left, top, right - left, bottom - top)
        labelling, found, energy, dark = cut_claims(frame, claims, own, box, positions, ground, rules)
        if not found:
            unsolved.append((own, box, energy, dark))
            continue
        seen = publish_claims(labelling, claims, own, box, limits, dark, published, tallied)
        if seen[2].size > 0:
            shady.append((own, box, seen))
    return unsolved, shady


@compiled
def cut_claims(
    frame: Array, claims: Claims, own: Array, box: Box, positions: Array, ground: Ground, rules: CutRules
) -> tuple[Array, bool, Energy, Darkness]:
    """Label the pixels in a box around claims.

    Parameters
    ----------
    frame, claims, positions, ground, rules
        Of :func:`label_claims`.
    own, box
        As it returns them.

    Returns
    -------
    labels : (height, width) int16
        Positions among ``own``; without a meaning if they are not found.
    found : bool
        False if this has to be done in the general way.
    energy : Energy
    dark : Darkness
    """
    left, top, width, height = box
    column, row, side = claims.corner[0] + left, claims.corner[1] + top, claims.side
    nothing = np.zeros((0, 0), np.float32)
    dark, shadow = (nothing, nothing, nothing, nothing), nothing
    if ground.colour.shape[0] > 0:
        dark = darkened(ground.means, ground.weights, ground.colour, (column, row, width, height))
        if ground.strength > 0:
            shadow = likelihood_of_shadow(dark[0], dark[1], dark[2], dark[3])
    x, y, shape = column * side, row * side, (frame.shape[0], frame.shape[1])
    costs, places, pulls = claimed_costs(
        claims.cost, own, box, claims.boxes, shadow, ground.strength, positions, claims.tracks, (x, y), shape,
        side, rules.pull,
    )  # fmt: skip
    part = (x, y, min(width * side, shape[1] - x), min(height * side, shape[0] - y))
    weights = weights_of(frame, part, rules.contrast)
    label_costs = np.full(own.size, rules.label_cost)
    label_costs[0] = 0  # the background is always there
    labels, found = label_levels(
        costs, side, pulls, places, weights, label_costs, rules.most_cut_whole, rules.max_sweeps
    )
    return labels, found, (costs, weights, label_costs, pulls, places), dark


@compiled
def publish_claims(
    labelling: Array, claims: Claims, own: Array, box: Box, limits: tuple[float, float],
    dark: Darkness, published: Array, tallied: Tally,
) -> Seen:  # fmt: skip
    """Put labels into the published map, clean them there, and see what has come of them.

    Parameters
    ----------
    labelling, dark
        Of :func:`cut_claims`.
    claims, limits, published, tallied
        Of :func:`label_claims`.
    own, box
        As it returns them.

    Returns
    -------
    tuple
        :func:`~mlbs_actors.segmentation.contact_shadow.look_over` the labels; without a piece if shadows are
        not looked for.
    """
    x, y = (claims.corner[0] + box[0]) * claims.side, (claims.corner[1] + box[1]) * claims.side
    height, width = labelling.shape
    ids = claims.ids[own]
    for v in range(height):
        row, target = labelling[v], published[y + v, x : x + width]
        for u in range(width):
            target[np.uint64(u)] = ids[np.uint64(row[np.uint64(u)])]
    clean_labels(published, (x, y, width, height), limits[0], limits[1])
    labels = published[y : y + height, x : x + width].copy()
    tally(labels, claims, own, box, tallied)
    return look_over(labels, dark[0], dark[1], dark[2], claims.side)


@compiled
def tally(labels: Array, claims: Claims, own: Array, box: Box, tallied: Tally) -> None:
    """Fill in what the labels (height, width) in a box of claims look like, for the layers that claim there
    (``own``) alone; what was filled in for them before is forgotten."""
    left, top, side = box[0], box[1], claims.side
    corner_x, corner_y = (claims.corner[0] + left) * side, (claims.corner[1] + top) * side
    position = np.zeros(claims.ids[own].max() + 1, np.int64)
    for one in own:
        position[claims.ids[one]] = one
        tallied.bounds[one, :2], tallied.bounds[one, 2:] = 2**31, -1
        tallied.sums[one], tallied.likelihood[one] = 0, 0.0
    for v in range(labels.shape[0]):
        row, floor, u, y = labels[v], claims.normaliser[top + v // side, left:], 0, corner_y + v
        while u < row.size:
            label, start = row[u], u
            while u < row.size and row[np.uint64(u)] == label:
                u += 1
            if label == BACKGROUND:
                continue
            one, length, first, last = position[label], u - start, corner_x + start, corner_x + u - 1
            bounds, sums = tallied.bounds[one], tallied.sums[one]
            bounds[0], bounds[1] = min(bounds[0], first), min(bounds[1], y)
            bounds[2], bounds[3] = max(bounds[2], last), y
            sums[0] += length
            sums[1] += (first + last) * length // 2
            sums[2] += y * length
            costs = claims.cost[one, top + v // side, left:]
            likelihood = tallied.likelihood[one]
            for cell in range(start // side, (u - 1) // side + 1):
                pixels = min(u, (cell + 1) * side) - max(start, cell * side)
                likelihood += pixels * LIKELIHOOD[max(np.int64(costs[cell]) - np.int64(floor[cell]), 0)]
            tallied.likelihood[one] = likelihood
