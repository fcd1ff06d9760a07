"""Colours and places of lost objects."""

from __future__ import annotations

import numpy as np
from read_only import read_only

from mlbs_actors.clustering.reidentification import colour_signatures, colours_at


def test_a_signature_counts_the_pixels_of_each_colour_bin() -> None:
    colours = np.random.default_rng(0).integers(0, 256, (500, 3)).astype(np.uint8)
    (signature,) = colour_signatures(np.zeros(len(colours), np.int64), colours, 1)
    bins = round(len(signature) ** (1 / 3))
    expected = np.zeros((bins, bins, bins))
    for blue, green, red in colours.astype(int):
        expected[blue * bins // 256, green * bins // 256, red * bins // 256] += 1
    np.testing.assert_array_equal(signature, expected.ravel())


def test_no_pixels_have_an_empty_signature() -> None:
    assert colour_signatures(np.zeros(0, np.int64), np.zeros((0, 3), np.uint8), 1).sum() == 0.0


def test_each_group_has_its_own_signature_and_what_is_in_none_counts_for_none() -> None:
    colours = np.random.default_rng(1).integers(0, 256, (60, 3)).astype(np.uint8)
    rows = np.random.default_rng(2).integers(-1, 2, 60)
    together = colour_signatures(rows, colours, 3)
    for row in range(2):
        own = colours[rows == row]
        (alone,) = colour_signatures(np.zeros(len(own), np.int64), own, 1)
        np.testing.assert_array_equal(together[row], alone)
    assert not together[2].any()


def test_colours_are_those_of_the_nearest_pixels_of_the_frame() -> None:
    rng = np.random.default_rng(0)
    frame = rng.integers(0, 256, (20, 30, 3)).astype(np.uint8)
    positions = (rng.random((50, 2)) * [36, 26] - 3).astype(np.float32)
    x, y = np.clip(np.rint(positions).astype(int), 0, [29, 19]).T
    np.testing.assert_array_equal(colours_at(read_only(frame), positions), frame[y, x])
