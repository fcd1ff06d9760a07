"""Two things or one: log-odds that gather clustering by clustering."""

from __future__ import annotations

import numpy as np
import pytest
from trajectory_graphs import graph_of

from mlbs_actors.clustering.repulsion import Repulsion
from mlbs_actors.config import Config
from mlbs_actors.messages import Array

CONFIG = Config()
IDENTITY = CONFIG.identity
SIDE = 10


def gathered(
    across: float, inside: float, before: Repulsion | None = None, positions: Array | None = None
) -> Repulsion:
    """Look at the labels 2 and 5, ten trajectories each, with these motion distances; 5 was split off 2."""
    labels = np.repeat([2, 5], SIDE)
    edges = [(i, i + 1, inside) for i in (*range(SIDE - 1), *range(SIDE, 2 * SIDE - 1))]
    if positions is None:
        edges += [(i, SIDE + i, across) for i in range(SIDE)]
        positions = np.random.default_rng(0).uniform(0, 50, (2 * SIDE, 2))
    graph = graph_of(sorted(edges), 2 * SIDE)
    return (before or Repulsion.empty()).gathered(graph, labels, positions.astype(np.float32), {5: 2}, CONFIG)


def test_a_step_at_the_border_is_two_things_and_the_same_step_in_something_that_bends_is_one() -> None:
    assert gathered(20.0, 0.5).between(2, 5) > IDENTITY.apart / 2
    assert gathered(20.0, 20.0).between(5, 2) < 0
    even = IDENTITY.step_ratio * 2.0
    assert gathered(even, 2.0).between(2, 5) == pytest.approx(0, abs=1e-6)
    assert gathered(np.e * even, 2.0).between(2, 5) == pytest.approx(IDENTITY.weight * IDENTITY.step_slope)


def test_evidence_gathers_up_to_a_bound_and_fades() -> None:
    state, odds = Repulsion.empty(), []
    for _ in range(40):
        state = gathered(1000.0, 0.1, state)
        odds.append(state.between(2, 5))
    most = IDENTITY.weight * IDENTITY.most_evidence
    assert odds[:2] == pytest.approx([most, most * (1 + IDENTITY.fading)])
    assert odds[-1] == pytest.approx(most / (1 - IDENTITY.fading), rel=1e-3)
    for _ in range(40):
        state = gathered(0.1, 1.0, state)
    assert state.between(2, 5) < 0


def test_a_part_that_is_farther_away_than_its_object_is_large_is_another_thing() -> None:
    near = np.concatenate(
        [np.mgrid[0:50:10j, 0:1].reshape(2, -1).T, np.mgrid[0:50:10j, 0:1].reshape(2, -1).T]
    )
    near[:, 1] = np.tile([0, 50], SIDE)
    far = near + np.where(np.arange(2 * SIDE)[:, None] < SIDE, 0, [0, 120])
    beside = near + np.where(np.arange(2 * SIDE)[:, None] < SIDE, 0, [0, 60])
    assert gathered(0, 1.0, positions=beside).between(2, 5) == 0
    away = gathered(0, 1.0, positions=far).between(2, 5)
    assert away == pytest.approx(IDENTITY.weight * min(IDENTITY.gap_slope * 0.9, IDENTITY.most_evidence))


def test_the_gap_is_to_the_nearest_of_all_parts_of_the_object() -> None:
    # A hand, far from the body, whose arm was split off before.
    labels, origins = np.repeat([2, 3, 5], SIDE), {3: 2, 5: 2}
    positions = np.zeros((3 * SIDE, 2), np.float32)
    positions[:, 0] = np.tile(np.linspace(0, 50, SIDE), 3)
    positions[:, 1] = np.concatenate([np.linspace(0, 50, SIDE), np.full(SIDE, 120), np.full(SIDE, 190)])
    graph = graph_of([(0, 1, 1.0)], 3 * SIDE)
    alone = Repulsion.empty().gathered(graph, labels, positions, {5: 2}, CONFIG)
    with_arm = Repulsion.empty().gathered(graph, labels, positions, origins, CONFIG)
    assert alone.between(2, 5) > 0
    assert 0 <= with_arm.between(2, 5) < alone.between(2, 5)


def test_few_edges_are_no_evidence() -> None:
    labels, edges = np.repeat([2, 5], SIDE), [(i, SIDE + i, 1000.0) for i in range(4)]
    nothing = Repulsion.empty().gathered(
        graph_of(edges, 2 * SIDE), labels, np.zeros((2 * SIDE, 2), np.float32), {}, CONFIG
    )
    assert nothing.between(2, 5) == 0


def test_log_odds_follow_their_labels_when_these_are_renamed_merged_or_gone() -> None:
    state = Repulsion(np.array([[1, 2], [1, 3], [2, 3]]), np.array([5.0, 6.0, 7.0]))
    renamed = state.renamed({1: 9, 2: -4, 3: 3})
    assert (renamed.between(9, -4), renamed.between(9, 3), renamed.between(-4, 3)) == (5.0, 6.0, 7.0)
    merged = state.renamed({1: 1, 2: 1, 3: 3})
    assert (len(merged.pairs), merged.between(1, 3)) == (1, 6.0)
    gone = state.renamed({1: 1, 3: 3})
    assert (len(gone.pairs), gone.between(1, 3), gone.between(1, 2)) == (1, 6.0, 0)


def test_the_matrix_holds_every_known_pair_twice() -> None:
    state = Repulsion(np.array([[-3, 2], [2, 7], [2, 8]]), np.array([5.0, 6.0, 7.0]))
    expected = [[0, 5, 0], [5, 0, 6], [0, 6, 0]]
    np.testing.assert_array_equal(state.matrix(np.array([-3, 2, 7])), expected)
    assert state.matrix(np.zeros(0, np.int64)).shape == (0, 0)


def test_only_pairs_of_the_named_layers_above_the_threshold_are_apart() -> None:
    state = Repulsion(np.array([[1, 2], [1, 3], [2, 3]]), np.array([5.0, 1.0, 7.0]))
    assert state.apart((1, 2, 3), 1.0) == ((1, 2), (2, 3))
    assert state.apart((1, 2), 1.0) == ((1, 2),)
