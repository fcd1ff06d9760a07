"""From what layers claim to their labels and what these look like: claims that touch, in two functions (§7).

They are small, and many steps lead from the layers' costs to a label map: to hand arrays from one of them to
the next by way of Python took a quarter of a further object's time in the segmenter. What is seldom stays
with :mod:`mlbs_actors.segmenter`: a cut that has to be done in the general way, and contact shadows.

Differs from the paper: see :mod:`mlbs_actors.segmenter`, :mod:`mlbs_actors.shadows` and
:mod:`mlbs_actors.cleaning`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mlbs_actors.cleaning import clean_labels
from mlbs_actors.compilation import compiled
from mlbs_actors.contact_shadow import look_over
from mlbs_actors.contrast import weights_of
from mlbs_actors.data_costs import claimed_costs
from mlbs_actors.fusion import LIKELIHOOD
from mlbs_actors.level_cut import label_levels
from mlbs_actors.messages import BACKGROUND, Array
from mlbs_actors.shadows import darkened, likelihood_of_shadow

__all__ = ["Claimants", "CutRules", "Ground", "cut_claims", "publish_claims", "tally"]


class Claimants(NamedTuple):
    """Layers whose claims touch, and what they say; for compiled functions.

    Attributes
    ----------
    cost : (K, h, w) uint8
        Of :class:`~mlbs_actors.fusion.FusedCosts`, of all layers of a group of regions.
    normaliser : (h, w) uint8
        Of the same.
    claims : (K, 4) int64
        Of :func:`~mlbs_actors.claims.claims_of_layers`.
    tracks : (K, 2) int64
        Which trajectories are each layer's: the first one, and the one past the last.
    own : (k,) int64
        Which of these layers make the claims, the background first.
    box : (left, top, width, height)
        Around their claims, cells of ``cost``.
    corner : (x, y)
        Where ``cost`` begins in the frame, cells.
    side : int
        Of a cell, px.
    """

    cost: Array
    normaliser: Array
    claims: Array
    tracks: Array
    own: Array
    box: tuple[int, int, int, int]
    corner: tuple[int, int]
    side: int


class Ground(NamedTuple):
    """What shadows are told by; for compiled functions.

    Attributes
    ----------
    means : (rows, columns, 3) uint8
        Of the frame's cells.
    weights : (n,) int32
        :func:`~mlbs_actors.shadows.blur_weights`.
    colour : (h, w, 4) float32
        :func:`~mlbs_actors.shadows.ground_colour`; without a row if shadows are not looked for.
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
        :func:`~mlbs_actors.contrast.weights_by_distance`.
    label_cost : int
        Of every label but the background's, ``COST_QUANTUM``.
    pull : int
        What a trajectory's own label saves at its pixel, ``COST_QUANTUM``.
    most_cut_whole : tuple of int
    max_sweeps : int
        Of :func:`~mlbs_actors.level_cut.label_levels`.
    """

    contrast: Array
    label_cost: int
    pull: int
    most_cut_whole: tuple[int, ...]
    max_sweeps: int


@compiled()
def cut_claims(
    frame: Array, claimants: Claimants, positions: Array, ground: Ground, rules: CutRules
) -> tuple[Array, bool, tuple[Array, Array, Array, Array, Array], tuple[Array, Array, Array, Array]]:
    """Label the pixels in a box around claims.

    Parameters
    ----------
    frame : (H, W, 3) uint8
        C-contiguous.
    claimants : Claimants
    positions : (n, 2) float32
        Trajectories, px of the frame.
    ground : Ground
    rules : CutRules

    Returns
    -------
    labels : (height, width) int16
        Positions among the claimants.
    found : bool
        False if this has to be done in the general way.
    energy : (Array, Array, Array, Array, Array)
        Unary costs, pair weights, label costs, extras and places of a
        :class:`~mlbs_actors.label_cost_energy.LabelCostEnergy` with the claimants' cells.
    dark : (Array, Array, Array, Array)
        The fields of a :class:`~mlbs_actors.shadows.Darkening` in these cells; without a row if shadows are
        not looked for.
    """
    left, top, width, height = claimants.box
    column, row, side = claimants.corner[0] + left, claimants.corner[1] + top, claimants.side
    nothing = np.zeros((0, 0), np.float32)
    dark, shadow = (nothing, nothing, nothing, nothing), nothing
    if ground.colour.shape[0] > 0:
        dark = darkened(ground.means, ground.weights, ground.colour, (column, row, width, height))
        if ground.strength > 0:
            shadow = likelihood_of_shadow(dark[0], dark[1], dark[2], dark[3])
    x, y, shape = column * side, row * side, (frame.shape[0], frame.shape[1])
    costs, places, pulls = claimed_costs(
        claimants.cost, claimants.own, claimants.box, claimants.claims, shadow, ground.strength, positions,
        claimants.tracks, (x, y), shape, side, rules.pull,
    )  # fmt: skip
    image = frame[y : min(y + height * side, shape[0]), x : min(x + width * side, shape[1])].copy()
    weights = weights_of(image, rules.contrast)
    label_costs = np.full(claimants.own.size, rules.label_cost)
    label_costs[0] = 0  # the background is always there
    labels, found = label_levels(
        costs, side, pulls, places, weights, label_costs, rules.most_cut_whole, rules.max_sweeps
    )
    return labels, found, (costs, weights, label_costs, pulls, places), dark


@compiled()
def publish_claims(
    ids: Array,
    positions: Array,
    published: Array,
    claimants: Claimants,
    limits: tuple[float, float],
    dark: tuple[Array, Array, Array, Array],
) -> tuple[Array, tuple[Array, tuple[Array, Array, Array, Array], Array], tuple[Array, Array, Array]]:
    """Put labels into the published map, clean them there, and see what has come of them.

    Parameters
    ----------
    ids : (k,) uint16
        Of the claimants.
    positions : (height, width) int16
        Of :func:`cut_claims`.
    published : (H, W) uint16
    claimants : Claimants
    limits : (float, float)
        Components of an object and of the background below these areas are removed, px².
    dark : (Array, Array, Array, Array)
        Of :func:`cut_claims`.

    Returns
    -------
    labels : (height, width) uint16
        What is published in the box.
    seen : tuple
        :func:`~mlbs_actors.contact_shadow.look_over` these; without a piece if shadows are not looked for.
    summary : (Array, Array, Array)
        :func:`tally` of them.
    """
    left, top, _, _ = claimants.box
    x, y = (claimants.corner[0] + left) * claimants.side, (claimants.corner[1] + top) * claimants.side
    height, width = positions.shape
    for v in range(height):
        row, own = positions[v], published[y + v, x : x + width]
        for u in range(width):
            own[u] = ids[row[u]]
    clean_labels(published, (x, y, width, height), limits[0], limits[1])
    labels = published[y : y + height, x : x + width].copy()
    none = np.zeros(0, np.int64)
    seen = (np.zeros((0, 0), np.bool_), (none, none, none, none), np.zeros((0, 5), np.int64))
    if dark[0].size > 0:
        seen = look_over(labels, dark[0], dark[1], dark[2], claimants.side)
    return labels, seen, tally(labels, ids, claimants)


@compiled()
def tally(labels: Array, ids: Array, claimants: Claimants) -> tuple[Array, Array, Array]:
    """What the labels (height, width) of some claimants' box look like.

    Returns
    -------
    bounds : (k, 4) int64
        Least x and y and largest x and y of each id but the background's, px of the box.
    sums : (k, 3) int64
        Number of its pixels, sums of their x and y.
    likelihood : (k,) float64
        Sum of their posteriors.
    """
    left, top, side = claimants.box[0], claimants.box[1], claimants.side
    bounds, sums = np.empty((ids.size, 4), np.int64), np.zeros((ids.size, 3), np.int64)
    bounds[:, :2], bounds[:, 2:] = 2**31, -1
    likelihood = np.zeros(ids.size, np.float64)
    position = np.zeros(ids.max() + 1, np.int64)
    for own in range(ids.size):
        position[ids[own]] = own
    for y in range(labels.shape[0]):
        row, floor, x = labels[y], claimants.normaliser[top + y // side, left:], 0
        while x < row.size:
            label, start = row[x], x
            while x < row.size and row[x] == label:
                x += 1
            if label == BACKGROUND:
                continue
            own, length = position[label], x - start
            bounds[own, 0], bounds[own, 1] = min(bounds[own, 0], start), min(bounds[own, 1], y)
            bounds[own, 2], bounds[own, 3] = max(bounds[own, 2], x - 1), y
            sums[own, 0] += length
            sums[own, 1] += (start + x - 1) * length // 2
            sums[own, 2] += y * length
            costs = claimants.cost[claimants.own[own], top + y // side, left:]
            for cell in range(start // side, (x - 1) // side + 1):
                posterior = LIKELIHOOD[max(np.int64(costs[cell]) - np.int64(floor[cell]), 0)]
                for _ in range(max(start, cell * side), min(x, (cell + 1) * side)):
                    likelihood[own] += posterior
    return bounds, sums, likelihood
