"""Labels of all pixels at once: a multi-label graph cut with label costs (the paper's §7).

Minimises, over label positions l_p ∈ {0 … K−1},

    E(L) = Σ_p U_p(l_p) + Σ_pq w_pq [l_p ≠ l_q] + Σ_k h_k δ_k(L),

pq the 8-neighbour pairs and δ_k(L) = 1 if any pixel has the label k, by α-expansion with label costs (Delong,
Osokin, Isack, Boykov, IJCV 2012), each expansion one minimum cut. Costs stand for nats, so h_k reads
"pixels × nats": the label k must explain its pixels better than the others do by h_k nats in total.

Differs from the paper:

* The pair term is a Potts weight (:mod:`mlbs_actors.segmentation.contrast`).
* Costs are integers, in units of ``COST_QUANTUM`` = 1/1024 nat: no tolerance anywhere.
* Pixels whose label is the same in every optimum are decided first (``cut_pruning``), only the rest is cut.
* Beside expansions (one label takes pixels), *removals* are tried: a label's pixels are shared out to others
  (``label_removal``).
* The start is label 0 everywhere: every labelling with one more label is one expansion away, and with two
  labels the first one ends in a global optimum. An expansion is tried again only where something has
  changed: the last one was the best there.
* Of more than some thousand pixels (``MOST_CUT_WHOLE``), only those near the outlines of a coarser solution
  are cut (``coarse_cut``), in one sweep.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mlbs_actors.errors import ConfigError
from mlbs_actors.graphcut.coarse_cut import band_around_outlines, halved
from mlbs_actors.graphcut.energy import LabelCostEnergy, UndecidedEnergy
from mlbs_actors.graphcut.expansion_state import Course
from mlbs_actors.graphcut.label_removal import remove_labels
from mlbs_actors.graphcut.level_cut import is_large, label_levels
from mlbs_actors.graphcut.persistency import prune
from mlbs_actors.messages import Array
from mlbs_actors.segmentation.contrast import MAX_COST

__all__ = [
    "MAX_SWEEPS",
    "MOST_CUT_WHOLE",
    "CutResult",
    "lowest_labels",
    "minimise",
    "searched_labels",
]

_MAX_LABEL_COST = 2**50

#: Most pixels that are cut without a coarser level, by how often they have been halved; the last counts for
#: all further ones. Costs hardly differ within blocks of 2×2 pixels, but legs are thinner than larger ones.
MOST_CUT_WHOLE = (2048, 1024, 9216)
#: Rounds of expansions on the coarsest level; two to five are usual.
MAX_SWEEPS = 10


@dataclass(frozen=True, slots=True)
class CutResult:
    """A labelling, its energy, and how it was come by.

    Attributes
    ----------
    labels : (H, W) int16
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


def minimise(whole: LabelCostEnergy, *, max_sweeps: int = MAX_SWEEPS) -> CutResult:
    """Find a labelling that no α-expansion and no removal of a label improves.

    With two labels it is a global optimum. Else no expansion of the whole image lowers it, although only
    undecided pixels are cut (``cut_pruning`` says why), and of those only the parts around which something
    has changed. An image of more than ``MOST_CUT_WHOLE[0]`` pixels is labelled coarse to fine, near to that.

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


def lowest_labels(whole: LabelCostEnergy, *, max_sweeps: int = MAX_SWEEPS) -> Array:
    """The labels alone of :func:`minimise`, (H, W) int16, from costs that are known to fit.

    To look at all costs, and to tell the energies, takes time.
    """
    labels, found = label_levels(*whole.arrays, MOST_CUT_WHOLE, max_sweeps)
    return labels if found else searched_labels(whole, max_sweeps=max_sweeps)


def searched_labels(whole: LabelCostEnergy, *, max_sweeps: int = MAX_SWEEPS) -> Array:
    """The same where :mod:`mlbs_actors.graphcut.level_cut` leaves it to this module."""
    return _minimise(whole, max_sweeps)[0]


def _minimise(
    whole: LabelCostEnergy, max_sweeps: int, level: int = 0
) -> tuple[Array, list[int], bool, float]:
    """Labels, energies up to a constant, whether nothing lowers them, and the fraction decided."""
    if is_large(whole.weights, level, MOST_CUT_WHOLE):
        band = band_around_outlines(whole, _minimise(halved(whole), max_sweeps, level + 1)[0])
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


def _search(rest: UndecidedEnergy, start: Array, max_sweeps: int) -> tuple[Array, list[int], bool]:
    """Expand in turn, then try removals, until nothing helps; also the energy at the start and a sweep."""
    every_label = np.arange(rest.label_costs.size)
    course = Course.starting(rest, start)
    if not start.any():
        course.expanded_at[0] = 0
    trace = [course.energy]
    for _ in range(max_sweeps):
        course.expand(rest, every_label)
        trace.append(course.energy)
        if (course.expanded_at == course.step).all():
            course = remove_labels(rest, course)
            if course.energy == trace[-1]:
                return course.labels, trace, True
            trace[-1] = course.energy
    return course.labels, trace, False
