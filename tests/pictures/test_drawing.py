"""Labels as people see them: colours that can be told apart, outlines and ids on any video."""

from __future__ import annotations

from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from mlbs_actors.errors import FrameError
from mlbs_actors.messages import Array, Region
from mlbs_actors.pictures.drawing import draw_box, draw_caption, draw_labels, draw_outlines
from mlbs_actors.pictures.layer_colours import COLOURS, layer_colour
from orchestrator.events.outlines import outlines
from orchestrator.events.zones import Zone


def lab(colours: Array) -> Array:
    """L*a*b* of (n, 3) BGR colours."""
    converted: Array = cv2.cvtColor(colours[None].astype(np.float32) / 255, cv2.COLOR_BGR2LAB)[0]
    return converted


def square(side: int = 60, layer: int = 1) -> Array:
    labels = np.zeros((side, side), np.uint16)
    labels[side // 4 : side * 3 // 4, side // 4 : side * 3 // 4] = layer
    return labels


def test_the_colours_are_light_and_those_of_the_first_objects_are_far_from_each_other() -> None:
    colours = lab(np.array([layer_colour(layer) for layer in range(1, COLOURS + 1)]))
    assert colours[:, 0].min() > 60
    apart = np.linalg.norm(colours[:, None] - colours[None], axis=2)
    np.fill_diagonal(apart, np.inf)
    assert apart[:8, :8].min() > 40  # 2 to 3 can be told apart side by side
    assert apart.min() > 10


@pytest.mark.parametrize("layer", [1, 64, 65, 255, 256, 40000, 65535])
def test_a_layer_of_any_id_is_visible(layer: int) -> None:
    assert lab(np.array([layer_colour(layer)]))[0, 0] > 60
    drawn = draw_labels(np.full((9, 9, 3), 100, np.uint8), np.full((9, 9), layer, np.uint16))
    assert (drawn != 100).any()


def test_layers_are_tinted_and_the_background_beyond_their_rim_is_untouched() -> None:
    image = np.full((60, 60, 3), 100, np.uint8)
    labels = square(layer=7)
    drawn = draw_labels(image, labels)
    beyond = cv2.dilate(labels, np.ones((3, 3))) == 0
    np.testing.assert_array_equal(drawn[beyond], image[beyond])
    assert drawn[18, 18].tolist() == np.round(0.6 * image[18, 18] + 0.4 * np.array(layer_colour(7))).tolist()
    assert (image == 100).all()


@pytest.mark.parametrize("grey", [0, 128, 255])
def test_an_outline_has_a_light_and_a_dark_side_on_any_video(grey: int) -> None:
    drawn = draw_labels(np.full((60, 60, 3), grey, np.uint8), square(layer=2))
    assert tuple(drawn[15, 30].tolist()) == layer_colour(2)
    assert drawn[14, 30].tolist() == [0, 0, 0]


def test_two_layers_that_touch_are_told_apart_by_an_outline() -> None:
    labels = square()
    labels[:, 30:] = np.where(labels[:, 30:] > 0, 2, 0)
    drawn = draw_labels(np.zeros((60, 60, 3), np.uint8), labels)
    assert tuple(drawn[18, 30].tolist()) == layer_colour(2)


def test_a_dark_rim_never_lies_on_another_layer() -> None:
    labels = np.zeros((60, 90), np.uint16)
    labels[10:50, 10:40], labels[10:50, 40:80] = 1, 2
    drawn = draw_labels(np.full((60, 90, 3), 200, np.uint8), labels)
    assert (drawn[10:50, 39] == layer_colour(1)).all()
    assert (drawn[10:50, 40] == layer_colour(2)).all()


def test_boxes_that_are_known_need_not_be_looked_for() -> None:
    image, labels = np.full((60, 60, 3), 100, np.uint8), square(layer=7)
    labels[0:9, 50:60] = 300
    regions = {7: Region(15, 15, 30, 30), 300: Region(50, 0, 10, 9)}
    np.testing.assert_array_equal(draw_labels(image, labels, regions), draw_labels(image, labels))


@pytest.mark.parametrize("grey", [0, 128, 255])
def test_each_id_is_written_on_its_own_object_in_white_with_a_black_rim(grey: int) -> None:
    image = np.full((200, 200, 3), grey, np.uint8)
    plain = draw_labels(image, square(200, 3))
    other = draw_labels(image, square(200, 3 + COLOURS))  # the same colour, another number
    rows, columns = np.nonzero((plain != other).any(axis=2))
    assert len(rows) > 10
    assert 80 < rows.min() <= rows.max() < 120
    assert 80 < columns.min() <= columns.max() < 120
    written = plain[80:120, 80:120].reshape(-1, 3).tolist()
    assert [255, 255, 255] in written
    assert [0, 0, 0] in written


def test_the_id_of_an_object_that_is_hollow_lies_on_the_object() -> None:
    labels = square(240, 5)
    labels[70:170, 70:170] = 0
    empty = draw_labels(np.zeros((240, 240, 3), np.uint8), labels)[80:160, 80:160]
    assert (empty == 0).all()


@pytest.mark.parametrize("shape", [(1, 1), (1, 40), (7, 3), (30, 2000)])
def test_pictures_of_any_size_can_be_drawn_on(shape: tuple[int, int]) -> None:
    drawn = draw_labels(np.zeros((*shape, 3), np.uint8), np.full(shape, 1234, np.uint16))
    draw_caption(drawn, "frame 1000000")
    assert drawn.shape == (*shape, 3)


def test_a_caption_is_written_into_the_upper_left_corner() -> None:
    picture = np.full((240, 320, 3), 90, np.uint8)
    draw_caption(picture, "frame 12")
    rows, columns = np.nonzero((picture != 90).any(axis=2))
    assert rows.max() < 30
    assert columns.max() < 120


def test_a_zone_is_drawn_thin_where_it_is_in_a_smaller_picture_too() -> None:
    zone = Zone(name="z", polygon=((0.25, 0.25), (0.75, 0.25), (0.75, 0.75), (0.25, 0.75)))
    fence = Zone(name="f", kind="line", polygon=((80, 360), (720, 360)))
    drawn = np.full((200, 400, 3), 100, np.uint8)
    draw_outlines(drawn, outlines([zone, fence], (400, 800), scale=0.5))
    assert (drawn[50, 120:280] > 200).all()
    assert (drawn[60:80, 100] > 200).all()
    assert (drawn[180, 50:150] > 200).all()
    assert (drawn[180, :30] == 100).all()
    assert (drawn == 100).all(axis=2).mean() > 0.9


def test_a_caption_that_is_too_long_is_written_smaller() -> None:
    picture = np.full((240, 160, 3), 90, np.uint8)
    draw_caption(picture, "2026-05-04 11:15:31.7 CEST")
    written = np.nonzero((picture > 150).all(axis=2))
    assert written[1].max() < 158
    assert written[0].max() < 16


def test_without_ids_only_tints_and_outlines_are_drawn() -> None:
    labels = square(200, 3)
    plain = draw_labels(np.zeros((200, 200, 3), np.uint8), labels, ids=False)
    assert not (plain == 255).all(axis=2).any()
    assert len(np.unique(plain[60:140, 60:140].reshape(-1, 3), axis=0)) == 1


@pytest.mark.parametrize("top", [0, 40, 170])
def test_a_box_has_the_colour_of_its_object_and_the_id_beside_it(top: int) -> None:
    picture = np.full((240, 320, 3), 90, np.uint8)
    draw_box(picture, (100, top, 60, 70), 7)
    colour = (picture == layer_colour(7)).all(axis=2)
    assert colour[top + 35, 98:102].any()
    assert not colour[:, 105:155].all(axis=0).any()
    assert (picture[top + 10 : top + 60, 110:150] == 90).all()
    digits = (picture == 255).all(axis=2)
    assert digits.any()
    without = np.full((240, 320, 3), 90, np.uint8)
    draw_box(without, (100, top, 60, 70), 7, ids=False)
    assert not (without == 255).all(axis=2).any()


def test_what_is_no_picture_with_its_label_map_is_told() -> None:
    image, labels = np.zeros((20, 30, 3), np.uint8), np.zeros((20, 30), np.uint16)
    with pytest.raises(FrameError, match=r"the picture, .* and then the label map"):
        draw_labels(labels, image)
    with pytest.raises(FrameError, match=r"picture is 30×20 px, the label map 30×10; .* of one frame"):
        draw_labels(image, labels[:10])
    with pytest.raises(FrameError, match=r"not a SimpleNamespace; give result\.labels"):
        draw_labels(image, SimpleNamespace(labels=labels))  # type: ignore[arg-type]
