"""Labels of all pixels at once: a multi-label graph cut with label costs (the paper's §7).

Minimises, over label positions l_p ∈ {0 … K−1},

    E(L) = Σ_p U_p(l_p) + Σ_pq w_pq [l_p ≠ l_q] + Σ_k h_k δ_k(L),

pq the 8-neighbour pairs and δ_k(L) = 1 if any pixel has the label k, by α-expansion with label costs (Delong,
Osokin, Isack, Boykov, IJCV 2012), each expansion one minimum cut. All terms are in nats, so h_k reads
"pixels × nats": the label k must explain its pixels better than the others do by h_k nats in total.

Differs from the paper:

* Its pair factor q_ij = ±1 makes the pair term submodular only where its logarithm is positive. Here it is a
  contrast-sensitive Potts weight w ≥ 0, as in the authors' program, with the two diagonal directions divided
  by √2: an outline then costs the same per length along an axis and along a diagonal.
* Costs are rounded to ``COST_QUANTUM`` = 1/1024 nat and cut in integers. Energies are exact multiples of
  it, as floats too: no tolerance anywhere.
* Pixels whose label is the same in every optimum are decided first (``cut_pruning``), only the rest is cut.
* Beside expansions (one label takes pixels), *removals* are tried: a label's pixels are shared out to others.
* The usual star of one node a label cost with thousands of edges makes the Boykov–Kolmogorov algorithm crawl.
  Here the pixels of one image row meet in a row node first; the minimum is the same.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import maxflow
import numpy as np
from numba import njit

from mlbs_actors.cut_pruning import LabelCostEnergy, UndecidedEnergy, movable, neighbour_weights, prune
from mlbs_actors.errors import ConfigError, FrameError
from mlbs_actors.messages import Array

__all__ = [
    "COST_QUANTUM",
    "MAX_COST",
    "CutResult",
    "PairwiseWeights",
    "contrast_weights",
    "energy",
    "minimise",
]

#: Costs are rounded to multiples of this, nats.
COST_QUANTUM = 1.0 / 1024.0

#: Largest unary cost or pair weight, nats: up to it every quantum is exact in float32.
MAX_COST = 2.0**14
_MAX_LABEL_COST = 2.0**40


@dataclass(frozen=True, slots=True)
class PairwiseWeights:
    """Potts weights of the 8-neighbour pairs of an (H, W) image: nats, in [0, ``MAX_COST``].

    Attributes
    ----------
    right, down, down_right : (H, W−1), (H−1, W), (H−1, W−1) float32
        Between (y, x) and (y, x+1), (y+1, x), (y+1, x+1).
    down_left : (H−1, W−1) float32
        Between (y, x+1) and (y+1, x).
    """

    right: Array
    down: Array
    down_right: Array
    down_left: Array


@dataclass(frozen=True, slots=True)
class CutResult:
    """A labelling, its energy, and how it was come by.

    Attributes
    ----------
    labels : (H, W) intp
        Label positions.
    energy : float
        E(labels), nats; an exact multiple of ``COST_QUANTUM``.
    energies : tuple of float
        Energy at the start and after each sweep, nats; never rises.
    sweeps : int
        Rounds of expansions over the labels.
    converged : bool
        No expansion or removal of a label lowers the energy; False if ``max_sweeps`` ended the search.
    decided_fraction : float
        Fraction of the pixels that were decided without a cut, in [0, 1].
    """

    labels: Array
    energy: float
    energies: tuple[float, ...]
    sweeps: int
    converged: bool
    decided_fraction: float


def contrast_weights(image: Array, strength: float = 0.8, scale: float = 200.0) -> PairwiseWeights:
    """Contrast-sensitive Potts weights: strength · exp(−|ΔRGB|² / scale), diagonals divided by √2.

    Parameters
    ----------
    image : (H, W, 3) uint8
        Colour image; the order of the channels does not matter.
    strength : float
        Weight between equal colours, nats, in [0, ``MAX_COST``].
    scale : float
        Squared colour distance, summed over the channels, at which the weight has fallen to 1/e, > 0.

    Returns
    -------
    PairwiseWeights
        Rounded to multiples of ``COST_QUANTUM``.

    Raises
    ------
    FrameError
        The image is not (H, W, 3) uint8.
    ConfigError
        ``strength`` or ``scale`` is out of range.
    """
    if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8 or image.size == 0:
        raise FrameError(f"Give an (H, W, 3) uint8 image; this one is {image.shape} {image.dtype}.")
    if not 0 <= strength <= MAX_COST:
        raise ConfigError(f"The contrast strength is {strength}; give a value from 0 to {MAX_COST:g} nats.")
    if not 0 < scale < math.inf:
        raise ConfigError(f"The contrast scale is {scale}; give a positive number of squared grey levels.")
    # Squared distances are integers; past the one where the weight falls below half a quantum it is 0.
    reach = scale * math.log(max(1.0, 2.0 * strength / COST_QUANTUM))
    weights = strength * np.exp(-np.arange(int(min(reach, 3 * 255**2)) + 1) / scale)
    straight = _quanta(weights) * np.float32(COST_QUANTUM)
    diagonal = _quanta(weights / math.sqrt(2.0)) * np.float32(COST_QUANTUM)
    return PairwiseWeights(
        right=_contrast(image[:, :-1], image[:, 1:], straight),
        down=_contrast(image[:-1], image[1:], straight),
        down_right=_contrast(image[:-1, :-1], image[1:, 1:], diagonal),
        down_left=_contrast(image[:-1, 1:], image[1:, :-1], diagonal),
    )


def energy(labels: Array, unary: Array, weights: PairwiseWeights, label_costs: Array) -> float:
    """E(labels) of the module's equation, with every cost rounded to ``COST_QUANTUM``.

    Parameters
    ----------
    labels : (H, W) int
        Label positions, 0 … K−1.
    unary, weights, label_costs
        As for `minimise`.

    Returns
    -------
    float
        Nats; exact.

    Raises
    ------
    ConfigError
        As for `minimise`.
    """
    whole = _quantised(unary, weights, label_costs)
    return whole.energy(_checked_labels(labels, unary.shape)) * COST_QUANTUM


def minimise(
    unary: Array,
    weights: PairwiseWeights,
    label_costs: Array,
    initial: Array | None = None,
    *,
    max_sweeps: int = 10,
) -> CutResult:
    """Find a labelling that no α-expansion and no removal of a label improves.

    With two labels and no label costs it is a global optimum. Else no expansion of the whole image lowers it,
    although only undecided pixels are cut (``cut_pruning`` says why).

    Parameters
    ----------
    unary : (K, H, W) float or int
        Cost of each label at each pixel, nats, |cost| ≤ ``MAX_COST``; rounded to ``COST_QUANTUM``.
    weights : PairwiseWeights
        Rounded likewise.
    label_costs : (K,) float or int
        h_k ≥ 0, the cost of using the label k at all, nats; rounded likewise.
    initial : (H, W) int, optional
        Label positions to start from, for example the last frame's; ignored where a pixel is decided. Without
        it each pixel starts with its label of least cost, given its decided neighbours.
    max_sweeps : int
        Upper bound on the rounds of expansions, ≥ 1; two to five are usual.

    Returns
    -------
    CutResult

    Raises
    ------
    ConfigError
        Shapes that do not fit together, costs out of range or not finite, ``max_sweeps`` < 1.
    """
    if max_sweeps < 1:
        raise ConfigError(f"max_sweeps is {max_sweeps}; give at least 1.")
    whole = _quantised(unary, weights, label_costs)
    pruning = prune(whole)
    rest = pruning.rest
    start = rest.unary.argmin(axis=0)
    if initial is not None:
        start = _checked_labels(initial, unary.shape).reshape(-1)[rest.pixels]
    undecided_labels, trace, converged = _search(rest, start, max_sweeps)
    labels = pruning.labels.copy()
    labels.reshape(-1)[rest.pixels] = undecided_labels
    constant = whole.energy(labels) - trace[-1]
    energies = tuple((constant + value) * COST_QUANTUM for value in trace)
    decided = 1.0 - rest.pixels.size / labels.size
    return CutResult(labels, energies[-1], energies, len(energies) - 1, converged, decided)


def _quantised(unary: Array, weights: PairwiseWeights, label_costs: Array) -> LabelCostEnergy:
    """The energy in integer quanta, after a look at every cost."""
    if unary.ndim != 3 or unary.size == 0:
        raise ConfigError(
            f"Give unary costs of shape (labels ≥ 1, height ≥ 1, width ≥ 1), not {unary.shape}."
        )
    count, height, width = unary.shape
    if not max(-float(unary.min()), float(unary.max())) <= MAX_COST:
        raise ConfigError(
            f"A unary cost is not finite or beyond ±{MAX_COST:g} nats; clip −log P before the cut."
        )
    directions = (weights.right, weights.down, weights.down_right, weights.down_left)
    shapes = ((height, width - 1), (height - 1, width), (height - 1, width - 1), (height - 1, width - 1))
    for part, shape in zip(directions, shapes, strict=True):
        if part.shape != shape or not (part.min(initial=0) >= 0 and part.max(initial=0) <= MAX_COST):
            raise ConfigError(f"Give pair weights of shape {shape}, each from 0 to {MAX_COST:g} nats.")
    costs = np.asarray(label_costs, np.float64)
    if costs.shape != (count,) or not (costs.min() >= 0 and costs.max() <= _MAX_LABEL_COST):
        raise ConfigError(f"Give {count} label costs, each from 0 to {_MAX_LABEL_COST:g} nats.")
    return LabelCostEnergy(
        _quanta(unary).astype(np.int32),
        neighbour_weights(*(_quanta(part) for part in directions)),
        np.rint(costs / COST_QUANTUM).astype(np.int64),
    )


def _quanta(nats: Array) -> Array:
    quanta: Array = np.asarray(nats, np.float32) / np.float32(COST_QUANTUM)
    return np.rint(quanta, out=quanta)


def _checked_labels(labels: Array, shape: tuple[int, ...]) -> Array:
    if labels.shape != shape[1:] or labels.min() < 0 or labels.max() >= shape[0]:
        raise ConfigError(f"Give labels of shape {shape[1:]} with values 0 … {shape[0] - 1}.")
    return np.ascontiguousarray(labels, np.intp)


def _search(rest: UndecidedEnergy, labels: Array, max_sweeps: int) -> tuple[Array, list[int], bool]:
    """Expand in ascending label order, then try removals, until nothing helps; also the energy a sweep."""
    every_label = range(rest.label_costs.size)
    trace = [rest.energy(labels)]
    settled: set[int] = set()
    for _ in range(max_sweeps):
        labels, lowest = _expand_in_turn(rest, labels, trace[-1], every_label, settled)
        if len(settled) == len(every_label):
            settled.clear()
            labels, value = _remove_labels(rest, labels, lowest)
            if value == lowest:
                return labels, [*trace, lowest], True
            lowest = value
        trace.append(lowest)
    return labels, trace, False


def _expand_in_turn(
    rest: UndecidedEnergy, labels: Array, lowest: int, alphas: Sequence[int], settled: set[int]
) -> tuple[Array, int]:
    """One sweep. ``settled``, the labels known not to help any more, is skipped and kept up to date."""
    for alpha in alphas:
        if alpha in settled:
            continue
        proposal, change = _expansion(rest, labels, alpha)
        if change < 0:
            labels, lowest = proposal, lowest + change
            settled.clear()
        settled.add(alpha)
    return labels, lowest


def _remove_labels(rest: UndecidedEnergy, labels: Array, lowest: int) -> tuple[Array, int]:
    """Try to do without each label that has to be paid for, in ascending order."""
    for label in np.flatnonzero(rest.used(labels) & (rest.label_costs > 0)):
        others = np.setdiff1d(np.flatnonzero(rest.used(labels)), label)
        if others.size == 0:
            continue
        orphans = np.flatnonzero(labels == label)
        offers = rest.unary[np.ix_(others, orphans)]
        loss = int((offers.min(axis=0) - rest.unary[label, orphans]).sum())
        around = rest.neighbour[orphans]
        outline = int(rest.weight[orphans][(around >= 0) & (labels[around] != label)].sum())
        # Neither its cost nor its outline, if saved, could make up for its evidence.
        if loss >= outline + rest.label_costs[label]:
            continue
        proposal = labels.copy()
        proposal[orphans] = others[offers.argmin(axis=0)]
        heirs = np.union1d(proposal[orphans], proposal[around[around >= 0]]).tolist()
        proposal, value = _expand_in_turn(rest, proposal, rest.energy(proposal), heirs, set())
        if value < lowest:
            labels, lowest = proposal, value
    return labels, lowest


def _expansion(rest: UndecidedEnergy, labels: Array, alpha: int) -> tuple[Array, int]:
    """The best labelling in which pixels keep their label or take ``alpha``, and the change of the energy.

    The cost of alpha itself is not in the graph: it is the same for all moves that move anything.
    """
    nodes, kept = movable(rest, labels, alpha)
    if nodes.size == 0:
        return labels, 0
    graph = maxflow.GraphInt(nodes.size, 4 * nodes.size)
    ids = graph.add_grid_nodes((nodes.size,))
    stay, move, ends, capacities = _move_graph(rest.unary, rest.neighbour, rest.weight, labels, alpha, nodes)
    graph.add_grid_tedges(ids, move, stay)
    graph.add_edges(*ends, *capacities)
    unmoved = int(stay.sum())
    for label in np.flatnonzero(~kept & (np.bincount(labels[nodes], minlength=kept.size) > 0)):
        members = np.flatnonzero(labels[nodes] == label)
        _add_label_cost(graph, members, rest.row[nodes[members]], int(rest.label_costs[label]))
        unmoved += int(rest.label_costs[label])
    change = int(graph.maxflow()) - unmoved
    if not rest.used(labels)[alpha]:
        change += int(rest.label_costs[alpha])
    proposal = labels.copy()
    proposal[nodes[graph.get_grid_segments(ids)]] = alpha
    return proposal, change


def _add_label_cost(graph: Any, members: Array, rows: Array, cost: int) -> None:
    """Charge ``cost`` unless all members move to the sink's side: member → row node → hub → sink."""
    distinct, of_member = np.unique(rows, return_inverse=True)
    row_nodes = graph.add_grid_nodes((distinct.size,))
    hub = graph.add_nodes(1)
    for tails, heads in ((members, row_nodes[of_member]), (row_nodes, np.repeat(hub, distinct.size))):
        graph.add_edges(tails, heads, np.full(tails.size, cost), np.zeros(tails.size, np.int64))
    graph.add_tedge(int(hub[0]), 0, cost)


@njit(cache=True)
def _contrast(one: Array, other: Array, table: Array) -> Array:
    """(h, w) weights between two shifted views of an image, by squared colour distance; 0 past the table."""
    height, width, _ = one.shape
    weights = np.zeros((height, width), np.float32)
    for y in range(height):
        for x in range(width):
            distance = np.int64(0)
            for channel in range(3):
                step = np.int64(one[y, x, channel]) - np.int64(other[y, x, channel])
                distance += step * step
            if distance < table.size:
                weights[y, x] = table[distance]
    return weights


@njit(cache=True)
def _move_graph(
    unary: Array, neighbour: Array, weight: Array, labels: Array, alpha: int, nodes: Array
) -> tuple[Array, Array, Array, Array]:
    """Costs to stay and to move, (m,) each, and the edges' ends (2, e) and capacities forth and back (2, e).

    A pair costs w unless both ends move or, if they have the same label, both stay. With the same label it is
    a plain edge; with two labels it is w for p staying, and w for q staying while p moves, a directed edge.
    """
    local = np.full(labels.size, -1, np.intp)
    local[nodes] = np.arange(nodes.size)
    stay, move = np.empty(nodes.size, np.int64), np.empty(nodes.size, np.int64)
    ends, capacities = np.empty((2, 4 * nodes.size), np.int64), np.empty((2, 4 * nodes.size), np.int64)
    edges = 0
    for i in range(nodes.size):
        p = nodes[i]
        stay[i] = unary[labels[p], p]
        move[i] = unary[alpha, p]
        for k in range(8):
            q = neighbour[p, k]
            if q < 0 or (local[q] >= 0 and k >= 4):
                continue
            w = weight[p, k]
            same = labels[q] == labels[p]
            if not same:
                stay[i] += w
            if local[q] >= 0:
                ends[0, edges], ends[1, edges] = i, local[q]
                capacities[0, edges], capacities[1, edges] = (w if same else 0), w
                edges += 1
            elif labels[q] != alpha:
                move[i] += w
    return stay, move, ends[:, :edges], capacities[:, :edges]
