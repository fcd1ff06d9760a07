"""Pictures of events: the object in its box with what is around it, its zone, and the time."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from mlbs_actors.messages import Array, LayerSummary, Region
from mlbs_actors.pictures.drawing import Outline
from mlbs_actors.pictures.layer_colours import layer_colour
from orchestrator.events.file_names import PICTURES, picture_name
from orchestrator.events.pictures import EventPictures, Pictured

TIME = "2026-05-04 11:15:31.7 CEST"


def thing(region: Region) -> LayerSummary:
    return LayerSummary(
        layer=12,
        kind="object",
        region=region,
        area=region.width * region.height,
        centroid=(region.x + region.width / 2, region.y + region.height / 2),
        velocity=(0.0, 0.0),
        confidence=1.0,
        score=1.0,
    )


def written(folder: Path, image: Array, pictured: Pictured, *, ids: bool = True) -> Array:
    EventPictures(folder, ids=ids).write(image, 7, TIME, [pictured])
    picture = cv2.imread(str(folder / picture_name(7, 12)))
    assert picture is not None
    return np.asarray(picture)


def near(picture: Array, colour: tuple[int, ...], most: int = 40) -> Array:
    return np.asarray(np.abs(picture.astype(int) - colour).max(axis=2) < most)


@pytest.mark.parametrize("shape", [(480, 640), (1080, 1920), (240, 320), (480, 270)])
@pytest.mark.parametrize("place", [(0.0, 0.0), (0.5, 0.4), (0.93, 0.8)])
def test_a_picture_has_480_px_the_object_in_its_box_and_the_time(
    tmp_path: Path, shape: tuple[int, int], place: tuple[float, float]
) -> None:
    height, width = shape
    region = Region(int(place[0] * width), int(place[1] * height), width // 16, height // 6)
    image = np.full((*shape, 3), 90, np.uint8)
    image[region.slices] = (0, 0, 250)
    picture = written(tmp_path, image, Pictured(thing(region)))
    assert max(picture.shape[:2]) == 480
    assert min(picture.shape[:2]) >= 200
    inside = near(picture, (0, 0, 250), 60)
    assert inside.mean() > 0.03
    box = near(picture, layer_colour(12), 70)
    ys, xs = np.nonzero(inside)
    assert box[max(ys.min() - 8, 0) : ys.max() + 9, max(xs.min() - 8, 0) : xs.max() + 9].sum() > 100
    assert (picture[:16, :150] > 220).all(axis=2).sum() > 100  # the time


def test_the_zone_of_the_event_is_outlined(tmp_path: Path) -> None:
    image = np.full((480, 640, 3), 90, np.uint8)
    corners = np.array([[250.0, 200.0], [400.0, 200.0], [400.0, 330.0], [250.0, 330.0]])
    one = thing(Region(300, 220, 40, 100))
    plain = written(tmp_path, image, Pictured(one))
    outlined = written(tmp_path, image, Pictured(one, [Outline("yard", corners)]))
    changed = np.abs(outlined.astype(int) - plain).max(axis=2) > 60
    scale = outlined.shape[0] / 200  # twice the box
    left = round((250 - (320 - outlined.shape[1] / scale / 2)) * scale)
    assert changed[round(60 * scale) : round(140 * scale), left - 2 : left + 3].any(axis=1).mean() > 0.95


def test_the_id_can_be_left_out(tmp_path: Path) -> None:
    image = np.full((480, 640, 3), 90, np.uint8)
    one = Pictured(thing(Region(300, 220, 40, 100)))
    white = [(written(tmp_path, image, one, ids=ids)[40:] > 230).all(axis=2).sum() for ids in (True, False)]
    assert white[0] > white[1] + 20


def test_pictures_of_long_runs_are_deleted_in_the_order_of_their_frames(tmp_path: Path) -> None:
    (tmp_path / PICTURES).mkdir()
    frames = (99_990_000, 100_000_010, 100_000_020)
    for frame in frames:
        (tmp_path / picture_name(frame, 3)).write_bytes(b"")
    EventPictures(tmp_path).forget_before(100_000_020)
    assert [(tmp_path / picture_name(frame, 3)).exists() for frame in frames] == [False, False, True]
