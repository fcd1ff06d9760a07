"""Random walks that carry labels, against their dense closed forms."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp

from mlbs_actors.clustering.label_propagation import TOLERANCE, propagate_absorbing, propagate_soft
from mlbs_actors.messages import Array


def random_affinity(nodes: int, seed: int, density: float = 0.15) -> Array:
    rng = np.random.default_rng(seed)
    upper = np.triu(rng.random((nodes, nodes)) * (rng.random((nodes, nodes)) < density), 1)
    return np.asarray(upper + upper.T)


def some_labels(nodes: int, classes: int, seed: int, unlabelled: float = 0.6) -> Array:
    rng = np.random.default_rng(seed + 100)
    return np.where(rng.random(nodes) < unlabelled, -1, rng.integers(0, classes, nodes))


def one_hot(labels: Array, classes: int) -> Array:
    return np.array([[float(label == one) for one in range(classes)] for label in labels])


def transition(affinity: Array) -> Array:
    degree = affinity.sum(axis=1, keepdims=True)
    return np.asarray(np.divide(affinity, degree, out=np.zeros_like(affinity), where=degree > 0))


def components(affinity: Array) -> Array:
    """Connected component of every node, by following the edges."""
    part = np.full(len(affinity), -1)
    for seed in range(len(affinity)):
        waiting = [seed] if part[seed] < 0 else []
        while waiting:
            node = waiting.pop()
            part[node] = seed
            waiting += [int(j) for j in np.flatnonzero(affinity[node]) if part[j] < 0]
    return part


@pytest.mark.parametrize("restart", [0.1, 0.5])
def test_the_soft_walk_is_its_dense_closed_form(restart: float) -> None:
    for seed in range(5):
        affinity, labels = random_affinity(40, seed), some_labels(40, 3, seed)
        walks = np.eye(40) - (1 - restart) * transition(affinity)
        expected = restart * np.linalg.solve(walks, one_hot(labels, 3))
        share = propagate_soft(sp.csr_array(affinity), labels, 3, restart)
        np.testing.assert_allclose(share, expected, atol=TOLERANCE)
        assert (share.sum(axis=1) <= 1 + TOLERANCE).all()


def test_the_absorbing_walk_is_its_dense_closed_form() -> None:
    for seed in range(5):
        affinity, labels = random_affinity(40, seed), some_labels(40, 3, seed, unlabelled=0.8)
        part = components(affinity)
        reached = np.isin(part, part[labels >= 0])
        known, unknown = np.flatnonzero(labels >= 0), np.flatnonzero((labels < 0) & reached)
        P = transition(affinity)
        expected = one_hot(labels, 3)
        expected[unknown] = np.linalg.solve(
            np.eye(len(unknown)) - P[np.ix_(unknown, unknown)], P[np.ix_(unknown, known)] @ expected[known]
        )
        share = propagate_absorbing(sp.csr_array(affinity), labels, 3)
        np.testing.assert_allclose(share, expected, atol=1e-9)
        np.testing.assert_allclose(share[reached].sum(axis=1), 1.0)


@pytest.mark.parametrize("walk", ["soft", "absorbing"])
def test_a_component_without_a_labelled_node_gets_nothing(walk: str) -> None:
    affinity = np.zeros((9, 9))
    for a, b in ((0, 1), (1, 2), (3, 4), (4, 5), (5, 3)):  # 0–1–2, the ring 3–4–5; 6, 7 and 8 are alone
        affinity[a, b] = affinity[b, a] = 0.7
    labels = np.array([1, -1, -1, -1, -1, -1, -1, 0, -1])
    graph = sp.csr_array(affinity)
    share = propagate_soft(graph, labels, 2, 0.3) if walk == "soft" else propagate_absorbing(graph, labels, 2)
    assert (share[[0, 1, 2]].argmax(axis=1) == 1).all()
    assert (share[[0, 1, 2], 1] > 0).all()
    assert not share[[3, 4, 5, 6, 8]].any()
    assert share[7, 0] > 0
    assert np.isfinite(share).all()


@pytest.mark.parametrize("weight", [0.0, 1e-30])
def test_an_edge_of_no_weight_leads_nowhere(weight: float) -> None:
    # Affinities of trajectories that move far apart underflow to 0 but stay in the sparse matrix.
    rows = np.array([0, 1, 1, 2, 2, 3], np.int32)
    columns = np.array([1, 0, 2, 1, 3, 2], np.int32)
    weights = np.array([0.5, 0.5, weight, weight, 0.5, 0.5])
    graph = sp.csr_array((weights, (rows, columns)), shape=(4, 4))
    share = propagate_absorbing(graph, np.array([0, -1, -1, -1]), 1)
    np.testing.assert_allclose(share, [[1.0], [1.0], [0.0], [0.0]])


def test_the_soft_walk_heals_a_wrong_label_and_the_absorbing_one_keeps_it() -> None:
    affinity = np.ones((8, 8)) - np.eye(8)
    labels = np.array([0, 0, 0, 0, 0, 0, 0, 1])
    graph = sp.csr_array(affinity)
    assert propagate_soft(graph, labels, 2, 0.1)[7].argmax() == 0
    assert propagate_soft(graph, labels, 2, 0.1)[0].argmax() == 0
    np.testing.assert_array_equal(propagate_absorbing(graph, labels, 2)[7], [0.0, 1.0])


def test_a_new_node_takes_the_label_it_is_nearer_to() -> None:
    affinity = np.zeros((5, 5))
    for a, b, weight in ((0, 1, 1.0), (3, 4, 1.0), (2, 1, 0.9), (2, 3, 0.2)):
        affinity[a, b] = affinity[b, a] = weight
    labels = np.array([0, 0, -1, 1, 1])
    graph = sp.csr_array(affinity)
    np.testing.assert_allclose(propagate_absorbing(graph, labels, 2)[2], [0.9 / 1.1, 0.2 / 1.1])
    assert propagate_soft(graph, labels, 2, 0.3)[2].argmax() == 0


@pytest.mark.parametrize("label", [-1, 1])
def test_all_labelled_or_none_labelled_is_no_special_case(label: int) -> None:
    graph, labels = sp.csr_array(random_affinity(20, 1)), np.full(20, label)
    expected = one_hot(labels, 2)
    np.testing.assert_array_equal(propagate_absorbing(graph, labels, 2), expected)
    soft = propagate_soft(graph, labels, 2, 0.3)
    np.testing.assert_array_equal(soft > 0, expected > 0)


def test_a_soft_walk_goes_on_from_nodes_that_little_reached_at_first() -> None:
    edges = [(0, 1, 1.0), (1, 2, 1.0), (0, 2, 1.0), (2, 3, 1.0), (3, 4, 1.0), (4, 5, 1.0), (0, 3, 1e-4)]
    dense = np.zeros((6, 6))
    for one, other, weight in edges:
        dense[one, other] = dense[other, one] = weight
    labels = np.array([0, -1, -1, -1, -1, -1])
    walk = dense / dense.sum(axis=1, keepdims=True)
    expected = 0.3 * np.linalg.solve(np.eye(6) - 0.7 * walk, (labels == 0).astype(float))
    share = propagate_soft(sp.csr_array(dense), labels, 1, 0.3)
    np.testing.assert_allclose(share[:, 0], expected, atol=1e-2)
    assert (share > 0).all()
