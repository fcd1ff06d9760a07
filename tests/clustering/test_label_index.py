"""What is asked of all labels at once, against NumPy."""

from __future__ import annotations

import numpy as np
import pytest

from mlbs_actors.clustering.label_index import (
    REMEMBERED,
    UNLABELLED,
    class_medians,
    distinct_labels,
    label_classes,
    label_places,
    likeliest,
    median_length,
)

RNG = np.random.default_rng(6)


@pytest.mark.parametrize("count", [0, 1, 7, 500])
def test_classes_are_the_places_of_the_labels_among_those_that_count(count: int) -> None:
    labels = RNG.choice([-7, -1, 0, 3, 4, 3 + 2 * REMEMBERED, 90], count)
    left_out = RNG.random(count) < 0.3
    known, classes = label_classes(labels, left_out)
    np.testing.assert_array_equal(known, np.unique(labels[~left_out]))
    np.testing.assert_array_equal(
        classes, np.where(left_out, -1, np.searchsorted(np.unique(labels[~left_out]), labels))
    )
    assert distinct_labels(labels) == set(labels.tolist()) - {UNLABELLED}


def test_labels_are_found_where_they_stand_however_many_share_a_slot() -> None:
    known = np.unique(RNG.integers(-2 * REMEMBERED, 2 * REMEMBERED, 300))
    labels = RNG.integers(-3 * REMEMBERED, 3 * REMEMBERED, 2000)
    expected = [known.tolist().index(label) if label in known else -1 for label in labels]
    np.testing.assert_array_equal(label_places(labels, known), expected)
    np.testing.assert_array_equal(label_places(labels, known[:0]), np.full(2000, -1))


@pytest.mark.parametrize("count", [3, 40, 41])
def test_medians_are_those_of_numpy(count: int) -> None:
    values, classes = RNG.random(count), np.arange(count) % 4 - 1
    expected = [np.median(values[classes == one]) for one in range(3) if (classes == one).any()]
    np.testing.assert_array_equal(class_medians(values, classes, len(expected)), expected)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("count", [1, 2, 31, 400])
def test_the_median_length_is_that_of_numpy(count: int, dtype: type[np.floating]) -> None:
    vectors, chosen = RNG.normal(size=(count, 2)).astype(dtype), RNG.random(count) < 0.6
    chosen[0] = True
    assert median_length(vectors, chosen) == np.median(np.hypot(*vectors[chosen].T))
    assert np.isnan(median_length(vectors, np.zeros(count, bool)))


def test_the_largest_share_decides_and_the_first_of_equal_ones() -> None:
    share, known = np.round(RNG.random((200, 3)), 1), np.array([-5, 0, 8])
    share[RNG.random(200) < 0.2] = 0.0
    expected = np.where(share.max(axis=1) > 0, known[np.argmax(share, axis=1)], UNLABELLED)
    np.testing.assert_array_equal(likeliest(share, known), expected)
