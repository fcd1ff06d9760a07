"""Specks and pinholes, on maps that can be read."""

from __future__ import annotations

import numpy as np
import pytest

from mlbs_actors.cleaning import clean_labels
from mlbs_actors.messages import Array


def drawn(*rows: str) -> Array:
    """A label map from rows of digits, '.' for the background."""
    return np.array([[0 if mark == "." else int(mark) for mark in row] for row in rows])


def assert_cleaned(before: Array, after: Array, speck_px: float, hole_px: float) -> None:
    np.testing.assert_array_equal(clean_labels(before, speck_px, hole_px), after)


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
    kept = clean_labels(before, speck_px=2, hole_px=0)
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
    cleaned = clean_labels(labels, speck_px=3, hole_px=0)
    np.testing.assert_array_equal(labels, before)
    assert cleaned[0, 0] == 0
    assert cleaned.dtype == labels.dtype


@pytest.mark.parametrize("labels", [np.zeros((4, 5), int), np.full((4, 5), 3), np.zeros((1, 1), int)])
def test_a_map_of_one_label_stays(labels: Array) -> None:
    assert_cleaned(labels, labels, speck_px=100, hole_px=100)
