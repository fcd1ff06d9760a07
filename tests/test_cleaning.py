"""Specks and pinholes, on maps that can be read."""

from __future__ import annotations

import numpy as np
import pytest

from mlbs_actors.cleaning import clean_labels
from mlbs_actors.messages import Array, Region


def drawn(*rows: str) -> Array:
    """A label map from rows of digits, '.' for the background."""
    return np.array([[0 if mark == "." else int(mark) for mark in row] for row in rows])


def cleaned(labels: Array, speck_px: float, hole_px: float) -> Array:
    return clean_labels(labels, Region(0, 0, labels.shape[1], labels.shape[0]), speck_px, hole_px)


def assert_cleaned(before: Array, after: Array, speck_px: float, hole_px: float) -> None:
    np.testing.assert_array_equal(cleaned(before, speck_px, hole_px), after)


def test_a_speck_goes_to_what_surrounds_it() -> None:
    before = drawn(
        "..........",
        ".1...222..",
        ".....222..",
        "..11.222..",
        "..11..1...",
        "..........",
    )
    after = drawn(
        "..........",
        ".....222..",
        ".....222..",
        "..11.222..",
        "..11......",
        "..........",
    )
    assert_cleaned(before, after, speck_px=2, hole_px=0)


def test_a_hole_is_filled_by_what_surrounds_it_and_a_large_one_is_not() -> None:
    before = drawn(
        "...........",
        ".111111111.",
        ".1.11....1.",
        ".1111....1.",
        ".11111..11.",
        ".111111111.",
        "...........",
    )
    after = drawn(
        "...........",
        ".111111111.",
        ".1111....1.",
        ".1111....1.",
        ".11111..11.",
        ".111111111.",
        "...........",
    )
    assert_cleaned(before, after, speck_px=0, hole_px=5)
    assert_cleaned(before, drawn(*["...........", *[".111111111."] * 5, "..........."]), 0, 11)


def test_the_longest_common_border_decides() -> None:
    before = drawn(
        "11111222",
        "11111222",
        "11...222",
        "11111222",
        "11111222",
        "........",
    )
    after = drawn(
        "11111222",
        "11111222",
        "11111222",
        "11111222",
        "11111222",
        "........",
    )
    assert_cleaned(before, after, speck_px=0, hole_px=5)


def test_a_speck_inside_another_object_becomes_that_object() -> None:
    before = drawn(
        "2222222...",
        "2222222...",
        "2212222.11",
        "2222222.11",
        "2222222.11",
    )
    after = drawn(
        "2222222...",
        "2222222...",
        "2222222.11",
        "2222222.11",
        "2222222.11",
    )
    assert_cleaned(before, after, speck_px=3, hole_px=0)


def test_the_largest_part_of_a_label_is_never_a_speck() -> None:
    before = drawn(
        "..........",
        "..1.......",
        "..1....2..",
        "..........",
    )
    assert_cleaned(before, before, speck_px=50, hole_px=50)


def test_the_largest_part_of_the_background_is_never_a_hole() -> None:
    before = drawn("1111", "1..1", "1111")
    assert_cleaned(before, before, speck_px=50, hole_px=50)


def test_pixels_that_touch_at_a_corner_only_are_two_parts() -> None:
    before = drawn(
        "11....",
        "11....",
        "..1...",
        "......",
    )
    kept = cleaned(before, speck_px=2, hole_px=0)
    assert kept[:2, :2].all()
    assert kept[2, 2] == 0


def test_a_part_at_the_border_of_the_frame_is_treated_alike() -> None:
    before = drawn(
        "1...11",
        "....11",
        "......",
        ".....1",
    )
    after = drawn(
        "....11",
        "....11",
        "......",
        "......",
    )
    assert_cleaned(before, after, speck_px=2, hole_px=0)


@pytest.mark.parametrize("seed", range(3))
def test_limits_of_nothing_change_nothing(seed: int) -> None:
    labels = np.random.default_rng(seed).integers(0, 4, (20, 30))
    assert_cleaned(labels, labels, speck_px=0, hole_px=0)


def test_parts_of_just_the_limit_stay() -> None:
    before = drawn("11..1", "11..1", ".....")
    assert_cleaned(before, before, speck_px=2, hole_px=0)
    assert_cleaned(before, drawn("11...", "11...", "....."), speck_px=2.5, hole_px=0)


def test_the_given_map_is_left_as_it_was() -> None:
    before = drawn("1.11", "..11", "....")
    labels = before.copy()
    after = cleaned(labels, speck_px=3, hole_px=0)
    np.testing.assert_array_equal(labels, before)
    assert after[0, 0] == 0
    assert after.dtype == labels.dtype


@pytest.mark.parametrize("labels", [np.zeros((4, 5), int), np.full((4, 5), 3), np.zeros((1, 1), int)])
def test_a_map_of_one_label_stays(labels: Array) -> None:
    assert_cleaned(labels, labels, speck_px=100, hole_px=100)


@pytest.mark.parametrize("corner", [(0, 0), (0, 12), (10, 0), (9, 5)])
@pytest.mark.parametrize("seed", range(5))
def test_a_box_is_cleaned_as_in_the_whole_frame(seed: int, corner: tuple[int, int]) -> None:
    rng = np.random.default_rng(seed)
    blobs = rng.integers(0, 4, (10, 14)) * (rng.random((10, 14)) < 0.6)
    before = np.zeros((24, 32), np.uint16)
    before[corner[0] : corner[0] + 10, corner[1] : corner[1] + 14] = blobs
    y, x = max(corner[0] - 1, 0), max(corner[1] - 1, 0)
    box = Region(x, y, corner[1] + 15 - x, corner[0] + 11 - y)
    after = cleaned(before, speck_px=4, hole_px=12)
    assert (after != before).any()
    np.testing.assert_array_equal(clean_labels(before, box, 4, 12), after[box.slices])


def test_background_that_goes_on_outside_the_box_is_no_hole() -> None:
    before = np.zeros((12, 12), np.uint16)
    before[2:6, :] = 1
    before[0, 3:5] = 1
    box = Region(0, 0, 12, 7)
    assert not clean_labels(before, box, speck_px=0, hole_px=20)[6].any()
