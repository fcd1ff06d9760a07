"""What cannot work is told with the stream's first picture."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from true_results import true_result

from mlbs_actors.record.frame_row import FrameRow, ResultRow
from mlbs_actors.record.scene_place import ScenePlace
from orchestrator.events.event import Event
from orchestrator.events.happenings import Happenings
from orchestrator.events.zones import EventRules, Zone


def row(index: int, shape: tuple[int, int] = (360, 640)) -> FrameRow:
    result = ResultRow.of(true_result(index, np.zeros(shape, np.uint8)), 1.0)
    return FrameRow(index, index / 5, "ok", result)


def faults(happenings: Happenings, *rows: FrameRow) -> list[Event]:
    return [event for one in rows for event in happenings.after(one) if event.kind == "fault"]


LARGE = Zone(name="yard", polygon=((100, 100), (1200, 100), (1200, 700)))


def test_a_zone_outside_the_picture_is_told_once_with_the_pictures_size() -> None:
    happenings = Happenings(EventRules((LARGE,)))
    gap = FrameRow(0, 0.0, "gap")
    [fault] = faults(happenings, gap, row(1), row(2), row(3))
    assert (fault.frame, fault.zone) == (1, "yard")
    assert fault.reason == (
        "the zone 'yard' lies partly outside the picture, which has 640 x 360 px: it reaches to 1200, 700; "
        "write it in px of that size, or in shares from 0 to 1"
    )


@pytest.mark.parametrize(
    ("zone", "how"),
    [
        (Zone(name="a", polygon=((0, 0), (1, 0), (1, 1))), None),
        (Zone(name="a", polygon=((0, 0), (640, 0), (640, 360))), None),
        (Zone(name="a", polygon=((0, 0), (671, 0), (671, 377))), None),  # by a hand that is not exact
        (Zone(name="a", polygon=((0, 0), (680, 0), (640, 360))), "partly"),
        (Zone(name="a", polygon=((700, 10), (900, 10), (900, 90))), "wholly"),
        (Zone(name="a", polygon=((10, 400), (90, 400), (90, 500))), "wholly"),
        (Zone(name="a", kind="line", polygon=((10, 10), (10, 500))), "partly"),
    ],
)
def test_what_reaches_out_by_more_than_a_little_is_outside(zone: Zone, how: str | None) -> None:
    said = faults(Happenings(EventRules((zone,))), row(0))
    assert [f"lies {how} outside" in (one.reason or "") for one in said] == ([] if how is None else [True])


def test_it_is_told_again_of_other_zones_and_of_a_smaller_picture() -> None:
    happenings = Happenings(EventRules((LARGE,)))
    assert len(faults(happenings, row(0), row(1))) == 1
    happenings.configured(EventRules((LARGE, LARGE.model_copy(update={"name": "road"}))))
    assert [fault.zone for fault in faults(happenings, row(2), row(3))] == ["yard", "road"]
    fits = Happenings(EventRules((LARGE,)))
    assert faults(fits, row(0, (720, 1280))) == []
    assert [fault.frame for fault in faults(fits, row(1), row(2))] == [1]


def test_a_zone_of_the_scene_is_drawn_in_the_first_picture() -> None:
    happenings = Happenings(EventRules((LARGE.model_copy(update={"fixed_to": "scene"}),)))
    unknown, known = row(0), row(1)
    assert known.result is not None
    place = ScenePlace.of((360, 640), np.eye(3))
    [fault] = faults(happenings, unknown, replace(known, result=replace(known.result, scene=place)))
    assert fault.frame == 1
