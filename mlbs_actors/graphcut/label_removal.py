"""Removal of labels: whether a labelling is better without one of its labels (§7).

No expansion can distribute the pixels of a label among several others. This is tried for every label whose
cost and outline together exceed the extra cost of its pixels under the cheapest other labels; expansions then
start from there.
"""

from __future__ import annotations

import numpy as np

from mlbs_actors.graphcut.energy import UndecidedEnergy, undecided_energy_of
from mlbs_actors.graphcut.expansion_state import ExpansionState, begin, expand
from mlbs_actors.kernels.jit import compiled
from mlbs_actors.messages import Array

__all__ = ["removable_labels", "remove_labels"]


def remove_labels(rest: UndecidedEnergy, state: ExpansionState) -> tuple[ExpansionState, bool]:
    """Try to remove each label that has a cost, in ascending order.

    Parameters
    ----------
    rest : UndecidedEnergy
    state : ExpansionState
        One that no expansion lowers.

    Returns
    -------
    state : ExpansionState
        The given one if no removal lowers it.
    lowered : bool
    """
    lowered = False
    if not rest.label_costs.any():
        return state, lowered
    removable = removable_labels(rest, state)
    for label in range(removable.size):
        if not removable[label]:
            continue
        shared, near = _shared_out(rest, state, label)
        proposal = begin(rest, shared)
        expand(rest, proposal, np.flatnonzero(near))
        if undecided_energy_of(rest, proposal.labels) < undecided_energy_of(rest, state.labels):
            state, lowered = proposal, True
            removable = removable_labels(rest, state)
    return state, lowered


@compiled
def removable_labels(rest: UndecidedEnergy, state: ExpansionState) -> Array:
    """Find the labels whose removal might lower the energy.

    Returns
    -------
    (K,) bool
        Labels whose cost and outline, if saved, could exceed their advantage over the others.
    """
    unaries, labels, label_costs = rest.unaries, state.labels, rest.label_costs
    least = np.full(labels.size, 2**30, np.int32)
    for label in np.flatnonzero(rest.elsewhere | (state.used > 0)):
        for entry in range(unaries.first[label], unaries.first[label + 1]):
            p = unaries.pixel[entry]
            if labels[p] != label:
                least[p] = min(least[p], unaries.cost[entry])
    gain = np.where(rest.elsewhere | (state.used > 0), label_costs, 0)
    for p in range(labels.size):
        label = labels[p]
        if label_costs[label] == 0:
            continue
        gain[label] -= np.int64(least[p]) - state.chosen[p]
        for k in range(8):
            q = rest.neighbour[p, k]
            if q >= 0 and labels[q] != label:
                gain[label] += rest.weight[p, k]
    return gain > 0


@compiled
def _shared_out(rest: UndecidedEnergy, state: ExpansionState, label: int) -> tuple[Array, Array]:
    """Give each pixel of a label the cheapest of the others in use, the lowest of several; return that
    labelling and which labels these pixels and their neighbours then have."""
    unaries, labels = rest.unaries, state.labels
    shared, least = labels.copy(), np.full(labels.size, 2**30, np.int32)
    for other in np.flatnonzero(rest.elsewhere | (state.used > 0)):
        for entry in range(unaries.first[other], unaries.first[other + 1]):
            p = unaries.pixel[entry]
            if other != label and labels[p] == label and unaries.cost[entry] < least[p]:
                shared[p], least[p] = other, unaries.cost[entry]
    near = np.zeros(state.used.size, np.bool_)
    for p in np.flatnonzero(labels == label):
        near[shared[p]] = True
        for k in range(8):
            q = rest.neighbour[p, k]
            if q >= 0:
                near[shared[q]] = True
    return shared, near
