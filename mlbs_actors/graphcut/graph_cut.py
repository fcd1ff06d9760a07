"""Multi-label graph cut with label costs: labels of all pixels at once (§7).

Minimises, over label positions l_p ∈ {0 … K−1},

    E(L) = Σ_p U_p(l_p) + Σ_pq w_pq [l_p ≠ l_q] + Σ_k h_k δ_k(L),

pq the 8-neighbour pairs and δ_k(L) = 1 if any pixel has the label k, by α-expansion with label costs (Delong,
Osokin, Isack, Boykov, IJCV 2012), each expansion one minimum cut. Costs are in nats, so the unit of h_k is
"pixels × nats": the label k must explain its pixels better than the others do by h_k nats in total.

Differs from the paper:

* The pair term is a Potts weight (:mod:`mlbs_actors.segmentation.contrast`).
* Costs are integers, in units of ``COST_QUANTUM`` = 1/1024 nat: no tolerance anywhere.
* Pixels whose label is the same in every optimum are decided first (``persistency``), only the rest is cut.
* Besides expansions (one label takes pixels), *removals* are tried: a label's pixels are distributed among
  the others (``label_removal``).
* The initial label is 0 everywhere: every labelling with one more label is one expansion away, and with two
  labels the first expansion ends in a global optimum. An expansion is repeated only where something has
  changed: the last one was the best there.
* Above some thousand pixels (``SegmentationConfig.cut_whole``), only those near the outlines of a coarser
  solution are cut (``coarse_cut``), in one sweep.
* PyMaxflow cuts only where an expansion could free several labels of their costs at once
  (``expansion.paid_expansion``), which needs a general graph; ``min_cut`` cuts the pixels' own.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mlbs_actors.graphcut.coarse_cut import band_around_outlines, halved
from mlbs_actors.graphcut.energy import LabelCostEnergy, UndecidedEnergy, energy_of_pixels
from mlbs_actors.graphcut.expansion_state import begin, expand, is_settled
from mlbs_actors.graphcut.label_removal import remove_labels
from mlbs_actors.graphcut.persistency import prune
from mlbs_actors.messages import Array

__all__ = ["minimise"]

#: Rounds of expansions on the coarsest level; two to five are usual.
MAX_SWEEPS = 10


def minimise(whole: LabelCostEnergy, most_cut_whole: Sequence[int]) -> Array:
    """Find a labelling that no α-expansion and no removal of a label improves.

    Up to ``most_cut_whole[0]`` pixels with two labels it is a global optimum; with more labels no expansion
    of the whole image lowers it, although only undecided pixels are cut (``persistency`` says why), and of
    those only the components around which something has changed. A larger image is labelled coarse to fine,
    close to that.

    Parameters
    ----------
    whole : LabelCostEnergy
        Its costs must be in their ranges, which is not checked.
    most_cut_whole : sequence of int
        :attr:`~mlbs_actors.config.SegmentationConfig.most_cut_whole`.

    Returns
    -------
    (H, W) int16
        Label positions.
    """
    height, width = whole.weights.shape[:2]
    if height * width > most_cut_whole[0]:
        blocks = minimise(halved(whole), most_cut_whole[1:] or most_cut_whole)
        labels, rest, start = band_around_outlines(whole, blocks)
        sweeps = 1  # the outlines are nearly there: a second one would move hardly a pixel
    else:
        labels, rest = prune(whole if whole.side == 1 and len(whole.extras) == 0 else energy_of_pixels(whole))
        start, sweeps = np.zeros(rest.pixels.size, np.intp), MAX_SWEEPS
    labels.reshape(-1)[rest.pixels] = _search(rest, start, sweeps)
    return labels


def _search(rest: UndecidedEnergy, start: Array, sweeps: int) -> Array:
    """Expand all labels cyclically, then try removals, until nothing improves."""
    every_label = np.arange(rest.label_costs.size)
    state = begin(rest, start)
    if not start.any():
        state.expanded_at[0] = 0
    for _ in range(sweeps):
        expand(rest, state, every_label)
        if is_settled(state):
            state, lowered = remove_labels(rest, state)
            if not lowered:
                break
    return state.labels
