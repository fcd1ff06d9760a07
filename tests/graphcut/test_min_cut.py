"""The minimum cut against enumeration, and against an independent program on larger graphs."""

from __future__ import annotations

import itertools
from typing import Any

import maxflow
import numpy as np
import pytest

from mlbs_actors.graphcut.energy import NEIGHBOUR_OFFSETS
from mlbs_actors.graphcut.min_cut import min_cut
from mlbs_actors.messages import Array

Graph = tuple[Array, Array, Array]


def grid_graph(seed: int, height: int, width: int, most: int) -> Graph:
    """Pixels of a grid with some edges of no capacity; if it is small, ties are frequent."""
    rng = np.random.default_rng(seed)
    neighbour = np.full((height, width, 8), -1, np.int32)
    position = np.arange(height * width).reshape(height, width)
    capacity = rng.integers(0, most, neighbour.shape) * (rng.random(neighbour.shape) < 0.7)
    for y, x in np.ndindex(height, width):
        for k, (dy, dx) in enumerate(NEIGHBOUR_OFFSETS):
            if 0 <= y + dy < height and 0 <= x + dx < width:
                neighbour[y, x, k] = position[y + dy, x + dx]
    capacity[neighbour < 0] = 0
    surplus = rng.integers(-2 * most, 2 * most + 1, height * width)
    return surplus.astype(np.int32), neighbour.reshape(-1, 8), capacity.reshape(-1, 8).astype(np.int32)


def weight(graph: Graph, on_sink_side: Array) -> int:
    surplus, neighbour, capacity = graph
    crossing = (neighbour >= 0) & ~on_sink_side[:, None] & on_sink_side[neighbour]
    terminals = np.maximum(surplus, 0)[on_sink_side].sum() + np.maximum(-surplus, 0)[~on_sink_side].sum()
    return int(terminals + capacity[crossing].sum())


def cut(graph: Graph) -> tuple[int, Array]:
    surplus, neighbour, capacity = graph
    flow, on_sink_side = min_cut(surplus.copy(), neighbour, capacity.copy())
    return int(flow), on_sink_side


@pytest.mark.parametrize("shape", [(3, 3), (1, 9), (2, 5)])
def test_the_cut_is_the_smallest_of_all_and_its_sink_side_the_smallest_of_those(
    shape: tuple[int, int],
) -> None:
    for seed in range(20):
        graph = grid_graph(seed, *shape, 6)
        flow, on_sink_side = cut(graph)
        sides = [np.array(side) for side in itertools.product([False, True], repeat=shape[0] * shape[1])]
        weights = [weight(graph, side) for side in sides]
        assert flow == min(weights)
        best = [side for side, one in zip(sides, weights, strict=True) if one == flow]
        np.testing.assert_array_equal(on_sink_side, np.all(best, axis=0))


@pytest.mark.parametrize("most", [3, 1000])
def test_larger_graphs_are_cut_as_by_an_independent_program(most: int) -> None:
    for seed in range(8):
        graph = grid_graph(seed, 40, 50, most)
        surplus, neighbour, capacity = graph
        other: Any = maxflow.GraphInt(surplus.size, 4 * surplus.size)
        nodes = other.add_grid_nodes((surplus.size,))
        other.add_grid_tedges(nodes, np.maximum(surplus, 0), np.maximum(-surplus, 0))
        for k in range(4):
            tails = np.flatnonzero(neighbour[:, k] >= 0)
            heads = neighbour[tails, k]
            other.add_edges(tails, heads, capacity[tails, k], capacity[heads, k + 4])
        flow, on_sink_side = cut(graph)
        assert flow == other.maxflow() == weight(graph, on_sink_side)
        np.testing.assert_array_equal(on_sink_side, other.get_grid_segments(nodes))
        assert 0 < on_sink_side.mean() < 1


def test_pixels_without_neighbours_decide_for_themselves() -> None:
    surplus = np.array([2, -2, 0], np.int32)
    flow, side = min_cut(surplus, np.full((3, 8), -1, np.int32), np.zeros((3, 8), np.int32))
    assert flow == 0
    assert side.tolist() == [False, True, False]
