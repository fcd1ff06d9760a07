"""Two things or one: the log-odds that two clusters side by side move as two objects do (§4).

Differs from the paper, whose affinities only attract. A limb bends and turns against its body, so motion
changes hardly faster across the joint than inside the limb. Between two objects it changes in a step, however
small: between two cars, say, one of which slowly overtakes the other. What tells two things from one is
therefore the motion distance across their border *relative to* the one inside them, a ratio without a unit.
The other evidence is the gap between a part and the rest of its object: no limb is farther from its body than
that is large.

Both likelihood ratios were measured (docs/experiments/identity.md). They are gathered clustering by
clustering and fade, so that labels once held apart can still become one.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np

from mlbs_actors.clustering.affinity import TrajectoryGraph
from mlbs_actors.clustering.border_motion import border_motion, inner_motion
from mlbs_actors.clustering.label_index import UNLABELLED, label_classes
from mlbs_actors.config import Config
from mlbs_actors.messages import BACKGROUND, Array

__all__ = ["Repulsion"]


@dataclass(frozen=True, slots=True)
class Repulsion:
    """Log-odds that two labels are two things, one pair in each row.

    Attributes
    ----------
    pairs : (p, 2) int64
        Lower and higher label.
    odds : (p,) float64
        Positive where they are two, nats.
    """

    pairs: Array
    odds: Array

    @staticmethod
    def empty() -> Repulsion:
        """Before the first clustering."""
        return Repulsion(np.zeros((0, 2), np.int64), np.zeros(0))

    def between(self, one: int, other: int) -> float:
        """Return the log-odds that two labels are two things; 0 if nothing is known of them."""
        found = np.flatnonzero((self.pairs == sorted((one, other))).all(axis=1))
        return float(self.odds[found[0]]) if found.size else 0.0

    def apart(self, layers: Collection[int], least: float) -> tuple[tuple[int, int], ...]:
        """Return the pairs of these layers whose log-odds are above ``least``, the lower one first."""
        rows = zip(self.pairs.tolist(), self.odds.tolist(), strict=True)
        return tuple(
            (one, other) for (one, other), odds in rows if odds > least and one in layers and other in layers
        )

    def matrix(self, known: Array) -> Array:
        """Return the log-odds of all pairs of labels ``known`` (k,) int64, ascending: (k, k) float64."""
        odds = np.zeros((known.size, known.size))
        if known.size:
            places = np.minimum(np.searchsorted(known, self.pairs), known.size - 1)
            there = (known[places] == self.pairs).all(axis=1)
            first, second = places[there].T
            odds[first, second] = odds[second, first] = self.odds[there]
        return odds

    def renamed(self, names: Mapping[int, int]) -> Repulsion:
        """Return the log-odds of labels that have new names, without those that have none.

        Parameters
        ----------
        names : mapping of int to int
            Label → new label; of those with the same one the pair of the first remains.
        """
        rows: dict[tuple[int, int], float] = {}
        for (one, other), odds in zip(self.pairs.tolist(), self.odds.tolist(), strict=True):
            if one in names and other in names and names[one] != names[other]:
                first, second = sorted((names[one], names[other]))
                rows.setdefault((first, second), odds)
        pairs = np.array(sorted(rows), np.int64).reshape(-1, 2)
        return Repulsion(pairs, np.array([rows[one, other] for one, other in pairs.tolist()]))

    def gathered(
        self,
        graph: TrajectoryGraph,
        labels: Array,
        positions: Array,
        origins: Mapping[int, int],
        config: Config,
    ) -> Repulsion:
        """Add the evidence of a clustering.

        Parameters
        ----------
        graph : TrajectoryGraph
        labels : (n,) int64
            Label of each trajectory, −1 for none.
        positions : (n, 2) float32
            Of the trajectories, px.
        origins : mapping of int to int
            Label → the object that it was split off or has appeared on.
        config : Config
        """
        settings = config.identity
        known, classes = label_classes(labels, (labels == UNLABELLED) | (labels == BACKGROUND))
        first, second, distance = graph.first, graph.second, graph.motion_distance
        borders, across, edges = border_motion(
            first, second, distance, classes, known.size, config.layers.merge_quantile
        )
        inside = inner_motion(first, second, distance, classes, known.size, settings.inner_quantile)
        evidence: dict[tuple[int, int], float] = {}
        for (one, other), step, count in zip(borders.tolist(), across.tolist(), edges.tolist(), strict=True):
            if count >= config.layers.least_border:
                bending = max(inside[one], inside[other], settings.least_inner)
                ratio = max(step, np.finfo(np.float32).tiny) / (settings.step_ratio * bending)
                evidence[int(known[one]), int(known[other])] = settings.step_slope * math.log(ratio)
        for label, origin in origins.items():
            if label in known and origin in known:
                rest = [
                    origin,
                    *(part for part, whole in origins.items() if whole == origin and part != label),
                ]
                gap = _relative_gap(positions[labels == label], positions[np.isin(labels, rest)])
                far = settings.gap_slope * max(gap - settings.free_gap, 0.0)
                pair = min(label, origin), max(label, origin)
                evidence[pair] = evidence.get(pair, 0.0) + far
        odds = {
            (one, other): settings.fading * value
            for (one, other), value in zip(self.pairs.tolist(), self.odds.tolist(), strict=True)
        }
        for pair, term in evidence.items():
            odds[pair] = odds.get(pair, 0.0) + settings.weight * settings.bounded(term)
        pairs = np.array(sorted(odds), np.int64).reshape(-1, 2)
        return Repulsion(pairs, np.array([odds[one, other] for one, other in pairs.tolist()]))


def _relative_gap(part: Array, rest: Array) -> float:
    """Return the gap between the boxes of two sets of positions, × the root of the larger one's area."""
    larger = part if len(part) > len(rest) else rest
    apart = np.maximum(part.min(axis=0) - rest.max(axis=0), rest.min(axis=0) - part.max(axis=0))
    sides = np.maximum(larger.max(axis=0) - larger.min(axis=0), 1.0)
    return float(np.hypot(*np.maximum(apart, 0.0)) / np.sqrt(sides[0] * sides[1]))
