"""Groups of regions against plain sets of pixels."""

from __future__ import annotations

import numpy as np

from mlbs_actors.geometry.boxes import RegionGroup, group_regions, slices_in
from mlbs_actors.messages import Region

SHAPE = (60, 80)


def random_regions(seed: int) -> list[Region]:
    rng = np.random.default_rng(seed)
    corners = rng.integers(0, (70, 50), (6, 2))
    sizes = rng.integers(0, 14, (6, 2))
    return [
        Region(int(x), int(y), int(min(width, 80 - x)), int(min(height, 60 - y)))
        for (x, y), (width, height) in zip(corners, sizes, strict=True)
    ]


def test_every_region_and_its_neighbours_lie_in_exactly_one_box() -> None:
    for seed in range(30):
        regions = random_regions(seed)
        groups = group_regions(regions, SHAPE)
        covered = np.zeros(SHAPE, int)
        for group in groups:
            covered[group.box.slices] += 1
            for member in group.members:
                near = np.zeros((62, 82), bool)
                one = regions[member]
                near[one.y : one.y + one.height + 2, one.x : one.x + one.width + 2] = True
                near[1:-1, 1:-1][group.box.slices] = False
                assert not near[1:-1, 1:-1].any()
        assert covered.max(initial=0) <= 1
        members = [member for group in groups for member in group.members]
        assert sorted(members) == [k for k, one in enumerate(regions) if one.area]
        assert [group.members for group in groups] == sorted(tuple(sorted(group.members)) for group in groups)


def test_regions_apart_by_two_pixels_are_independent_and_nearer_ones_are_not() -> None:
    left = Region(10, 10, 5, 5)
    apart = group_regions([left, Region(17, 10, 5, 5)], SHAPE)
    assert apart == [RegionGroup(Region(9, 9, 7, 7), (0,)), RegionGroup(Region(16, 9, 7, 7), (1,))]
    assert group_regions([left, Region(16, 10, 5, 5)], SHAPE) == [RegionGroup(Region(9, 9, 13, 7), (0, 1))]


def test_a_third_region_joins_two_that_are_apart() -> None:
    regions = [Region(0, 0, 30, 4), Region(20, 20, 10, 10), Region(26, 3, 4, 20)]
    assert [group.members for group in group_regions(regions[:2], SHAPE)] == [(0,), (1,)]
    assert group_regions(regions, SHAPE) == [RegionGroup(Region(0, 0, 31, 31), (0, 1, 2))]


def test_no_regions_make_no_groups() -> None:
    assert group_regions([], SHAPE) == group_regions([Region(3, 3, 0, 7)], SHAPE) == []


def test_a_region_is_cut_out_of_an_array_of_the_box_around_it() -> None:
    box, region = Region(3, 4, 10, 8), Region(8, 4, 5, 2)
    frame = np.arange(60 * 80).reshape(SHAPE)
    np.testing.assert_array_equal(frame[box.slices][slices_in(region, box)], frame[region.slices])
