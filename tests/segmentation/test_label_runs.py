"""Runs of a label map and its components, against SciPy's."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from mlbs_actors.segmentation.label_runs import label_runs


@pytest.mark.parametrize("diagonal", [False, True])
def test_runs_and_components_are_those_of_the_labels(diagonal: bool) -> None:
    for seed in range(10):
        random = np.random.default_rng(seed)
        labels = random.integers(0, 3, (random.integers(1, 12), random.integers(1, 12))).astype(np.uint16)
        rows, starts, ends, component = label_runs(labels, diagonal)
        found = np.full(labels.shape, -1)
        for y, start, end, one in zip(rows, starts, ends, component, strict=True):
            assert (labels[y, start:end] == labels[y, start]).all()
            assert start == 0 or labels[y, start - 1] != labels[y, start]
            assert (found[y, start:end] == -1).all()
            found[y, start:end] = one
        expected, count = np.full(labels.shape, -1), 0
        for label in range(3):
            parts, parted = ndimage.label(labels == label, np.ones((3, 3)) if diagonal else None)
            expected[parts > 0] = count + parts[parts > 0] - 1
            count += parted
        _, first = np.unique(expected, return_index=True)
        rank = np.argsort(np.argsort(first))  # by the first pixel, which is that of the first run
        np.testing.assert_array_equal(found, rank[expected])
