"""Graphs made smaller: what is joined belongs together, and cuts cost the same before and after."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from graph_fakes import ncut_value

from mlbs_actors.clustering.graph_coarsening import coarsen
from mlbs_actors.messages import Array


def grid_graph(rows: int, columns: int, border: int, across: float) -> tuple[Array, Array]:
    """Affinities of 8-neighbours in a grid, weak across a vertical border; and the side of each node."""
    rng = np.random.default_rng(3)
    y, x = (axis.ravel() for axis in np.mgrid[:rows, :columns])
    near = np.maximum(abs(y[:, None] - y), abs(x[:, None] - x)) == 1
    side = x < border
    strong = rng.uniform(0.8, 1.0, near.shape)
    affinity = np.triu(np.where(near, np.where(side[:, None] == side, strong, across), 0.0), 1)
    return affinity + affinity.T, side


def coarse(affinity: Array, most: int) -> tuple[Array, Array]:
    edges = sp.csr_array(affinity)
    return coarsen(edges.indptr, edges.indices, edges.data, most)


def test_joined_nodes_sum_their_edges() -> None:
    affinity, _ = grid_graph(12, 15, 6, 0.05)
    group, joined = coarse(affinity, 8)
    member = (group[:, None] == np.arange(len(joined))).astype(float)
    np.testing.assert_allclose(joined, member.T @ affinity @ member)


def test_a_cut_costs_the_same_before_and_after() -> None:
    affinity, _ = grid_graph(12, 15, 6, 0.05)
    group, joined = coarse(affinity, 8)
    for seed in range(10):
        side = np.random.default_rng(seed).random(len(joined)) < 0.5
        np.testing.assert_allclose(ncut_value(joined, side), ncut_value(affinity, side[group]))


def test_nothing_is_joined_across_a_weak_border() -> None:
    affinity, side = grid_graph(20, 30, 11, 0.1)
    group, _ = coarse(affinity, 50)
    for one in np.unique(group):
        assert len(set(side[group == one].tolist())) == 1


def test_much_is_joined_but_no_node_stands_for_more_than_it_may() -> None:
    affinity, _ = grid_graph(20, 30, 11, 0.1)
    group, _ = coarse(affinity, 10)
    sizes = np.bincount(group)
    assert sizes.max() <= 10
    assert len(sizes) < 600 / 4
    untouched, _ = coarse(affinity, 1)
    np.testing.assert_array_equal(untouched, np.arange(600))


def test_a_graph_without_edges_stays_as_it_is() -> None:
    group, joined = coarse(np.zeros((4, 4)), 4)
    assert group.tolist() == [0, 1, 2, 3]
    assert not joined.any()
