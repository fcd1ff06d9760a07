"""The motion test that undoes false splits."""

from __future__ import annotations

import numpy as np
from trajectory_graphs import at_quantile, graph_of, plain_borders, random_graph

from mlbs_actors.clustering.affinity import TrajectoryGraph
from mlbs_actors.clustering.label_index import UNLABELLED
from mlbs_actors.clustering.motion_merging import merge_by_motion
from mlbs_actors.clustering.repulsion import Repulsion
from mlbs_actors.config import LayersConfig
from mlbs_actors.messages import BACKGROUND, Array

MERGES = LayersConfig(young_frames=6, merge_quantile=0.3, merge_distance=1.2, merge_border=3.0)
OLD = 100
#: Too old to be merged as a young one, but not yet two for long.
OLDER = 20
FAST = 1e9
UNKNOWN = Repulsion.empty()


def plain_merge(graph: TrajectoryGraph, labels: Array, ages: dict[int, int], config: LayersConfig) -> Array:
    """Border by border, and all of them anew after each merge."""
    labels = labels.copy()
    while True:
        candidates = []
        for (low, high), distances in plain_borders(graph, labels).items():
            distance, edges = at_quantile(distances, config.merge_quantile), len(distances)
            older, younger = sorted((low, high), key=lambda label: (-ages.get(label, 0), label))
            young = ages.get(younger, 0) < config.young_frames
            root = np.sqrt((labels == younger).sum())
            if older == BACKGROUND:
                alike = young and distance < config.merge_distance
            else:
                alike = (
                    young and distance < config.object_merge_distance and edges >= config.merge_border * root
                ) or (
                    distance < config.same_motion_distance
                    and ages.get(younger, 0) <= config.same_motion_frames
                    and edges >= config.same_motion_border * root
                    and edges >= config.least_border
                )
            if alike:
                candidates.append((distance, younger, older))
        if not candidates:
            return labels
        _, younger, older = min(candidates)
        labels[labels == younger] = older


def test_merges_are_those_of_plain_loops() -> None:
    for seed in range(6):
        rng = np.random.default_rng(seed)
        labels = np.sort(rng.choice([UNLABELLED, -3, -2, 0, 1, 5, 9], 60))
        ages = {label: int(rng.integers(0, 12)) for label in (-3, 1, 5, 9)} | {BACKGROUND: OLD}
        graph = random_graph(rng, 60, 600)
        config = MERGES.model_copy(
            update={"same_motion_distance": 0.8, "same_motion_frames": 8, "merge_border": 1.0}
        )
        expected = plain_merge(graph, labels, ages, config)
        assert 1 < len(np.unique(expected)) < len(np.unique(labels))
        speeds = dict.fromkeys(ages, FAST)
        np.testing.assert_array_equal(
            merge_by_motion(graph, labels, ages, speeds, 1.0, config, UNKNOWN), expected
        )


def border(low: int, high: int, distances: list[float], size: int = 40) -> tuple[TrajectoryGraph, Array]:
    """Two labels of 20 trajectories each, and the motion distances of the edges between them."""
    labels = np.repeat([low, high], size // 2)
    edges = [(i, size // 2 + i, distance) for i, distance in enumerate(distances)]
    return graph_of(edges, size), labels


def test_a_young_part_that_joins_the_background_somewhere_is_background() -> None:
    graph, labels = border(BACKGROUND, 3, [0.2] * 8 + [50.0] * 10)
    merged = merge_by_motion(graph, labels, {BACKGROUND: OLD, 3: 1}, {3: FAST}, 1.0, MERGES, UNKNOWN)
    assert set(merged.tolist()) == {BACKGROUND}


def test_a_part_that_moves_apart_along_its_whole_border_stays() -> None:
    graph, labels = border(BACKGROUND, 3, [0.2] + [50.0] * 17)
    merged = merge_by_motion(graph, labels, {BACKGROUND: OLD, 3: 1}, {3: FAST}, 1.0, MERGES, UNKNOWN)
    np.testing.assert_array_equal(merged, labels)


def test_an_old_label_is_not_merged_even_if_it_stops() -> None:
    graph, labels = border(BACKGROUND, 3, [0.0] * 18)
    ages = {BACKGROUND: OLD, 3: MERGES.young_frames}
    np.testing.assert_array_equal(
        merge_by_motion(graph, labels, ages, {3: 0.0}, 1.0, MERGES, UNKNOWN), labels
    )


def test_a_young_label_that_does_not_move_against_the_camera_is_background_wherever_it_lies() -> None:
    graph, labels = border(BACKGROUND, 3, [50.0] * 18)
    ages = {BACKGROUND: OLD, 3: 1}
    assert not merge_by_motion(graph, labels, ages, {BACKGROUND: 0.0, 3: 0.9}, 1.0, MERGES, UNKNOWN).any()
    moving = merge_by_motion(graph, labels, ages, {BACKGROUND: 0.0, 3: 1.1}, 1.0, MERGES, UNKNOWN)
    np.testing.assert_array_equal(moving, labels)


def test_two_halves_of_one_object_become_the_older_one() -> None:
    graph, labels = border(2, 5, [0.1] * 18)
    merged = merge_by_motion(graph, labels, {2: 1, 5: 3}, {2: FAST, 5: FAST}, 1.0, MERGES, UNKNOWN)
    assert set(merged.tolist()) == {5}
    equal = merge_by_motion(graph, labels, {2: 3, 5: 3}, {2: FAST, 5: FAST}, 1.0, MERGES, UNKNOWN)
    assert set(equal.tolist()) == {2}
    new = merge_by_motion(graph, labels, {2: 3}, {2: FAST, 5: FAST}, 1.0, MERGES, UNKNOWN)
    assert set(new.tolist()) == {2}


def test_two_objects_that_only_touch_stay_apart() -> None:
    graph, labels = border(2, 5, [0.1] * 4)
    merged = merge_by_motion(graph, labels, {2: 3, 5: 1}, {2: FAST, 5: FAST}, 1.0, MERGES, UNKNOWN)
    np.testing.assert_array_equal(merged, labels)


def test_the_border_of_two_halves_is_measured_against_the_root_of_their_size() -> None:
    # A border grows like the root of what it bounds: 3 √20 = 13.4 edges for the 20 of the younger.
    ages, speeds = {2: 3, 5: 1}, {2: FAST, 5: FAST}
    bent = 0.5 * (MERGES.same_motion_distance + MERGES.object_merge_distance)
    less, labels = border(2, 5, [bent] * 13)
    np.testing.assert_array_equal(merge_by_motion(less, labels, ages, speeds, 1.0, MERGES, UNKNOWN), labels)
    enough, labels = border(2, 5, [bent] * 14)
    assert set(merge_by_motion(enough, labels, ages, speeds, 1.0, MERGES, UNKNOWN).tolist()) == {2}


def test_objects_whose_motions_have_been_the_same_are_one_unless_they_have_been_two_for_long() -> None:
    same = MERGES.same_motion_distance
    graph, labels = border(2, 5, [0.9 * same] * 6)
    merged = merge_by_motion(graph, labels, {2: 30, 5: OLD}, {2: FAST, 5: FAST}, 1.0, MERGES, UNKNOWN)
    assert set(merged.tolist()) == {5}
    stayed = merge_by_motion(graph, labels, {2: 31, 5: OLD}, {2: FAST, 5: FAST}, 1.0, MERGES, UNKNOWN)
    np.testing.assert_array_equal(stayed, labels)


def test_old_objects_whose_motions_differ_stay_apart() -> None:
    # Of young ones much more is forgiven.
    assert MERGES.object_merge_distance > MERGES.same_motion_distance
    graph, labels = border(2, 5, [1.1 * MERGES.same_motion_distance] * 18)
    ages, speeds = {2: OLDER, 5: OLDER}, {2: FAST, 5: FAST}
    np.testing.assert_array_equal(merge_by_motion(graph, labels, ages, speeds, 1.0, MERGES, UNKNOWN), labels)
    young = merge_by_motion(graph, labels, {2: OLD, 5: 1}, speeds, 1.0, MERGES, UNKNOWN)
    assert set(young.tolist()) == {2}


def test_old_objects_that_touch_with_little_stay_apart_however_alike_they_move() -> None:
    ages, speeds = {2: OLDER, 5: OLDER}, {2: FAST, 5: FAST}
    few, labels = border(2, 5, [0.0] * (MERGES.least_border - 1))
    np.testing.assert_array_equal(merge_by_motion(few, labels, ages, speeds, 1.0, MERGES, UNKNOWN), labels)
    config = MERGES.model_copy(update={"same_motion_border": 2.0})
    little, labels = border(2, 5, [0.0] * 8)  # less than 2 √20
    np.testing.assert_array_equal(merge_by_motion(little, labels, ages, speeds, 1.0, config, UNKNOWN), labels)
    enough, labels = border(2, 5, [0.0] * 9)
    assert set(merge_by_motion(enough, labels, ages, speeds, 1.0, config, UNKNOWN).tolist()) == {2}


def test_merges_go_on_until_nothing_is_left_to_merge() -> None:
    labels = np.repeat([BACKGROUND, 1, 2], 10)
    chain = [(i, 10 + i, 0.1) for i in range(8)] + [(10 + i, 20 + i, 0.2) for i in range(8)]
    ages = {BACKGROUND: OLD, 1: 2, 2: 1}
    merged = merge_by_motion(
        graph_of(chain, 30), labels, ages, dict.fromkeys((1, 2), FAST), 1.0, MERGES, UNKNOWN
    )
    assert not merged.any()


def test_merging_leaves_the_given_labels_and_the_unlabelled_as_they_were() -> None:
    graph, labels = border(BACKGROUND, 3, [0.0] * 18)
    labels[-1] = UNLABELLED
    before = labels.copy()
    merged = merge_by_motion(graph, labels, {BACKGROUND: OLD}, {3: FAST}, 1.0, MERGES, UNKNOWN)
    np.testing.assert_array_equal(labels, before)
    assert merged.tolist() == [BACKGROUND] * 39 + [UNLABELLED]


def test_objects_that_are_more_likely_two_than_one_are_not_merged_however_alike_they_move() -> None:
    graph, labels = border(2, 5, [0.1] * 18)
    ages, speeds = {2: 3, 5: 1}, {2: FAST, 5: FAST}
    two, one = (Repulsion(np.array([[2, 5]]), np.array([odds])) for odds in (0.1, -0.1))
    np.testing.assert_array_equal(merge_by_motion(graph, labels, ages, speeds, 1.0, MERGES, two), labels)
    assert set(merge_by_motion(graph, labels, ages, speeds, 1.0, MERGES, one).tolist()) == {2}
