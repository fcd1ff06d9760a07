"""Which trajectories belong together: propagation, splits, and how fast labels move."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp

from mlbs_actors.clustering import splitting
from mlbs_actors.clustering.label_index import UNLABELLED, label_classes
from mlbs_actors.clustering.splitting import (
    background_first,
    background_kept,
    bled_trajectories,
    label_speeds,
    least_object_speed,
    outgrowing,
    propagate_labels,
    residual_speed,
    split_labels,
    split_origins,
)
from mlbs_actors.config import AffinityConfig, LayersConfig, TrajectoriesConfig
from mlbs_actors.messages import BACKGROUND, Array
from mlbs_actors.tracking.trajectories import TrajectoryState, empty_trajectories

CUTS = AffinityConfig(cut_threshold=1e-2, cut_side_tracks=5)
LAYERS = LayersConfig()


def blocks(*sizes: int) -> sp.csr_array:
    """Cliques that nothing joins, one after the other."""
    return sp.csr_array(sp.block_diag([sp.csr_array(np.ones((size, size)) - np.eye(size)) for size in sizes]))


def trajectories(motions: Array, residuals: Array, ages: Array | None = None) -> TrajectoryState:
    """Motions (n, 2) and residuals (n, T, 2), newest first."""
    count, history = residuals.shape[:2]
    return replace(
        empty_trajectories(TrajectoriesConfig(history_frames=history)),
        ids=np.arange(count, dtype=np.int64),
        positions=np.zeros((count, 2), np.float32),
        motions=np.asarray(motions, np.float32),
        residuals=np.asarray(residuals, np.float32),
        ages=np.full(count, history, np.int32) if ages is None else ages.astype(np.int32),
        evidence=np.zeros(count, np.float32),
        next_id=count,
    )


# Propagation


@pytest.mark.parametrize("propagation", ["soft", "absorbing"])
def test_labels_reach_the_new_trajectories_around_them_and_no_others(propagation: str) -> None:
    config = AffinityConfig.model_validate({"propagation": propagation})
    labels = np.full(16, UNLABELLED)
    labels[:3], labels[6] = 0, 7  # labels need not be consecutive
    carried = propagate_labels(blocks(6, 5, 5), labels, config)
    assert carried.tolist() == [0] * 6 + [7] * 5 + [UNLABELLED] * 5


@pytest.mark.parametrize("propagation", ["soft", "absorbing"])
def test_candidates_are_carried_on_like_any_label(propagation: str) -> None:
    config = AffinityConfig.model_validate({"propagation": propagation})
    labels = np.array([-3, UNLABELLED, UNLABELLED, 0, UNLABELLED])
    assert propagate_labels(blocks(3, 2), labels, config).tolist() == [-3, -3, -3, 0, 0]


def test_without_any_label_there_is_nothing_to_carry() -> None:
    labels = np.full(5, UNLABELLED)
    carried = propagate_labels(blocks(5), labels, CUTS)
    np.testing.assert_array_equal(carried, labels)
    assert carried is not labels
    assert propagate_labels(sp.csr_array((0, 0)), np.zeros(0, np.int64), CUTS).shape == (0,)


# Splits


def split(affinity: sp.csr_array, labels: Array, next_label: int = 1, bled: Array | None = None) -> Array:
    none = np.zeros(len(labels), bool)
    return split_labels(affinity, labels, CUTS, next_label, none if bled is None else bled)[0]


def test_the_largest_part_keeps_the_label_and_the_others_get_fresh_ones() -> None:
    labels = split(blocks(8, 12, 6), np.full(26, 4), next_label=9)
    assert labels.tolist() == [9] * 8 + [4] * 12 + [10] * 6


def test_what_is_spared_stays_together_and_the_others_do_not() -> None:
    labels, none = np.repeat([4, 2], [20, 15]), np.zeros(35, bool)
    affinity = blocks(8, 12, 6, 9)
    spared, firm = split_labels(affinity, labels, CUTS, 9, none, spared=[4])
    assert spared.tolist() == [4] * 20 + [9] * 6 + [2] * 9
    assert sorted(firm.tolist()) == [2, 9]


def test_a_cluster_that_holds_together_is_left_alone() -> None:
    labels = split(blocks(10, 12), np.repeat([0, 3], [10, 12]), next_label=5)
    assert labels.tolist() == [0] * 10 + [3] * 12


def test_unlabelled_trajectories_are_clustered_too() -> None:
    before = np.repeat([0, UNLABELLED], [10, 14])
    labels = split(blocks(10, 8, 6), before)
    assert labels.tolist() == [0] * 10 + [1] * 8 + [2] * 6


def test_few_trajectories_that_fall_off_never_make_a_label() -> None:
    labels = split(blocks(12, 3, 4), np.zeros(19, np.int64))
    assert labels.tolist() == [0] * 12 + [UNLABELLED] * 7


def test_a_new_label_comes_from_where_most_of_its_trajectories_were() -> None:
    before = np.array([0, 0, 3, 3, 3, 3, UNLABELLED, UNLABELLED, -5, -5])
    labels = np.array([0, 7, 7, 7, 3, 3, 8, 8, 9, UNLABELLED])
    assert split_origins(before, labels) == {7: 3, 9: -5}
    assert split_origins(before, before) == {}


def test_splitting_leaves_the_given_labels_as_they_were() -> None:
    before = np.zeros(20, np.int64)
    split(blocks(10, 10), before)
    assert not before.any()


def bridge() -> sp.csr_array:
    """Two groups of ten, and between them three trajectories that are strongly tied to both."""
    dense = blocks(10, 10, 3).toarray()
    dense[20:, :20] = dense[:20, 20:] = 0.4
    dense[20:, :10] = dense[:10, 20:] = 0.5  # a little nearer to the first
    return sp.csr_array(dense)


def test_trajectories_that_have_bled_tie_nothing_together() -> None:
    labels = split(bridge(), np.zeros(23, np.int64), bled=np.arange(23) >= 20)
    assert labels.tolist() == [0] * 10 + [1] * 10 + [0] * 3
    assert not split(bridge(), np.zeros(23, np.int64)).any()


def test_trajectories_that_have_bled_keep_the_label_of_what_holds_together() -> None:
    assert not split(blocks(12, 3), np.zeros(15, np.int64), bled=np.arange(15) >= 12).any()


def named_by_masks(labels: Array, bled: Array, clusters: Array, next_label: int) -> tuple[Array, Array]:
    """What becomes of each label, label by label and cluster by cluster."""
    result, adrift = labels.copy(), np.zeros(len(labels), bool)
    for label in np.unique(labels):
        nodes = np.flatnonzero((labels == label) & ~bled)
        parts = clusters[nodes]
        numbers = np.unique(parts[parts >= 0])
        if len(numbers) == 0:
            continue
        result[nodes[parts < 0]] = UNLABELLED
        own_bled = (labels == label) & bled
        if own_bled.any():
            adrift[nodes[parts < 0]] = True
        if len(numbers) > 1:
            adrift |= own_bled
            result[own_bled] = UNLABELLED
        for number in numbers[1:] if label != UNLABELLED else numbers:
            result[nodes[parts == number]] = next_label
            next_label += 1
    return result, adrift


def test_clusters_are_named_as_label_by_label() -> None:
    for seed in range(30):
        rng = np.random.default_rng(seed)
        labels, bled = rng.choice([-4, UNLABELLED, 0, 1, 6], 200), rng.random(200) < 0.1 * (seed % 3)
        bled |= labels == rng.choice([0, 1, 77])  # all of a label may have bled
        known, classes = label_classes(labels, bled)
        found = rng.integers(-1, 3, 200)  # three clusters at most of each label
        numbers = rng.permutation(3 * len(known))
        clusters = np.where((found < 0) | bled, -1, numbers[3 * classes + np.maximum(found, 0)])
        clusters[classes == seed % 4] = -1  # and one that is too small to be cut
        clusters = np.unique(np.r_[-1, clusters], return_inverse=True)[1][1:] - 1
        result, adrift, names = splitting._named(labels, bled, known, classes, clusters, 50)
        expected, expected_adrift = named_by_masks(labels, bled, clusters, 50)
        np.testing.assert_array_equal(result, expected)
        np.testing.assert_array_equal(adrift, expected_adrift)
        for cluster, name in enumerate(names):
            assert set(expected[clusters == cluster].tolist()) == {name}


def test_what_hangs_on_a_cluster_by_bled_trajectories_alone_keeps_its_label() -> None:
    dense = blocks(12, 3, 4).toarray()
    dense[12:15, :12] = dense[:12, 12:15] = dense[12:15, 15:] = dense[15:, 12:15] = 0.9
    labels = split(sp.csr_array(dense), np.zeros(19, np.int64), bled=(np.arange(19) // 3) == 4)
    assert not labels.any()


def test_what_moves_against_the_camera_without_evidence_has_bled() -> None:
    residuals = np.zeros((4, 4, 2))
    residuals[1:] = (3.0, 0.0)
    state = replace(
        trajectories(np.zeros((4, 2)), residuals),
        evidence=np.array([0.0, 0.0, LAYERS.least_evidence, -1.0], np.float32),
    )
    assert bled_trajectories(state, residual_speed(state, LAYERS.speed_frames), LAYERS, 1.0).tolist() == [
        False,
        True,
        False,
        True,
    ]
    assert not bled_trajectories(
        state, residual_speed(state, LAYERS.speed_frames), LAYERS, 10.0
    ).any()  # 3 px is nothing in so large a frame


# Speeds


def test_a_labels_speed_is_the_median_of_its_members_mean_residual() -> None:
    residuals = np.zeros((5, 4, 2))
    residuals[0] = residuals[1] = (3.0, 4.0)
    residuals[2] = (60.0, 80.0)  # an outlier
    residuals[3, ::2], residuals[3, 1::2] = (2.0, 0.0), (-2.0, 0.0)  # shakes, goes nowhere
    speeds = label_speeds(
        residual_speed(trajectories(np.zeros((5, 2)), residuals), LAYERS.speed_frames),
        np.array([4, 4, 4, 1, UNLABELLED]),
    )
    assert set(speeds) == {1, 4}
    assert speeds[4] == pytest.approx(5.0)
    assert speeds[1] < 1.0


def test_a_young_trajectory_is_as_fast_as_the_frames_it_has_lived() -> None:
    residuals = np.zeros((1, 4, 2))
    residuals[0, 0] = (0.0, 3.0)
    state = trajectories(np.zeros((1, 2)), residuals, ages=np.array([1]))
    assert label_speeds(residual_speed(state, LAYERS.speed_frames), np.array([2]))[2] == pytest.approx(3.0)


def test_what_counts_as_moving_grows_with_the_camera_s_own_motion() -> None:
    def least(camera: float, label: int = BACKGROUND, scale: float = 1.0) -> float:
        state = trajectories(np.full((20, 2), (camera, 0.0)), np.zeros((20, 4, 2)))
        return least_object_speed(state, np.full(20, label), LAYERS, scale)

    floor = least(0.0)
    assert floor > 0
    assert least(200.0) > least(100.0) > floor
    assert least(50.0, label=1, scale=2.0) == pytest.approx(2 * floor)


# The scene


def scene_with_a_crowded_object() -> tuple[Array, TrajectoryState]:
    """Still ground (1), 30 trajectories far apart, and an object (0) of 200 that moves by 4 px a frame."""
    y, x = np.divmod(np.arange(30), 6)
    ground = np.stack([20.0 * x, 20.0 * y], axis=1)
    crowd = np.random.default_rng(0).uniform(0, 40, (200, 2))
    residuals = np.zeros((230, 3, 2))
    residuals[30:, :, 0] = 4.0
    state = trajectories(np.zeros((230, 2)), residuals)
    positions = np.concatenate([ground, crowd]).astype(np.float32)
    return np.repeat([1, 0], [30, 200]), replace(state, positions=positions)


def test_of_the_first_clusters_the_one_that_obeys_the_camera_is_the_background() -> None:
    labels, state = scene_with_a_crowded_object()
    labels[-1] = UNLABELLED
    first = background_first(labels, state, 1.0, 10.0)
    assert first.tolist() == [BACKGROUND] * 30 + [1] * 199 + [UNLABELLED]
    nothing = np.full(230, UNLABELLED)
    assert (background_first(nothing, state, 1.0, 10.0) == BACKGROUND).all()


def test_an_object_that_is_split_off_leaves_the_background_its_name() -> None:
    labels, state = scene_with_a_crowded_object()
    named = background_kept(labels + 7 * (labels == 1), {8}, state, 1.0, 10.0)
    assert named.tolist() == [BACKGROUND] * 30 + [8] * 200
    split_off_something_else = background_kept(labels, set(), state, 1.0, 10.0)
    np.testing.assert_array_equal(split_off_something_else, labels)
    slow = replace(state, residuals=state.residuals / 100)
    np.testing.assert_array_equal(background_kept(1 - labels, {1}, slow, 1.0, 10.0), 1 - labels)


@pytest.mark.parametrize(
    ("sky", "ground", "among", "found"),
    [
        (4, 60, {1}, {1}),
        (4, 60, {2}, set()),  # small
        (4, 60, set(), set()),
        (40, 60, {1}, set()),  # less than twice the background
        (0, 4, {1}, set()),  # so small that it may be an object in an empty sky
    ],
)
def test_what_is_new_and_far_larger_than_the_background_is_the_scene(
    sky: int, ground: int, among: set[int], found: set[int]
) -> None:
    places = np.stack(np.meshgrid(np.arange(5.0, 200, 10), np.arange(5.0, 100, 10)), axis=-1)
    places = places.reshape(-1, 2).astype(np.float32)
    labels = np.full(len(places), UNLABELLED)
    labels[:sky], labels[100 : 100 + ground], labels[192:] = BACKGROUND, 1, 2
    crowded = np.repeat(places[:sky], 50, axis=0)  # area counts, not trajectories
    positions = np.concatenate([places, crowded])
    labels = np.concatenate([labels, np.full(len(crowded), BACKGROUND)])
    assert outgrowing(labels, among, positions, 10.0, (100, 200)) == found
