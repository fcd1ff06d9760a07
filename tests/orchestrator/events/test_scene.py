"""Zones that are fixed to the scene, under a moving camera, against the scene's truth."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from true_results import true_result

from mlbs_actors import MultilayerSubtractor
from mlbs_actors.messages import Array, Segmentation
from mlbs_actors.record.record_tables import read_rows
from mlbs_actors.record.scene_place import ScenePlace
from mlbs_actors.scenes.synthetic import SyntheticScene, scene
from mlbs_actors.source import SourceFrame
from orchestrator.events.scene import SceneTracker, resizing
from orchestrator.events.zones import EventRules, Zone
from orchestrator.sinks.record import StreamRecord
from orchestrator.working_size import enlarged

CORNERS = np.array([[120, 150], [190, 150], [190, 239], [120, 239]], np.float64)
GATE = Zone(name="gate", polygon=tuple(map(tuple, CORNERS.tolist())), fixed_to="scene")
RULES = EventRules((GATE,))
SAVE = frozenset({"parquet"})


@pytest.fixture(scope="module")
def walk() -> SyntheticScene:
    return scene("passer-by", frames=130)


@pytest.fixture(scope="module")
def pictures(walk: SyntheticScene) -> list[Array]:
    return [walk.frame(index) for index in range(len(walk))]


def place_of(made: SyntheticScene, index: int) -> Array:
    """The true homography from the first picture."""
    first, this = (np.vstack([made.surfaces[0].maps[at], [0, 0, 1]]) for at in (0, index))
    return np.asarray(this @ np.linalg.inv(first))


def error(place: ScenePlace | None, true: Array) -> float:
    """How far the gate is from where it should be, px."""
    assert place is not None
    there = cv2.perspectiveTransform(CORNERS[None] - 0.5, true)[0] + 0.5
    return float(np.abs(place.forth(CORNERS) - there).max())


def crossings(walk: SyntheticScene) -> list[int]:
    """The frames in which the walker's foot goes in or out for at least three frames."""
    inside = []
    for index in range(len(walk)):
        y, x = np.nonzero(walk.labels(index))
        foot = ScenePlace.of((240, 320), place_of(walk, index)).back(
            ((int(x.min()) + int(x.max()) + 1) / 2, int(y.max()) + 0.5)
        )
        assert foot is not None
        inside.append(120 <= foot[0] < 190 and 150 <= foot[1] < 239)
    changes, now = [], False
    for index in range(len(inside) - 2):
        if inside[index : index + 3] == [not now] * 3:
            changes.append(index)
            now = not now
    return changes


def delivered(index: int, image: Array) -> SourceFrame:
    return SourceFrame(index, image, index / 10, f"{index:05d}")


def results(pictures: list[Array]) -> Iterator[Segmentation]:
    subtractor = MultilayerSubtractor()
    for picture in pictures:
        yield from subtractor.apply(picture)
    yield from subtractor.flush()


def said(folder: Path) -> list[tuple[str, int, str | None]]:
    events = [json.loads(line) for line in (folder / "events.jsonl").read_text().splitlines()]
    return [(event["kind"], event["frame"], event["zone"]) for event in events]


@pytest.mark.long
def test_a_walker_goes_once_through_a_zone_of_the_scene_while_the_camera_turns(
    tmp_path: Path, walk: SyntheticScene, pictures: list[Array]
) -> None:
    record = StreamRecord(tmp_path, "yard", SAVE, rules=RULES)
    for result in results(pictures):
        record.write(result, delivered(result.frame_index, pictures[result.frame_index]))
    record.close(whole=True)
    of_gate = [(kind, frame) for kind, frame, zone in said(tmp_path) if zone is not None]
    assert [kind for kind, _ in of_gate] == ["entered", "left"]
    true = crossings(walk)
    assert np.abs(np.subtract([frame for _, frame in of_gate], true)).max() <= 3
    places = [row.result.scene for row in read_rows(tmp_path) if row.result is not None]
    assert max(error(place, place_of(walk, index)) for index, place in enumerate(places)) < 1.0


@pytest.mark.long
def test_a_turning_camera_over_a_scene_at_rest_has_no_object(tmp_path: Path) -> None:
    record = StreamRecord(tmp_path, "yard", frozenset(), rules=RULES)
    made = scene("no-mover", frames=80)
    pictures = [made.frame(index) for index in range(80)]
    for result in results(pictures):
        record.write(result, delivered(result.frame_index, pictures[result.frame_index]))
    record.close(whole=True)
    assert {kind for kind, _, _ in said(tmp_path)} <= {"camera moving", "camera still"}


def drifting(walk: SyntheticScene, index: int) -> Segmentation:
    """The true result, but for a camera that is taken to turn faster than it does."""
    back = place_of(walk, index - 1) @ np.linalg.inv(place_of(walk, index)) if index else None
    if back is not None:
        back[0, 2] += 0.25
    return replace(true_result(index, walk.labels(index)), camera=back)


def test_the_views_of_a_scene_hold_up_its_drift(
    tmp_path: Path, walk: SyntheticScene, pictures: list[Array]
) -> None:
    tracker, astray = SceneTracker(tmp_path, 0, None, 0.0), []
    for index, picture in enumerate(pictures):
        tracker.after(index / 10, drifting(walk, index), picture)
        astray.append(error(tracker.place, place_of(walk, index)))
    assert max(astray) < 4  # without views it would be 32
    assert max(astray[10::10]) < 1


def test_a_camera_that_returns_after_a_cut_is_found_again(
    tmp_path: Path, walk: SyntheticScene, pictures: list[Array]
) -> None:
    tracker = SceneTracker(tmp_path, 0, None, 0.0)
    for index in range(12):
        tracker.after(index / 10, drifting(walk, index), pictures[index])
    elsewhere = scene("street", frames=15)
    for index in range(15):
        result = true_result(12 + index, elsewhere.labels(index))
        cut = replace(result, status="ok" if index else "cut", camera=np.eye(3) if index else None)
        tracker.after(1.2 + index / 10, cut, elsewhere.frame(index))
        assert tracker.place is None
    back = replace(true_result(27, walk.labels(20)), status="cut")
    tracker.after(2.7, back, pictures[20])
    assert error(tracker.place, place_of(walk, 20)) < 1


def test_a_killed_record_finds_the_same_places(
    tmp_path: Path, walk: SyntheticScene, pictures: list[Array]
) -> None:
    for name, ends in (("whole", [130]), ("killed", [7, 75, 130])):
        for end in ends:
            record = StreamRecord(tmp_path / name, "yard", SAVE, rules=RULES)
            for index in range(end):
                record.write(drifting(walk, index), delivered(index, pictures[index]))
        record.close(whole=True)
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    assert (killed / "events.jsonl").read_bytes() == (whole / "events.jsonl").read_bytes()
    assert [kind for kind, _, zone in said(whole) if zone] == ["entered", "left"]
    for one, other in zip(read_rows(killed), read_rows(whole), strict=True):
        assert one == other
        assert one.result is not None
        assert one.result.scene is not None


def test_the_camera_of_a_smaller_picture_is_that_of_the_full_one(walk: SyntheticScene) -> None:
    small = drifting(walk, 9)
    large = enlarged(small, (480, 640))
    assert small.camera is not None
    assert large.camera is not None
    point = np.array([[[30.0, 40.0]]])
    enlarging = resizing((240, 320), (480, 640))
    expected = cv2.perspectiveTransform(cv2.perspectiveTransform(point, small.camera), enlarging)
    found = cv2.perspectiveTransform(cv2.perspectiveTransform(point, enlarging), large.camera)
    np.testing.assert_allclose(found, expected)
    np.testing.assert_allclose(
        expected[0, 0], 2 * (cv2.perspectiveTransform(point, small.camera)[0, 0] + 0.5) - 0.5
    )
