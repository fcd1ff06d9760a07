"""Specks and pinholes, on maps that can be read."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
import pytest

from mlbs_actors.messages import Array, Region
from mlbs_actors.segmentation.cleaning import clean_labels


def drawn(*rows: str) -> Array:
    """A label map from rows of digits, '.' for the background."""
    return np.array([[0 if mark == "." else int(mark) for mark in row] for row in rows])


def cleaned(labels: Array, speck_px: float, hole_px: float) -> Array:
    return cleaned_in(labels, Region(0, 0, labels.shape[1], labels.shape[0]), speck_px, hole_px)


def cleaned_in(
    labels: Array, box: Region, speck_px: float, hole_px: float, tracks: Sequence[tuple[int, int, int]] = ()
) -> Array:
    """What a box then holds; nothing changes outside it."""
    result = labels.astype(np.uint16)
    found = np.array(tracks, np.int64).reshape(-1, 3)
    clean_labels(result, (box.x, box.y, box.width, box.height), float(speck_px), float(hole_px), found, 2)
    inside = result[box.slices].copy()
    result[box.slices] = labels[box.slices]
    np.testing.assert_array_equal(result, labels)
    return inside


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


@pytest.mark.parametrize("labels", [np.zeros((4, 5), int), np.full((4, 5), 3), np.zeros((1, 1), int)])
def test_a_map_of_one_label_stays(labels: Array) -> None:
    assert_cleaned(labels, labels, speck_px=100, hole_px=100)


@pytest.mark.parametrize("corner", [(0, 0), (0, 12), (10, 0), (9, 5)])
def test_a_box_is_cleaned_as_in_the_whole_frame(corner: tuple[int, int]) -> None:
    for seed in range(5):
        rng = np.random.default_rng(seed)
        blobs = rng.integers(0, 4, (10, 14)) * (rng.random((10, 14)) < 0.6)
        before = np.zeros((24, 32), np.uint16)
        before[corner[0] : corner[0] + 10, corner[1] : corner[1] + 14] = blobs
        y, x = max(corner[0] - 1, 0), max(corner[1] - 1, 0)
        box = Region(x, y, corner[1] + 15 - x, corner[0] + 11 - y)
        after = cleaned(before, speck_px=4, hole_px=12)
        assert (after != before).any()
        np.testing.assert_array_equal(cleaned_in(before, box, 4, 12), after[box.slices])


def test_background_that_goes_on_outside_the_box_is_no_hole() -> None:
    before = np.zeros((12, 12), np.uint16)
    before[2:6, :] = 1
    before[0, 3:5] = 1
    box = Region(0, 0, 12, 7)
    assert not cleaned_in(before, box, speck_px=0, hole_px=20)[6].any()


def slowly_cleaned(labels: Array, box: Region, speck_px: float, hole_px: float) -> Array:
    """Components by flood fill, their neighbours one by one."""
    result = labels[box.slices].copy()
    before = result.copy()
    seen: set[tuple[int, int]] = set()
    components: dict[int, list[list[tuple[int, int]]]] = {}
    for y, x in np.ndindex(before.shape):
        if (y, x) in seen:
            continue
        seen.add((y, x))
        component = [(y, x)]
        for v, u in component:
            for near in ((v - 1, u), (v + 1, u), (v, u - 1), (v, u + 1)):
                inside = 0 <= near[0] < box.height and 0 <= near[1] < box.width
                if inside and near not in seen and before[near] == before[y, x]:
                    seen.add(near)
                    component.append(near)
        components.setdefault(int(before[y, x]), []).append(component)

    def goes_on(component: list[tuple[int, int]]) -> bool:
        near = [
            (y + box.y + v, x + box.x + u)
            for y, x in component
            for v, u in ((1, 0), (-1, 0), (0, 1), (0, -1))
        ]
        return any(
            0 <= y < labels.shape[0] and 0 <= x < labels.shape[1]
            and not (box.y <= y < box.y + box.height and box.x <= x < box.x + box.width)
            for y, x in near
        )  # fmt: skip

    for label in sorted(components, reverse=True):
        outside = labels.size - box.area if label == 0 else 0
        areas = [len(one) + outside * goes_on(one) for one in components[label]]
        for number, (component, area) in enumerate(zip(components[label], areas, strict=True)):
            if number == areas.index(max(areas)) or area >= (speck_px if label else hole_px):
                continue
            around = {(y + v, x + u) for y, x in component for v in (-1, 0, 1) for u in (-1, 0, 1)}
            votes = [
                int(result[y, x])
                for y, x in sorted(around - set(component))
                if 0 <= y < box.height and 0 <= x < box.width
            ]
            if votes:
                for place in component:
                    result[place] = min(set(votes), key=lambda one: (-votes.count(one), one))
    return result


def test_a_box_of_random_patches_is_cleaned_as_by_flood_fill() -> None:
    for seed in range(12):
        rng = np.random.default_rng(seed)
        height, width = (int(side) for side in rng.integers(8, 30, 2))
        patches = [
            cv2.GaussianBlur(rng.normal(size=(height, width)), (0, 0), float(rng.choice([0.6, 1.5])))
            for _ in range(4)
        ]
        x, y = (int(corner) for corner in rng.integers(0, 3, 2))
        box = Region(x, y, width - x - int(rng.integers(3)), height - y - int(rng.integers(3)))
        inside = np.zeros((height, width), bool)
        top, left = box.y + (box.y > 0), box.x + (box.x > 0)
        bottom, right = (
            end - (end < whole) for end, whole in ((box.y + box.height, height), (box.x + box.width, width))
        )
        inside[top:bottom, left:right] = True
        labels = np.where(inside, np.array([0, 2, 5, 9])[np.argmax(patches, axis=0)], 0).astype(np.uint16)
        speck_px, hole_px = (float(limit) for limit in rng.integers(1, 30, 2))
        expected = slowly_cleaned(labels, box, speck_px, hole_px)
        np.testing.assert_array_equal(cleaned_in(labels, box, speck_px, hole_px), expected)


STRAY = drawn(
    "............",
    ".111.22222..",
    ".111.21122..",
    ".111.21122..",
    ".....22222..",
    "............",
)


@pytest.mark.parametrize(
    ("tracks", "stays"),
    [
        ([(2, 6, 2), (3, 7, 2)], False),
        ([(2, 6, 2)], True),  # one may be a mistake
        ([(2, 6, 2), (3, 7, 2), (3, 6, 1)], True),
        ([(1, 6, 2), (4, 7, 2)], True),  # beside it
        ([(2, 6, 3), (3, 7, 2)], True),  # of two objects
    ],
)
def test_a_part_that_holds_only_trajectories_of_another_object_is_that_objects(
    tracks: list[tuple[int, int, int]], stays: bool
) -> None:
    whole = Region(0, 0, STRAY.shape[1], STRAY.shape[0])
    expected = STRAY.copy()
    if not stays:
        expected[2:4, 6:8] = 2
    np.testing.assert_array_equal(cleaned_in(STRAY, whole, 0, 0, tracks), expected)
    part = Region(4, 1, 8, 4)
    np.testing.assert_array_equal(cleaned_in(STRAY, part, 0, 0, tracks), expected[part.slices])
