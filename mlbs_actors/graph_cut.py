"""Labels of all pixels at once: a multi-label graph cut with label costs (the paper's §7).

Minimises, over label positions l_p ∈ {0 … K−1},

    E(L) = Σ_p U_p(l_p) + Σ_pq w_pq [l_p ≠ l_q] + Σ_k h_k δ_k(L),

pq the 8-neighbour pairs and δ_k(L) = 1 if any pixel has the label k, by α-expansion with label costs (Delong,
Osokin, Isack, Boykov, IJCV 2012), each expansion one minimum cut. Costs stand for nats, so h_k reads
"pixels × nats": the label k must explain its pixels better than the others do by h_k nats in total.

Differs from the paper:

* The pair term is a Potts weight (:mod:`mlbs_actors.contrast`).
* Costs are integers, in units of ``COST_QUANTUM`` = 1/1024 nat: no tolerance anywhere.
* Pixels whose label is the same in every optimum are decided first (``cut_pruning``), only the rest is cut.
* Beside expansions (one label takes pixels), *removals* are tried: a label's pixels are shared out to others.
* The start is label 0 everywhere: every labelling with one more label is one expansion away, and with two
  labels the first one ends in a global optimum. An expansion is tried again only where something has
  changed: the last one was the best there.
* Of more than ``LARGE`` pixels, only those near the outlines of a coarser solution are cut (``coarse_cut``),
  in one sweep.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from mlbs_actors.coarse_cut import band_around_outlines, halved
from mlbs_actors.contrast import MAX_COST
from mlbs_actors.cut_pruning import movable, prune, reachable
from mlbs_actors.errors import ConfigError
from mlbs_actors.expansion import free_expansion, freeing_expansion, paid_expansion, paid_for
from mlbs_actors.label_cost_energy import LabelCostEnergy, Offers, UndecidedEnergy
from mlbs_actors.messages import Array

__all__ = [
    "CutResult",
    "lowest_labels",
    "minimise",
]

_MAX_LABEL_COST = 2**50

#: Images of more pixels are labelled coarse to fine.
LARGE = 16384


@dataclass(frozen=True, slots=True)
class CutResult:
    """A labelling, its energy, and how it was come by.

    Attributes
    ----------
    labels : (H, W) intp
        Label positions.
    energy : int
        E(labels), units of ``COST_QUANTUM``.
    energies : tuple of int
        Energy at the start and after each sweep; never rises.
    sweeps : int
        Rounds of expansions over the labels.
    converged : bool
        No expansion or removal of a label lowers the energy; False if ``max_sweeps`` ended the search, or the
        image is large.
    decided_fraction : float
        Fraction of the pixels that were decided without a cut, in [0, 1].
    """

    labels: Array
    energy: int
    energies: tuple[int, ...]
    sweeps: int
    converged: bool
    decided_fraction: float


def minimise(whole: LabelCostEnergy, *, max_sweeps: int = 10) -> CutResult:
    """Find a labelling that no α-expansion and no removal of a label improves.

    With two labels it is a global optimum. Else no expansion of the whole image lowers it, although only
    undecided pixels are cut (``cut_pruning`` says why), and of those only the parts around which something
    has changed. An image of more than ``LARGE`` pixels is labelled coarse to fine, near to that.

    Parameters
    ----------
    whole : LabelCostEnergy
        In units of ``COST_QUANTUM``: |unary| and weights up to ``MAX_COST``.
    max_sweeps : int
        Upper bound on the rounds of expansions, ≥ 1; two to five are usual.

    Returns
    -------
    CutResult

    Raises
    ------
    ConfigError
        Shapes that do not fit together, costs out of range, ``max_sweeps`` < 1.
    """
    if max_sweeps < 1:
        raise ConfigError(f"max_sweeps is {max_sweeps}; give at least 1.")
    _check(whole)
    labels, trace, converged, decided = _minimise(whole, max_sweeps)
    constant = whole.energy(labels) - trace[-1]
    energies = tuple(constant + value for value in trace)
    return CutResult(labels, energies[-1], energies, len(energies) - 1, converged, decided)


def lowest_labels(whole: LabelCostEnergy, *, max_sweeps: int = 10) -> Array:
    """The labels alone of :func:`minimise`, (H, W) intp, from costs that are known to fit.

    To look at all costs, and to tell the energies, takes time.
    """
    return _minimise(whole, max_sweeps)[0]


def _minimise(whole: LabelCostEnergy, max_sweeps: int) -> tuple[Array, list[int], bool, float]:
    """Labels, energies up to a constant, whether nothing lowers them, and the fraction decided."""
    shape = whole.weights.shape[:2]
    if shape[0] * shape[1] > LARGE:
        band = band_around_outlines(whole, _minimise(halved(whole), max_sweeps)[0])
        labels, rest, start = band.labels, band.rest, band.start
        # The outlines are nearly there: a second sweep over a band would move hardly a pixel.
        max_sweeps = 1
    else:
        pruning = prune(whole.of_pixels())
        labels, rest = pruning.labels, pruning.rest
        start = np.zeros(rest.pixels.size, np.intp)
    undecided_labels, trace, converged = _search(rest, start, max_sweeps)
    labels.reshape(-1)[rest.pixels] = undecided_labels
    return labels, trace, converged, 1.0 - rest.pixels.size / labels.size


def _check(whole: LabelCostEnergy) -> None:
    """Costs that could overflow, or arrays that do not fit together, are refused."""
    unary, weights, label_costs = whole.unary, whole.weights, whole.label_costs
    if unary.ndim != 3 or unary.size == 0:
        raise ConfigError(
            f"Give unary costs of shape (labels ≥ 1, height ≥ 1, width ≥ 1), not {unary.shape}."
        )
    parts = [
        own[top:bottom, left:right]
        for own, (top, bottom, left, right) in zip(unary, whole.boxes(), strict=True)
    ]
    if unary.dtype != np.int32 or any(
        max(-int(part.min()), int(part.max())) > MAX_COST for part in parts if part.size
    ):
        raise ConfigError(f"Give unary costs as int32, none beyond ±{MAX_COST}; clip −log P before the cut.")
    cells = unary.shape[1:]
    if whole.side == 1:
        shape: tuple[int, ...] = (*cells, 4)
    else:
        shape = (*weights.shape[:2], 4)
        if cells != tuple(-(-length // whole.side) for length in shape[:2]):
            raise ConfigError(f"Give unary costs for all cells of {shape[:2]} pixels, not {cells}.")
    if weights.shape != shape or not (weights.min() >= 0 and weights.max() <= MAX_COST):
        raise ConfigError(f"Give pair weights of shape {shape}, each from 0 to {MAX_COST}.")
    outward = (weights[:, -1, 0], weights[-1, :, 1:], weights[:, -1, 2], weights[:, 0, 3])
    if any(part.any() for part in outward):
        raise ConfigError("Give pair weights of 0 where a neighbour would be outside the image.")
    if label_costs.shape != (len(unary),) or not (
        label_costs.min() >= 0 and label_costs.max() <= _MAX_LABEL_COST
    ):
        raise ConfigError(f"Give {len(unary)} label costs, each from 0 to {_MAX_LABEL_COST}.")


@dataclass(slots=True)
class _Course:
    """A labelling on its way down, and when which expansion was tried.

    Attributes
    ----------
    labels : (n,) intp
    chosen : (n,) int32
        What each pixel pays for its label.
    energy : int
    step : int
        How many expansions have changed the labelling.
    changed_at : (n,) int32
        Step that gave each pixel its label; 0 at the start.
    news_at : (n,) int32
        Step that last changed a pixel or a neighbour of it; 0 at the start.
    came_from : (n,) intp
        Label before that step; −1 at the start.
    expanded_at : (K,) int64
        Step after which each label was last expanded; −1 if never.
    offers : Offers
        What each label can ever take (:func:`~mlbs_actors.cut_pruning.reachable`).
    """

    labels: Array
    chosen: Array
    energy: int
    step: int
    changed_at: Array
    news_at: Array
    came_from: Array
    expanded_at: Array
    offers: Offers

    @classmethod
    def starting(cls, rest: UndecidedEnergy, labels: Array) -> _Course:
        count, chosen = labels.size, rest.offers.chosen(labels)
        return cls(
            labels=labels,
            chosen=chosen,
            energy=rest.energy(labels, chosen),
            step=0,
            changed_at=np.zeros(count, np.int32),
            news_at=np.zeros(count, np.int32),
            came_from=np.full(count, -1),
            expanded_at=np.full(rest.label_costs.size, -1),
            offers=reachable(rest, labels),
        )

    def expand(self, rest: UndecidedEnergy, alphas: Array) -> None:
        """One sweep; a label is left out if nothing has changed since its last expansion."""
        turn = 0
        while True:
            turn, self.step, self.energy, nodes, price, kept = _expand_in_turn(
                alphas,
                turn,
                self.offers.first,
                self.offers.pixel,
                self.offers.cost,
                rest.neighbour,
                rest.weight,
                rest.label_costs,
                self.labels,
                self.chosen,
                self.changed_at,
                self.news_at,
                self.came_from,
                self.expanded_at,
                self.step,
                self.energy,
            )
            if turn == alphas.size:
                return
            alpha = alphas[turn]
            moves, change = paid_expansion(rest, self.labels, alpha, nodes, price, kept)
            change += int(_cost_of_use(rest.label_costs, self.labels, alpha))
            if change < 0:
                self.energy += change
                self.step += 1
                _take(
                    rest.neighbour,
                    self.labels,
                    self.chosen,
                    self.changed_at,
                    self.news_at,
                    self.came_from,
                    self.step,
                    alpha,
                    nodes[moves],
                    price[moves],
                )
            self.expanded_at[alpha] = self.step
            turn += 1


@njit(cache=True)
def _expand_in_turn(
    alphas: Array, turn: int, first: Array, pixel: Array, cost: Array, neighbour: Array, weight: Array,
    label_costs: Array, labels: Array, chosen: Array, changed_at: Array, news_at: Array, came_from: Array,
    expanded_at: Array, step: int, energy: int,
) -> tuple[int, int, int, Array, Array, Array]:  # fmt: skip
    """Expand labels until one is due that could free several of their costs: its turn, how the course stands,
    and what :func:`~mlbs_actors.cut_pruning.movable` tells of it."""
    for due in range(turn, alphas.size):
        alpha = alphas[due]
        if expanded_at[alpha] == step:
            continue
        own = slice(first[alpha], first[alpha + 1])
        again = label_costs[alpha] == 0 and expanded_at[alpha] >= 0
        if again and _nothing_new(pixel[own], label_costs, labels, news_at, expanded_at[alpha], alpha):
            expanded_at[alpha] = step
            continue
        nodes, price, kept = movable(
            pixel[own], cost[own], chosen, neighbour, weight, label_costs, labels, alpha
        )
        if again:
            worth = _worth_expanding(
                neighbour,
                label_costs,
                labels,
                changed_at,
                news_at,
                came_from,
                expanded_at[alpha],
                alpha,
                nodes,
            )
            nodes, price = nodes[worth], price[worth]
        paid = paid_for(labels, nodes, kept)
        if paid.size > 1:
            return due, step, energy, nodes, price, kept
        if nodes.size:
            if paid.size:
                moves, change = freeing_expansion(
                    neighbour, weight, labels, alpha, nodes, price, paid[0], label_costs[paid[0]]
                )
            else:
                moves, change = free_expansion(neighbour, weight, labels, alpha, nodes, price)
            change += _cost_of_use(label_costs, labels, alpha)
            if change < 0:
                energy += int(change)
                step += 1
                _take(
                    neighbour,
                    labels,
                    chosen,
                    changed_at,
                    news_at,
                    came_from,
                    step,
                    alpha,
                    nodes[moves],
                    price[moves],
                )
        expanded_at[alpha] = step
    nothing = np.empty(0, np.int64)
    return alphas.size, step, energy, nothing, nothing, label_costs == 0


@njit(cache=True)
def _take(
    neighbour: Array, labels: Array, chosen: Array, changed_at: Array, news_at: Array, came_from: Array,
    step: int, alpha: int, moved: Array, price: Array,
) -> None:  # fmt: skip
    """Give some pixels the label alpha."""
    for i in range(moved.size):
        p = moved[i]
        came_from[p], labels[p] = labels[p], alpha
        chosen[p] += price[i]
        changed_at[p], news_at[p] = step, step
        for k in range(8):
            if neighbour[p, k] >= 0:
                news_at[neighbour[p, k]] = step


@njit(cache=True)
def _cost_of_use(label_costs: Array, labels: Array, alpha: int) -> int:
    """What a label costs that is not used yet."""
    return 0 if label_costs[alpha] == 0 or (labels == alpha).any() else int(label_costs[alpha])


@njit(cache=True)
def _nothing_new(
    candidates: Array, label_costs: Array, labels: Array, news_at: Array, expanded_at: int, alpha: int
) -> bool:
    """Whether all that a label could take is free, and has not changed since its last expansion, nor what is
    beside it."""
    for p in candidates:
        if labels[p] != alpha and (news_at[p] > expanded_at or label_costs[labels[p]] > 0):
            return False
    return True


def _search(rest: UndecidedEnergy, start: Array, max_sweeps: int) -> tuple[Array, list[int], bool]:
    """Expand in turn, then try removals, until nothing helps; also the energy at the start and a sweep."""
    every_label = np.arange(rest.label_costs.size)
    course = _Course.starting(rest, start)
    if not start.any():
        course.expanded_at[0] = 0
    trace = [course.energy]
    for _ in range(max_sweeps):
        course.expand(rest, every_label)
        trace.append(course.energy)
        if (course.expanded_at == course.step).all():
            course = _remove_labels(rest, course)
            if course.energy == trace[-1]:
                return course.labels, trace, True
            trace[-1] = course.energy
    return course.labels, trace, False


def _remove_labels(rest: UndecidedEnergy, course: _Course) -> _Course:
    """Try to do without each label that has to be paid for, in ascending order."""
    for label in np.flatnonzero(rest.used(course.labels) & (rest.label_costs > 0)):
        others = rest.used(course.labels)
        others[label] = False
        if not others.any():
            continue
        shared, near, loss, outline = _shared_out(
            rest.offers.first,
            rest.offers.pixel,
            rest.offers.cost,
            rest.neighbour,
            rest.weight,
            course.labels,
            course.chosen,
            int(label),
            others,
        )
        # Neither its cost nor its outline, if saved, could make up for its evidence.
        if loss >= outline + rest.label_costs[label]:
            continue
        proposal = _Course.starting(rest, shared)
        proposal.expand(rest, np.flatnonzero(near))
        if proposal.energy < course.energy:
            course = proposal
    return course


@njit(cache=True)
def _shared_out(
    first: Array, pixel: Array, cost: Array, neighbour: Array, weight: Array, labels: Array, chosen: Array,
    label: int, allowed: Array,
) -> tuple[Array, Array, int, int]:  # fmt: skip
    """A labelling where each pixel of one label has the cheapest of some others, the lowest of several; which
    labels these pixels and those beside them then have; what they cost more, and what their outline costs."""
    shared, least = labels.copy(), np.full(labels.size, 2**40)
    for other in np.flatnonzero(allowed):
        for entry in range(first[other], first[other + 1]):
            p = pixel[entry]
            if labels[p] == label and cost[entry] < least[p]:
                shared[p], least[p] = other, cost[entry]
    near = np.zeros(allowed.size, np.bool_)
    loss, outline = np.int64(0), np.int64(0)
    for p in range(labels.size):
        if labels[p] != label:
            continue
        loss += least[p] - chosen[p]
        near[shared[p]] = True
        for k in range(8):
            q = neighbour[p, k]
            if q >= 0:
                near[shared[q]] = True
                if labels[q] != label:
                    outline += weight[p, k]
    return shared, near, int(loss), int(outline)


@njit(cache=True)
def _worth_expanding(
    neighbour: Array,
    label_costs: Array,
    labels: Array,
    changed_at: Array,
    news_at: Array,
    came_from: Array,
    expanded_at: int,
    alpha: int,
    nodes: Array,
) -> Array:
    """Nodes (m,) bool whose connected part an expansion of the free label alpha could still improve.

    What an expansion gains is the sum over the connected parts of what it moves, if their labels are free.
    A part gains nothing where no pixel of it or beside it has changed since alpha's last expansion, and
    nothing where the very last change in and around it was to take all of it from alpha: that was a best
    expansion too, which could have left any of it.
    """
    open_node = np.zeros(labels.size, np.bool_)
    open_node[nodes] = True
    worth = np.zeros(labels.size, np.bool_)
    part = np.empty(nodes.size, np.intp)
    for i in range(nodes.size):
        if not open_node[nodes[i]]:
            continue
        open_node[nodes[i]] = False
        part[0] = nodes[i]
        head, tail = 0, 1
        oldest, newest = changed_at[nodes[i]], changed_at[nodes[i]]
        free, from_alpha = True, True
        while head < tail:
            p = part[head]
            head += 1
            oldest = min(oldest, changed_at[p])
            newest = max(newest, news_at[p])
            free = free and label_costs[labels[p]] == 0
            from_alpha = from_alpha and came_from[p] == alpha
            for k in range(8):
                q = neighbour[p, k]
                if q >= 0 and open_node[q]:
                    open_node[q] = False
                    part[tail] = q
                    tail += 1
        if not (free and (newest <= expanded_at or (from_alpha and oldest == newest))):
            worth[part[:tail]] = True
    return worth[nodes]
