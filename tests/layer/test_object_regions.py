"""Where the objects are looked for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from layer_fakes import CAR, SHAPE, WHOLE, frame_of, grid, owned, published, tracks
from read_only import read_only

from mlbs_actors.cells import spread_over_cells
from mlbs_actors.layer import object_regions
from mlbs_actors.layer.object_regions import contested
from mlbs_actors.messages import BACKGROUND, LayerEvidence, Region, Segmentation

#: px of a 640×480 frame: of any object, and of one in full view.
COVERED = 100.0  # px² for each trajectory
MARGINS = (24.0, 8.0)
NOTHING = np.zeros((0, 2), np.float32)


def object_region(
    one: LayerEvidence, previous: Segmentation | None, shape: tuple[int, int], margins: tuple[float, float]
) -> Region:
    return object_regions.object_region(one, shape, previous, (*margins, COVERED), 1)


def test_the_region_is_the_box_of_the_trajectories_with_a_margin_that_grows_with_the_frame() -> None:
    some = tracks(1, np.array([[60, 50], [90, 75.5]], np.float32))
    assert object_region(some, None, SHAPE, (20.0, 20.0)) == Region(55, 45, 41, 37)  # 5 px at this size
    assert object_region(some, None, (480, 640), (20.0, 20.0)) == Region(40, 30, 71, 67)


def test_it_holds_the_published_pixels_moved_by_the_trajectories_or_else_by_their_own_velocity() -> None:
    previous = published(0, owned(CAR), velocity=(-8.0, 4.0))
    asleep = tracks(1, NOTHING)
    assert object_region(asleep, previous, SHAPE, (0.0, 0.0)) == Region(CAR.x - 8, CAR.y + 4, 41, 31)
    tracked = tracks(1, np.array([[80.0, 50.0]], np.float32), motion=(-3.0, 0.0))
    assert object_region(tracked, previous, SHAPE, (0.0, 0.0)) == Region(CAR.x + 3, CAR.y, 41, 31)


def test_without_trajectories_and_pixels_it_is_empty() -> None:
    for previous in (None, published(0, owned(CAR, 2))):
        assert object_region(tracks(1, NOTHING), previous, SHAPE, (40.0, 40.0)).area == 0


def test_it_ends_at_the_frame_and_is_empty_beyond() -> None:
    corner = tracks(1, np.array([[1, 2], [158, 20]], np.float32))
    assert object_region(corner, None, SHAPE, (40.0, 40.0)) == Region(0, 0, 160, 31)
    gone = published(0, owned(CAR), velocity=(500.0, 0.0))
    assert object_region(tracks(1, NOTHING), gone, SHAPE, (40.0, 40.0)).area == 0


def test_an_object_in_full_view_has_a_narrow_region() -> None:
    seen = published(0, owned(CAR))
    covered = tracks(1, grid(CAR, 2))

    def margin(one: LayerEvidence, previous: Segmentation | None, car: Region = CAR) -> int:
        return car.x - object_region(one, previous, SHAPE, MARGINS).x

    assert margin(covered, seen) == 2  # at this size
    assert margin(covered, None) == 6 - 2, "new: around its trajectories, which begin 2 px further right"
    few = replace(covered, positions=covered.positions[:2], motions=covered.motions[:2])
    assert margin(few, seen) == 6, "its trajectories are lost, as of what passes behind something"
    entering = Region(20, SHAPE[0] - CAR.height, CAR.width, CAR.height)
    assert margin(tracks(1, grid(entering, 2)), published(0, owned(entering)), entering) == 6, "at the border"
    assert object_region(covered, seen, SHAPE, (4.0, 8.0)) == object_region(covered, seen, SHAPE, (4.0, 4.0))


def test_the_region_is_wider_by_what_leaves_the_objects_motion() -> None:
    seen, covered = published(0, owned(CAR)), tracks(1, grid(CAR, 2))

    def margin(by: float) -> int:
        motions = covered.motions.copy()
        motions[5] += np.float32(by), np.float32(0)
        motions[7] += np.float32(0), np.float32(-by / 2)
        return CAR.x - object_region(replace(covered, motions=read_only(motions)), seen, SHAPE, MARGINS).x

    assert [margin(by) for by in (0.0, 3.0, -3.0, 50.0)] == [2, 5, 5, 6]  # at most that of any object


def test_contested_is_the_union_of_the_objects_regions_and_of_no_others() -> None:
    far = Region(5, 90, 20, 20)
    everyone = [tracks(BACKGROUND, grid(WHOLE)), tracks(1, grid(CAR)), tracks(2, grid(far))]
    other = replace(tracks(3, np.array([[150.0, 10.0]], np.float32)), kind="other")
    previous = published(0, owned(Region(100, 5, 6, 6)))
    box, found = contested(frame_of([*everyone, other], 1), previous, (*MARGINS, COVERED))
    expected = np.zeros(SHAPE, bool)
    for one in (*everyone[1:], other):
        expected[object_region(one, previous, SHAPE, MARGINS).slices] = True
    np.testing.assert_array_equal(found, expected[box.slices])
    assert found.sum() == expected.sum()
    box, found = contested(frame_of([*everyone, other], 1), previous, (*MARGINS, COVERED), 2)
    held = spread_over_cells(found, 2, (box.height, box.width))
    assert held[expected[box.slices]].all()
    assert expected.sum() < held.sum() < 1.2 * expected.sum()
    assert contested(frame_of(everyone[:1], 1), None, (*MARGINS, COVERED))[0].area == 0
