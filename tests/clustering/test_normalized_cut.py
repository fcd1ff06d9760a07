"""Normalised cuts against dense loops, exhaustive enumeration and graphs whose clusters are known."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
import scipy.linalg
import scipy.sparse as sp
from graph_fakes import ncut_value
from scipy.sparse.csgraph import connected_components

from mlbs_actors.clustering import normalized_cut
from mlbs_actors.clustering.graph_coarsening import coarsen
from mlbs_actors.clustering.normalized_cut import (
    EXACT_NODES,
    NO_EDGE,
    ROUNDING,
    TwoWayCut,
    best_cut,
    holds_together,
    recursive_cut,
)
from mlbs_actors.messages import Array


def clusters_of(*given: object, **named: object) -> Array:
    """The clusters that :func:`recursive_cut` finds."""
    return recursive_cut(*given, **named)[0]  # type: ignore[arg-type]


def random_graph(nodes: int, seed: int, density: float = 0.6) -> Array:
    """Dense symmetric affinities of a connected graph."""
    rng = np.random.default_rng(seed)
    upper = np.triu(rng.uniform(0.05, 1.0, (nodes, nodes)) * (rng.random((nodes, nodes)) < density), 1)
    upper[np.arange(nodes - 1), np.arange(1, nodes)] = rng.uniform(0.05, 1.0, nodes - 1)
    return np.asarray(upper + upper.T)


def block_graph(sizes: list[int], between: float, seed: int = 0) -> tuple[Array, Array]:
    """Strong affinities inside blocks, weak ones between successive blocks; nodes in random order.

    Returns the affinities and the block of each node.
    """
    rng = np.random.default_rng(seed)
    block = np.repeat(np.arange(len(sizes)), sizes)
    affinity = np.where(block[:, None] == block[None, :], rng.uniform(0.5, 1.0, (len(block),) * 2), 0.0)
    affinity[np.abs(block[:, None] - block[None, :]) == 1] = between
    affinity = np.triu(affinity, 1)
    order = rng.permutation(len(block))
    return (affinity + affinity.T)[np.ix_(order, order)], block[order]


def neighbour_graph(points: Array, reach: float) -> Array:
    """Affinities of points that are near each other, as trajectories have them."""
    gaps = np.linalg.norm(points[:, None] - points[None, :], axis=2)
    affinity = np.where(gaps < reach, np.exp(-((gaps / reach) ** 2)), 0.0)
    np.fill_diagonal(affinity, 0.0)
    return affinity


def two_clouds(nodes: int, seed: int = 0) -> Array:
    """Two clouds of points that touch."""
    rng = np.random.default_rng(seed)
    half = nodes // 2
    return np.concatenate([rng.normal((-2.2, 0), 1, (half, 2)), rng.normal((2.2, 0), 1, (nodes - half, 2))])


def exhaustive_ncut(affinity: Array, min_side: int) -> float:
    nodes = len(affinity)
    values = []
    for bits in product((False, True), repeat=nodes - 1):
        side = np.array((False, *bits))
        if min_side <= side.sum() <= nodes - min_side:
            values.append(ncut_value(affinity, side))
    return min(values)


def thresholded_ncut(affinity: Array, min_side: int, vectors: int = 3) -> float:
    """The best N-cut over every threshold of the generalised eigenvectors of (D − A) v = λ D v."""
    nodes = len(affinity)
    degree = np.diag(affinity.sum(axis=1))
    _, eigenvectors = scipy.linalg.eigh(degree - affinity, degree)
    values = []
    for vector in eigenvectors.T[1 : 1 + vectors]:
        order = np.argsort(vector)
        for count in range(min_side, nodes - min_side + 1):
            side = np.zeros(nodes, bool)
            side[order[:count]] = True
            values.append(ncut_value(affinity, side))
    return min(values)


def single_nodes_cut(affinity: Array, min_side: int) -> TwoWayCut:
    return best_cut(affinity, np.ones(len(affinity), np.int64), min_side)


@pytest.mark.parametrize("min_side", [2, 3])
def test_the_best_cut_is_never_better_than_the_true_optimum_and_is_what_it_says(min_side: int) -> None:
    for seed in range(8):
        affinity = random_graph(9, seed)
        cut = single_nodes_cut(affinity, min_side)
        assert cut.value == pytest.approx(ncut_value(affinity, cut.side))
        assert min_side <= cut.side.sum() <= 9 - min_side
        assert cut.value >= exhaustive_ncut(affinity, min_side) - 1e-9
        assert cut.value <= thresholded_ncut(affinity, min_side) + 1e-9


def test_the_best_cut_of_two_blocks_is_the_true_optimum() -> None:
    for seed in range(6):
        affinity, block = block_graph([6, 5], between=0.02, seed=seed)
        cut = single_nodes_cut(affinity, 2)
        assert cut.value == pytest.approx(exhaustive_ncut(affinity, 2))
        assert set(cut.side[block == 0].tolist()) | set(cut.side[block == 1].tolist()) == {True, False}
        assert len(set(cut.side[block == 0].tolist())) == len(set(cut.side[block == 1].tolist())) == 1


@pytest.mark.parametrize("nodes", [EXACT_NODES - 8, 480])
def test_small_and_large_clusters_are_cut_where_the_dense_eigenvectors_say(nodes: int) -> None:
    points = two_clouds(nodes)
    affinity = neighbour_graph(points, 1.5)
    best = thresholded_ncut(affinity, 5)
    labels = clusters_of(sp.csr_array(affinity), 1.1 * best, 5)
    assert labels.max() == 1
    assert ncut_value(affinity, labels == 0) <= 1.1 * best
    left = points[:, 0] < 0
    assert max(((labels == 0) == left).mean(), ((labels == 0) != left).mean()) > 0.95


def test_a_node_that_stands_for_many_counts_as_many() -> None:
    affinity, _ = block_graph([4, 4], between=1e-3)
    cut = best_cut(affinity, np.full(8, 3), 12)
    assert cut.value == pytest.approx(exhaustive_ncut(affinity, 4))
    assert best_cut(affinity, np.full(8, 3), 13).value == float("inf")


def test_what_is_to_be_kept_apart_is_never_in_one_cluster() -> None:
    affinity, _ = block_graph([60], between=0.0)
    apart = np.repeat([0, 1, -1], [20, 30, 10])
    labels = clusters_of(sp.csr_array(affinity), 1e-2, 5, apart)
    np.testing.assert_array_equal(labels, np.repeat([1, 0, -1], [20, 30, 10]))


def test_the_cut_keeps_the_least_size_of_a_side() -> None:
    affinity, _ = block_graph([20, 3], between=1e-3)
    free = single_nodes_cut(affinity, 2)
    bound = single_nodes_cut(affinity, 8)
    assert min(free.side.sum(), (~free.side).sum()) == 3
    assert min(bound.side.sum(), (~bound.side).sum()) >= 8
    assert free.value < bound.value


@pytest.mark.parametrize("nodes", [1, 2, 3, 5])
def test_a_cluster_too_small_for_two_sides_is_not_cut(nodes: int) -> None:
    assert single_nodes_cut(random_graph(nodes, 0), 3).value == float("inf")


@pytest.mark.parametrize("nodes", [2, 3])
def test_the_smallest_clusters_can_be_cut_into_single_nodes(nodes: int) -> None:
    affinity = random_graph(nodes, 1)
    cut = single_nodes_cut(affinity, 1)
    assert cut.value == pytest.approx(exhaustive_ncut(affinity, 1))


@pytest.mark.parametrize("sizes", [[40], [30, 20], [50, 40, 30, 25], [90, 80, 70], [400, 120, 60]])
@pytest.mark.parametrize("between", [0.0, 1e-5])
def test_blocks_are_told_apart_and_numbered_by_falling_size(sizes: list[int], between: float) -> None:
    affinity, block = block_graph(sizes, between)
    labels = clusters_of(sp.csr_array(affinity), threshold=1e-2, min_side=5)
    np.testing.assert_array_equal(labels, block)


def test_blocks_that_hold_together_stay_one_cluster() -> None:
    affinity, _ = block_graph([30, 30], between=0.3)
    assert set(clusters_of(sp.csr_array(affinity), threshold=1e-2, min_side=5).tolist()) == {0}


def test_a_higher_threshold_splits_more() -> None:
    affinity, block = block_graph([30, 25], between=0.01)
    coarse = clusters_of(sp.csr_array(affinity), threshold=1e-3, min_side=5)
    fine = clusters_of(sp.csr_array(affinity), threshold=0.1, min_side=5)
    assert set(coarse.tolist()) == {0}
    np.testing.assert_array_equal(fine, block)


def test_every_cluster_that_is_left_cannot_be_split_below_the_threshold() -> None:
    affinity = neighbour_graph(np.random.default_rng(5).uniform(0, 12, (300, 2)), 1.2)
    labels = clusters_of(sp.csr_array(affinity), threshold=0.08, min_side=6)
    assert labels.max() >= 2
    for label in range(labels.max() + 1):
        nodes = np.flatnonzero(labels == label)
        assert len(nodes) >= 6
        assert single_nodes_cut(affinity[np.ix_(nodes, nodes)], 6).value >= 0.08


def test_the_small_graph_of_what_is_left_sums_the_affinities_of_its_nodes() -> None:
    affinity = neighbour_graph(np.random.default_rng(3).uniform(0, 12, (300, 2)), 1.2)
    graph = sp.csr_array(affinity)
    group, joined = coarsen(graph.indptr, graph.indices, graph.data, 4)
    side = np.random.default_rng(4).random(len(joined)) < 0.7
    inside = side[group]
    left, small = normalized_cut._within(side, group[inside], joined)
    part = affinity[np.ix_(inside, inside)]
    assert set(left.tolist()) == set(range(np.count_nonzero(side)))
    for one, other in product(range(len(small)), repeat=2):
        assert small[one, other] == pytest.approx(part[np.ix_(left == one, left == other)].sum())


def test_parts_that_are_too_small_get_no_cluster() -> None:
    affinity, block = block_graph([20, 4, 2], between=0.0)
    labels = clusters_of(sp.csr_array(affinity), threshold=1e-2, min_side=5)
    assert set(labels[block == 0].tolist()) == {0}
    assert set(labels[block > 0].tolist()) == {-1}


def test_an_edge_as_good_as_none_joins_nothing() -> None:
    affinity, block = block_graph([20, 15], between=0.1 * NO_EDGE)
    np.testing.assert_array_equal(clusters_of(sp.csr_array(affinity), 1e-30, 5), block)


def test_a_graph_without_edges_or_nodes_has_no_cluster() -> None:
    assert clusters_of(sp.csr_array((0, 0)), 1e-2, 5).shape == (0,)
    assert clusters_of(sp.csr_array((7, 7)), 1e-2, 5).tolist() == [-1] * 7


def test_the_graph_that_is_cut_is_left_as_it_was() -> None:
    affinity = sp.csr_array(block_graph([20, 15], between=0.1 * NO_EDGE)[0])
    before = affinity.copy()
    clusters_of(affinity, 1e-2, 5)
    assert affinity.nnz == before.nnz
    np.testing.assert_array_equal(affinity.data, before.data)


def test_what_certainly_holds_together_has_no_cut_below_the_threshold() -> None:
    for seed in range(40):
        affinity = random_graph(8, seed, density=0.4)
        eigenvalues = scipy.linalg.eigvalsh(
            np.diag(affinity.sum(axis=1)) - affinity, np.diag(affinity.sum(axis=1))
        )
        least = exhaustive_ncut(affinity, 1)
        for threshold in (0.02, 0.9 * least, 1.1 * least, 0.9 * eigenvalues[1], 1.1 * eigenvalues[1]):
            certain = holds_together(affinity, threshold)
            assert certain == (eigenvalues[1] > threshold)
            if certain:
                assert least >= threshold


@pytest.mark.parametrize("nodes", [60, 150])
def test_what_rounding_could_hide_is_not_certain(nodes: int) -> None:
    affinity, _ = block_graph([nodes // 2, nodes // 2], between=0.02)
    degrees = np.diag(affinity.sum(axis=1))
    second = scipy.linalg.eigvalsh(degrees - affinity, degrees)[1]
    margin = ROUNDING * nodes * (nodes + 1)
    assert holds_together(affinity, second - 1.5 * margin)
    assert not holds_together(affinity, second - 0.5 * margin)


def test_a_node_alone_and_one_that_nothing_ties_hold_together() -> None:
    assert holds_together(np.zeros((1, 1)), 0.01)
    assert holds_together(np.full((1, 1), 3.0), 0.01)
    apart, _ = block_graph([5, 5], between=0.0)
    assert not holds_together(apart, 0.01)


def test_connected_parts_are_those_of_scipy_numbered_by_their_first_nodes() -> None:
    affinity = np.random.default_rng(3).random((300, 300))
    affinity = np.where(affinity + affinity.T < 0.11, 1.0, 0.0)
    graph = sp.csr_array(affinity)
    count, part = connected_components(graph, directed=False)
    ordered, starts = normalized_cut._parts(graph.indptr, graph.indices, graph.data, np.zeros(300, np.int64))
    assert 5 < count < 200
    assert len(starts) == count + 1
    for one in range(count):
        np.testing.assert_array_equal(ordered[starts[one] : starts[one + 1]], np.flatnonzero(part == one))


@pytest.mark.parametrize("between", np.geomspace(2e-3, 0.5, 12))
def test_a_cluster_is_firm_exactly_if_its_best_cut_is_far_above_the_threshold(between: float) -> None:
    affinity, _ = block_graph([6, 5], between)
    values = scipy.linalg.eigh(np.diag(affinity.sum(axis=1)) - affinity, np.diag(affinity.sum(axis=1)))[0]
    clusters, firm = recursive_cut(sp.csr_array(affinity), 1e-2, 2, firm_factor=3.0)
    assert len(firm) == clusters.max() + 1
    if len(firm) == 1:
        assert firm[0] == (values[1] > 3.0 * 1e-2)
        assert not firm[0] or exhaustive_ncut(affinity, 2) > 3.0 * 1e-2
    else:
        assert exhaustive_ncut(affinity, 2) < 1e-2


def test_of_each_cluster_it_is_told_whether_it_is_firm() -> None:
    loose, _ = block_graph([20, 20], between=0.006)
    tight, _ = block_graph([30], between=0.0)
    affinity = scipy.linalg.block_diag(loose, tight, tight[:25, :25])
    clusters, firm = recursive_cut(sp.csr_array(affinity), 1e-2, 5, firm_factor=3.0)
    np.testing.assert_array_equal(clusters, np.repeat([0, 1, 2], [40, 30, 25]))
    assert firm.tolist() == [False, True, True]
