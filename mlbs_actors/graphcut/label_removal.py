"""Whether a labelling is better without one of its labels (§7).

No expansion can share out the pixels of a label to several others. This is tried for every label whose cost
and outline together outweigh what its pixels would pay for the cheapest of the others: expansions then start
from there.
"""

from __future__ import annotations

import numpy as np

from mlbs_actors.graphcut.energy import UndecidedEnergy
from mlbs_actors.graphcut.expansion_state import Course
from mlbs_actors.kernels.jit import compiled
from mlbs_actors.messages import Array

__all__ = ["gains_by_removal", "removable_labels", "remove_labels"]


def remove_labels(rest: UndecidedEnergy, course: Course) -> Course:
    """Try to do without each label that has to be paid for, in ascending order.

    Parameters
    ----------
    rest : UndecidedEnergy
    course : Course
        That no expansion lowers.

    Returns
    -------
    Course
        The given one if no removal lowers it.
    """
    if not rest.label_costs.any():
        return course
    removable, used = removable_labels(rest, course)
    for label in range(removable.size):
        if not removable[label]:
            continue
        used[label] = False
        offers = rest.offers
        shared, near = _shared_out(
            offers.first, offers.pixel, offers.cost, rest.neighbour, course.labels, label, used
        )
        used[label] = True
        proposal = Course.starting(rest, shared)
        proposal.expand(rest, np.flatnonzero(near))
        if proposal.energy < course.energy:
            course = proposal
            removable, used = removable_labels(rest, course)
    return course


def removable_labels(rest: UndecidedEnergy, course: Course) -> tuple[Array, Array]:
    """Find the labels that an energy might be lower without.

    Parameters
    ----------
    rest : UndecidedEnergy
    course : Course

    Returns
    -------
    removable : (K,) bool
        Labels whose cost and outline, if saved, could make up for their evidence against the others.
    used : (K,) bool
        Labels in use anywhere in the image.
    """
    used = rest.elsewhere | (course.used > 0)
    offers = rest.offers
    removable: Array = gains_by_removal(
        offers.first,
        offers.pixel,
        offers.cost,
        rest.neighbour,
        rest.weight,
        rest.label_costs,
        course.labels,
        course.chosen,
        used,
    )
    return removable, used


@compiled
def gains_by_removal(
    first: Array, pixel: Array, cost: Array, neighbour: Array, weight: Array, label_costs: Array,
    labels: Array, chosen: Array, used: Array,
) -> Array:  # fmt: skip
    """``removable`` of :func:`removable_labels`, from the fields of its `Offers`, energy and course."""
    least = np.full(labels.size, 2**30, np.int32)
    for label in np.flatnonzero(used):
        for entry in range(first[label], first[label + 1]):
            p = pixel[entry]
            if labels[p] != label:
                least[p] = min(least[p], cost[entry])
    gain = np.where(used & (label_costs > 0), label_costs, 0)
    for p in range(labels.size):
        label = labels[p]
        if label_costs[label] == 0:
            continue
        gain[label] -= np.int64(least[p]) - chosen[p]
        for k in range(8):
            q = neighbour[p, k]
            if q >= 0 and labels[q] != label:
                gain[label] += weight[p, k]
    return gain > 0


@compiled
def _shared_out(
    first: Array, pixel: Array, cost: Array, neighbour: Array, labels: Array, label: int, allowed: Array
) -> tuple[Array, Array]:
    """A labelling where each pixel of one label has the cheapest of some others, the lowest of several; and
    which labels these pixels and those beside them then have."""
    shared, least = labels.copy(), np.full(labels.size, 2**30, np.int32)
    for other in np.flatnonzero(allowed):
        for entry in range(first[other], first[other + 1]):
            p = pixel[entry]
            if labels[p] == label and cost[entry] < least[p]:
                shared[p], least[p] = other, cost[entry]
    near = np.zeros(allowed.size, np.bool_)
    for p in np.flatnonzero(labels == label):
        near[shared[p]] = True
        for k in range(8):
            q = neighbour[p, k]
            if q >= 0:
                near[shared[q]] = True
    return shared, near
