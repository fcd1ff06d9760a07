"""All levels of the graph cut in one compiled function, from an energy to labels (§7).

Groups of claims are small, and each is cut on several levels: handing a dozen arrays from one kernel to the
next by way of Python took a sixth of the time. What seldom happens is left to
:mod:`mlbs_actors.graphcut.graph_cut`, which begins all levels again: one label could be done without on the
coarsest level, or one expansion could free several of their costs on any. Whether a label could be done
without is not asked on the finer levels, by neither way: they have one sweep.
"""

from __future__ import annotations

import numpy as np

from mlbs_actors.graphcut.coarse_cut import costs_of_blocks, of_blocks, opened
from mlbs_actors.graphcut.energy import costs_of_pixels, left_open
from mlbs_actors.graphcut.expansion_state import expand_in_turn, started
from mlbs_actors.graphcut.label_removal import gains_by_removal
from mlbs_actors.graphcut.persistency import decide
from mlbs_actors.kernels.jit import compiled
from mlbs_actors.messages import Array

__all__ = ["is_large", "label_levels"]


@compiled
def is_large(weights: Array, level: int, most_cut_whole: tuple[int, ...]) -> bool:
    """Whether pixels with these pair weights are labelled coarse to fine; level 0 are the image's."""
    most = most_cut_whole[min(level, len(most_cut_whole) - 1)]
    return bool(weights.shape[0] * weights.shape[1] > most)


@compiled
def label_levels(
    unary: Array, side: int, extras: Array, places: Array, weights: Array, label_costs: Array,
    most_cut_whole: tuple[int, ...], max_sweeps: int,
) -> tuple[Array, bool]:  # fmt: skip
    """Label all pixels, coarse to fine if there are many.

    Parameters
    ----------
    unary, side, extras, places, weights, label_costs
        Of a :class:`~mlbs_actors.graphcut.energy.LabelCostEnergy`, ``places`` of all labels.
    most_cut_whole : tuple of int
        Most pixels that are cut without a coarser level, as of :mod:`~mlbs_actors.graphcut.graph_cut`.
    max_sweeps : int
        On the coarsest level; on the others it is one.

    Returns
    -------
    labels : (H, W) int16
    found : bool
        False if this has to be done in the general way.
    """
    none = np.zeros((0, 4), np.int64)
    costs, boxes, rest, cell = unary, places, extras, side
    if side != 2 or not is_large(weights, 0, most_cut_whole):
        costs, boxes = costs_of_pixels(unary, side, extras, places, weights.shape[0], weights.shape[1])
        rest, cell = none, 1
    levels = [(costs, boxes, weights)]
    while is_large(weights, len(levels) - 1, most_cut_whole):
        costs, weights, boxes = costs_of_blocks(costs, cell, rest, boxes, weights)
        rest, cell = none, 1
        levels.append((costs, boxes, weights))
    labels, found = _label_undecided(costs, boxes, weights, label_costs, max_sweeps)
    for level in range(len(levels) - 2, -1, -1):
        costs, boxes, weights = levels[level]
        if level == 0:
            costs, boxes, rest, cell = unary, places, extras, side
        if found:
            labels, found = _label_band(costs, cell, rest, boxes, weights, label_costs, labels)
    return labels, found


@compiled
def _label_band(
    unary: Array, side: int, extras: Array, places: Array, weights: Array, label_costs: Array, blocks: Array
) -> tuple[Array, bool]:
    """Label the pixels near the outlines of blocks (⌈H/2⌉, ⌈W/2⌉), by one sweep; as `label_levels` says."""
    labels, elsewhere = opened(blocks, label_costs.size, weights.shape[0], weights.shape[1])
    pixels, row, offers, neighbour, weight, costs = left_open(
        unary, side, extras, places, weights, label_costs, labels, elsewhere
    )
    start = of_blocks(blocks, pixels, row, labels.shape[1])
    return labels, _search(labels, elsewhere, pixels, offers, neighbour, weight, costs, start, 1)


@compiled
def _label_undecided(
    unary: Array, places: Array, weights: Array, label_costs: Array, max_sweeps: int
) -> tuple[Array, bool]:
    """Label all pixels: those that can be decided at once, and the others by some sweeps; of costs of single
    pixels, as `label_levels` says."""
    labels, certain = decide(unary, places, weights, label_costs)
    extras = np.zeros((0, 4), np.int64)
    pixels, _, offers, neighbour, weight, costs = left_open(
        unary, 1, extras, places, weights, label_costs, labels, certain
    )
    start = np.zeros(pixels.size, np.intp)
    return labels, _search(labels, certain, pixels, offers, neighbour, weight, costs, start, max_sweeps)


@compiled
def _search(
    labels: Array, elsewhere: Array, pixels: Array, offers: tuple[Array, Array, Array], neighbour: Array,
    weight: Array, label_costs: Array, own: Array, max_sweeps: int,
) -> bool:  # fmt: skip
    """Expand in turn until nothing helps, and put the open pixels' labels into the map."""
    first, pixel, cost = offers
    chosen, used, changed_at, news_at, came_from, expanded_at = started(
        first, pixel, cost, label_costs.size, own
    )
    if not own.any():
        expanded_at[0] = 0
    lost_at, alphas, step = np.zeros_like(used), np.arange(used.size), 0
    energy = 0  # from here on; nobody asks for that of the start
    for _ in range(max_sweeps):
        turn, step, energy, _, _, _ = expand_in_turn(
            alphas, 0, first, pixel, cost, neighbour, weight, label_costs, own, chosen, used, lost_at,
            changed_at, news_at, came_from, expanded_at, step, energy,
        )  # fmt: skip
        if turn < alphas.size:
            return False
        if (expanded_at == step).all():
            if (
                label_costs.any()
                and gains_by_removal(
                    first, pixel, cost, neighbour, weight, label_costs, own, chosen, elsewhere | (used > 0)
                ).any()
            ):
                return False
            break
    flat = labels.reshape(-1)
    for i in range(pixels.size):
        flat[pixels[i]] = own[i]
    return True
