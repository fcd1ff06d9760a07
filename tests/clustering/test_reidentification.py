"""Colours and places of lost objects."""

from __future__ import annotations

import numpy as np
import pytest
from read_only import read_only

from mlbs_actors.clustering.reidentification import (
    Sighting,
    colour_odds,
    colour_signatures,
    colours_at,
    return_odds,
)
from mlbs_actors.config import IdentityConfig
from mlbs_actors.messages import Array

CONFIG = IdentityConfig()


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


@pytest.mark.parametrize("side", [1, 2, 3])
def test_colours_are_those_of_the_cells_of_the_nearest_pixels_of_the_frame(side: int) -> None:
    rng = np.random.default_rng(0)
    cells = rng.integers(0, 256, (20, 30, 3)).astype(np.uint8)
    frame = cells.repeat(side, axis=0).repeat(side, axis=1)
    positions = (rng.random((50, 2)) * [36, 26] * side - 3 * side).astype(np.float32)
    x, y = np.clip(np.rint(positions).astype(int), 0, [30 * side - 1, 20 * side - 1]).T
    np.testing.assert_array_equal(colours_at(read_only(cells), positions, side), frame[y, x])


def histogram(*shares: float) -> Array:
    return np.array([*shares, *[0.0] * (216 - len(shares))], np.float32)


def test_colours_speak_by_how_much_of_them_two_have_in_common_and_their_amount_says_nothing() -> None:
    odds = [colour_odds(histogram(100), histogram(share, 1 - share), CONFIG) for share in (0, 0.5, 1)]
    assert odds[0] == -CONFIG.most_evidence
    assert odds[1] == pytest.approx(CONFIG.colour_slope * (0.5**0.5 - CONFIG.colour_likeness), abs=1e-5)
    assert odds[2] == pytest.approx(CONFIG.colour_slope * (1 - CONFIG.colour_likeness), abs=1e-5)
    assert colour_odds(histogram(), histogram(1), CONFIG) == -CONFIG.most_evidence


def test_each_lost_object_is_judged_by_the_nearer_of_where_it_was_and_where_it_should_be() -> None:
    where = np.array([[100.0, 100.0], [100.0, 100.0], [635.0, 100.0]])
    speeds = np.array([[0.0, 0.0], [20.0, 0.0], [20.0, 0.0]])
    lost = Sighting(np.zeros(3, np.int64), where, speeds, np.tile(histogram(1), (3, 1)))
    found = return_odds(np.array([600.0, 100.0]), histogram(1), lost, 10, (480, 640), CONFIG)

    def expected(distance: float) -> float:
        near = -CONFIG.place_slope / (1 + 10 / CONFIG.place_frames) * np.log(distance / CONFIG.place_px)
        own = CONFIG.colour_slope * (1 - CONFIG.colour_likeness)
        return float(np.clip(near, -CONFIG.most_evidence, CONFIG.most_evidence) + own)

    # The third one has left the frame: it is not where it was, and seldom comes back.
    left = expected(235) - CONFIG.most_evidence
    assert found == pytest.approx([expected(500), expected(300), left])
