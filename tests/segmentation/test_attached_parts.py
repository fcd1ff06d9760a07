"""Layers that are parts of an object: found, published under its id, and parted again."""

from __future__ import annotations

import numpy as np
import pytest

from mlbs_actors.messages import Array, LayerSummary, Region, Segmentation
from mlbs_actors.segmentation.attached_parts import PartsState, find_parts, join_parts


def picture(*boxes: tuple[int, int, int, int, int]) -> Array:
    """Draw boxes (layer, left, top, right, bottom) on a (240, 320) label map."""
    labels = np.zeros((240, 320), np.uint16)
    for layer, left, top, right, bottom in boxes:
        labels[top:bottom, left:right] = layer
    return labels


REMEMBERED = 10
BODY = (1, 100, 60, 160, 140)
LIMB = (2, 110, 140, 125, 180)


def follow(*maps: Array, live: tuple[int, ...] = (1, 2, 3)) -> list[dict[int, int]]:
    """Give label maps one after the other; return the parts found in each."""
    state, found = PartsState.empty(), []
    for index, labels in enumerate(maps):
        state = find_parts(state, labels, index, live, REMEMBERED)
        found.append(state.objects())
    return found


def test_what_appears_in_contact_with_something_larger_is_its_part() -> None:
    assert follow(picture(BODY), picture(BODY, LIMB)) == [{}, {2: 1}]


def test_in_one_frame_the_smaller_is_the_part() -> None:
    assert follow(picture(BODY, LIMB)) == [{2: 1}]
    larger_but_younger = (1, *LIMB[1:]), (2, *BODY[1:])
    assert follow(picture(*larger_but_younger)) == [{1: 2}]


def test_what_appears_elsewhere_is_none() -> None:
    assert follow(picture(BODY), picture(BODY, (2, 250, 100, 265, 140))) == [{}, {}]


def test_what_is_known_to_be_another_thing_is_no_part_however_it_touches() -> None:
    state = find_parts(PartsState.empty(), picture(BODY), 0, (1, 2), REMEMBERED)
    two = find_parts(state, picture(BODY, LIMB), 1, (1, 2), REMEMBERED, {(1, 2)})
    assert two.objects() == {}
    one = find_parts(state, picture(BODY, LIMB), 1, (1, 2), REMEMBERED)
    assert one.objects() == {2: 1}
    assert find_parts(one, picture(BODY, LIMB), 2, (1, 2), REMEMBERED, {(1, 2)}).objects() == {}


def test_something_nearly_as_large_is_another_object() -> None:
    assert follow(picture(BODY), picture(BODY, (2, 160, 70, 210, 140))) == [{}, {}]


def test_two_that_meet_later_stay_two() -> None:
    far, near = (2, 250, 100, 265, 140), (2, 160, 100, 175, 140)
    apart = [picture(BODY, far)] * 6
    assert follow(*apart, picture(BODY, near))[-1] == {}


@pytest.mark.parametrize(("gap", "expected"), [(0, {2: 1}), (3, {2: 1}), (6, {})])
def test_a_narrow_gap_is_contact(gap: int, expected: dict[int, int]) -> None:
    limb = (2, 110, 140 + gap, 125, 180 + gap)
    assert follow(picture(BODY), picture(BODY, limb))[-1] == expected


def test_soon_after_it_appeared_only_wide_contact_counts() -> None:
    far, beneath, narrow = (2, 110, 160, 125, 165), (2, 110, 140, 125, 145), (2, 110, 140, 115, 180)
    assert follow(picture(BODY, far), picture(BODY, beneath))[-1] == {2: 1}
    assert follow(picture(BODY, far), picture(BODY, narrow))[-1] == {}
    assert follow(*[picture(BODY, far)] * 5, picture(BODY, beneath))[-1] == {}


def test_a_part_that_has_been_apart_for_some_frames_is_an_object_from_there_on() -> None:
    away = picture(BODY, (2, 110, 170, 125, 210))
    found = follow(picture(BODY, LIMB), *[away] * 6, picture(BODY, LIMB), *[away] * 7, picture(BODY, LIMB))
    assert found[:7] == [{2: 1}] * 7
    assert found[7:14] == [{2: 1}] * 7  # the contact in between starts the count again
    assert found[14:] == [{}, {}]


@pytest.mark.parametrize(("bottom", "expected"), [(180, {}), (330, {2: 1})])
def test_most_of_an_object_whose_own_layer_has_vanished_goes_on_as_it(
    bottom: int, expected: dict[int, int]
) -> None:
    limb, whole = (2, 110, 140, 125, 180), picture(BODY, (2, 110, 140, 125, 180))
    rest = picture((limb[0], 110, 30, 125, bottom))
    assert follow(whole, *[rest] * 10)[-1] == expected


def test_of_two_parts_the_larger_goes_on_as_the_vanished_object() -> None:
    halves = picture((2, 90, 60, 130, 140), (3, 200, 60, 240, 130))
    whole = picture(BODY, LIMB, (3, 160, 100, 170, 130))
    assert follow(whole, *[halves] * 10)[-1] == {2: 1}


def test_a_part_of_a_part_belongs_to_the_object() -> None:
    hand = (3, 112, 180, 122, 190)
    assert follow(picture(BODY), picture(BODY, LIMB), picture(BODY, LIMB, hand))[-1] == {2: 1, 3: 1}


def test_an_object_that_becomes_a_part_takes_its_own_along() -> None:
    limb, hand = (2, 110, 160, 140, 175), (3, 112, 175, 122, 185)
    joined = picture((1, 100, 60, 160, 160), limb, hand)
    assert follow(picture(BODY, limb, hand), joined) == [{3: 2}, {2: 1, 3: 1}]


def test_a_layer_that_wakes_has_not_just_appeared_unless_it_slept_for_too_long() -> None:
    far = picture(BODY, (2, 250, 100, 265, 140))
    for asleep, parts in ((REMEMBERED, {}), (REMEMBERED + 1, {2: 1})):
        state = find_parts(PartsState.empty(), far, 0, (1, 2), REMEMBERED)
        for index in range(1, asleep + 1):
            state = find_parts(state, picture(BODY), index, (1,), REMEMBERED)
        assert find_parts(state, picture(BODY, LIMB), asleep + 1, (1, 2), REMEMBERED).objects() == parts


def test_a_part_that_wakes_is_the_part_that_it_was() -> None:
    state = find_parts(PartsState.empty(), picture(BODY, LIMB), 0, (1, 2), REMEMBERED)
    state = find_parts(state, picture(BODY), 1, (1,), REMEMBERED)
    assert find_parts(state, picture(BODY, LIMB), 2, (1, 2), REMEMBERED).objects() == {2: 1}


def test_layers_that_share_an_id_are_no_parts() -> None:
    state = find_parts(PartsState.empty(), picture(BODY, LIMB), 0, (2,), REMEMBERED)
    assert state.layers.tolist() == [2]
    assert state.objects() == {}


def test_of_two_parts_that_are_two_things_the_older_one_goes_on_as_the_object_that_has_vanished() -> None:
    body, head, man = BODY, (2, 110, 40, 150, 60), (3, 110, 140, 160, 200)
    live = (1, 2, 3)
    state = find_parts(PartsState.empty(), picture(body), 0, live, REMEMBERED)
    state = find_parts(state, picture(body, head, man), 1, live, REMEMBERED)
    assert state.objects() == {2: 1, 3: 1}
    for index in range(2, 20):  # what is left is smaller than both were
        state = find_parts(state, picture(head, man), index, live, REMEMBERED, {(2, 3)})
        assert state.objects() == {2: 1}


def test_contact_is_measured_alike_at_any_size() -> None:
    limb = (2, 110, 143, 125, 180)
    maps = picture(BODY), picture(BODY, limb)
    larger = [np.kron(one, np.ones((3, 3), np.uint16)) for one in maps]
    assert follow(*larger) == follow(*maps) == [{}, {2: 1}]


def segmentation(labels: Array, *part_of: int) -> Segmentation:
    """Summarise the layers 1, 2, … of a label map."""
    layers = []
    for layer, whole in enumerate(part_of, start=1):
        rows, columns = np.nonzero(labels == layer)
        box = Region(int(columns.min()), int(rows.min()), int(np.ptp(columns)) + 1, int(np.ptp(rows)) + 1)
        centre = float(columns.mean()), float(rows.mean())
        layers.append(
            LayerSummary(
                layer,
                "object",
                box,
                len(rows),
                centre,
                (float(layer), 0.0),
                layer / 4,
                score=layer / 8,
                part_of=whole,
            )
        )
    maps = np.zeros((1, 1), np.uint8), np.zeros((1, 1), np.int8)
    return Segmentation(5, labels, *maps, tuple(layers), (0.0, 0.0), 0)


def test_published_parts_have_the_id_of_their_object() -> None:
    labels = picture(BODY, LIMB, (3, 250, 100, 265, 140))
    published = join_parts(segmentation(labels, 0, 1, 0))
    np.testing.assert_array_equal(published.labels, np.where(labels == 2, 1, labels))
    whole, other = published.layers
    assert (whole.layer, other.layer) == (1, 3)
    assert (whole.part_of, other.part_of) == (0, 0)
    body, limb = 60 * 80, 15 * 40
    assert whole.area == body + limb
    assert whole.region == Region(100, 60, 60, 120)
    rows, columns = np.nonzero(published.labels == 1)
    assert whole.centroid == pytest.approx((columns.mean(), rows.mean()))
    assert whole.velocity == pytest.approx(((body * 1 + limb * 2) / (body + limb), 0.0))
    assert whole.confidence == pytest.approx((body * 0.25 + limb * 0.5) / (body + limb))
    assert whole.score == pytest.approx(whole.confidence / 2)


def test_a_part_whose_object_shows_no_pixels_keeps_its_id() -> None:
    labels = picture((1, 0, 0, 1, 1), LIMB)
    given = segmentation(labels, 0, 1)
    labels[0, 0] = 0
    alone = Segmentation(5, labels, given.normaliser, given.fallback, given.layers[1:], (0.0, 0.0), 0)
    published = join_parts(alone)
    np.testing.assert_array_equal(published.labels, (labels == 2).astype(np.uint16))
    assert [one.layer for one in published.layers] == [1]


def test_without_parts_nothing_is_copied() -> None:
    given = segmentation(picture(BODY), 0)
    assert join_parts(given) is given
