"""Energies for the tests of the graph cut, and what they are by plain loops."""

from __future__ import annotations

import itertools

import numpy as np
from read_only import read_only

from mlbs_actors.config import SegmentationConfig
from mlbs_actors.graphcut.energy import NEIGHBOUR_OFFSETS, LabelCostEnergy
from mlbs_actors.messages import Array
from mlbs_actors.segmentation.contrast import COST_QUANTUM, contrast_weights, weights_by_distance

#: Largest unary cost or pair weight: sums of nine still fit into 32 bits.
MOST_WHOLE = SegmentationConfig().most_cut_whole
MAX_COST = 2**24
NO_EXTRAS = np.zeros((0, 4), np.int64)


def energy_of(
    unary: Array,
    weights: Array,
    label_costs: Array,
    side: int = 1,
    extras: Array = NO_EXTRAS,
    places: Array | None = None,
) -> LabelCostEnergy:
    """Where nothing else is said, every label can be everywhere."""
    if places is None:
        places = np.tile(np.array([0, unary.shape[1], 0, unary.shape[2]], np.int64), (len(unary), 1))
    return LabelCostEnergy(unary, weights, label_costs, places, side, extras)


def weights_of_image(image: Array, strength: float = 0.8, scale: float = 200.0) -> Array:
    whole = (0, 0, image.shape[1], image.shape[0])
    weights: Array = contrast_weights(read_only(image), whole, weights_by_distance(strength, scale))
    return weights


def in_quanta(nats: Array | float) -> Array:
    return np.rint(np.asarray(nats) / COST_QUANTUM).astype(np.int32)


def laid_out(right: Array, down: Array, down_right: Array, down_left: Array) -> Array:
    """Weights by pixel and direction, from those of the four kinds of pairs."""
    weights = np.zeros((right.shape[0], down.shape[1], 4), np.int32)
    weights[:, :-1, 0], weights[:-1, :, 1] = right, down
    weights[:-1, :-1, 2], weights[:-1, 1:, 3] = down_right, down_left
    return weights


def problem_of(unary: Array, weights: Array, label_costs: Array) -> LabelCostEnergy:
    """From unary and label costs in nats."""
    return energy_of(in_quanta(unary), weights, in_quanta(label_costs).astype(np.int64))


def random_problem(seed: int, shape: tuple[int, int, int], label_cost: float) -> LabelCostEnergy:
    rng = np.random.default_rng(seed)
    count, height, width = shape
    unary = rng.uniform(0, rng.choice([1.0, 3.0, 8.0]), shape)
    strength = float(rng.choice([0.2, 0.8, 2.0]))
    shapes = ((height, width - 1), (height - 1, width), (height - 1, width - 1), (height - 1, width - 1))
    weights = laid_out(*(in_quanta(rng.uniform(0, strength, one)) for one in shapes))
    return problem_of(unary, weights, rng.uniform(0, label_cost, count))


def pairs(weights: Array) -> list[tuple[tuple[int, int], tuple[int, int], int]]:
    height, width, _ = weights.shape
    found = []
    for (y, x, k), w in np.ndenumerate(weights):
        other = (y + int(NEIGHBOUR_OFFSETS[k, 0]), x + int(NEIGHBOUR_OFFSETS[k, 1]))
        if other[0] < height and 0 <= other[1] < width:
            found.append(((y, x), other, int(w)))
        else:
            assert w == 0
    return found


def slow_energy(labels: Array, problem: LabelCostEnergy) -> int:
    total = sum(int(problem.unary[label, y, x]) for (y, x), label in np.ndenumerate(labels))
    total += sum(w for one, other, w in pairs(problem.weights) if labels[one] != labels[other])
    return total + sum(int(problem.label_costs[label]) for label in set(labels.ravel().tolist()))


def slow_energies(whole: LabelCostEnergy, labellings: Array) -> Array:
    """Of labellings (n, H·W) at once."""
    label_count, height, width = whole.unary.shape
    energies = np.zeros(len(labellings), np.int64)
    for y, x in itertools.product(range(height), range(width)):
        here = labellings[:, y * width + x]
        energies += whole.unary[here, y, x]
        for k, (dy, dx) in enumerate(NEIGHBOUR_OFFSETS):
            if 0 <= y + dy < height and 0 <= x + dx < width and k < 4:
                there = labellings[:, (y + dy) * width + x + dx]
                energies += whole.weights[y, x, k] * (here != there)
    for label in range(label_count):
        energies += whole.label_costs[label] * (labellings == label).any(axis=1)
    return energies


def enumerated_minimum(problem: LabelCostEnergy) -> int:
    count, height, width = problem.unary.shape
    labellings = np.array(list(itertools.product(range(count), repeat=height * width)))
    return int(slow_energies(problem, labellings).min())
