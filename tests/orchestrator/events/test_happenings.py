"""The events of made scenes, against their truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from true_results import true_result

from mlbs_actors.messages import Array
from mlbs_actors.record.frame_row import FrameRow, ResultRow
from mlbs_actors.record.scene_place import ScenePlace
from mlbs_actors.scenes.synthetic import SyntheticScene, scene
from mlbs_actors.source import GapStatus
from orchestrator.events.event import Event
from orchestrator.events.happenings import Happenings
from orchestrator.events.zones import EventRules, Minimum, Zone

EMPTY = np.zeros((40, 60), np.uint8)


def row(index: int, labels: Array, camera: tuple[float, float] = (0.0, 0.0)) -> FrameRow:
    return FrameRow(index, index / 5, "ok", ResultRow.of(true_result(index, labels, camera), 1.0), f"{index}")


def lost(index: int, status: GapStatus = "gap") -> FrameRow:
    return FrameRow(index, index / 5, status)


def thing(x: int, width: int = 4, *, number: int = 1) -> Array:
    labels = EMPTY.copy()
    labels[10:20, x : x + width] = number
    return labels


def events(rows: list[FrameRow], rules: EventRules | None = None, *, end: bool = False) -> list[Event]:
    happenings = Happenings(rules or EventRules())
    said = [event for one in rows for event in happenings.after(one)]
    return said + (happenings.end() if end else [])


def told(said: list[Event]) -> list[tuple[str, int]]:
    return [(event.kind, event.frame) for event in said]


def feet(walk: SyntheticScene) -> list[tuple[float, float]]:
    """Where the walker stands in each frame: the middle of the lowest row of its box."""
    places = []
    for index in range(len(walk)):
        y, x = np.nonzero(walk.labels(index))
        places.append(((int(x.min()) + int(x.max()) + 1) / 2, float(y.max()) + 0.5))
    return places


def test_a_walker_enters_a_zone_and_leaves_it_once_at_the_true_frames() -> None:
    walk = scene("static-walker", frames=110)
    across = [x for x, _ in feet(walk)]
    low, high = 120, 200
    strip = Zone(name="strip", polygon=((low, 0), (high, 0), (high, 240), (low, 240)))
    inside = [low <= x < high for x in across]
    changes = [index for index in range(1, len(inside)) if inside[index] != inside[index - 1]]
    assert len(changes) == 2
    assert not inside[0]
    said = events([row(index, walk.labels(index)) for index in range(110)], EventRules((strip,)))
    assert told(said) == [("born", 0), ("entered", changes[0]), ("left", changes[1])]
    assert {event.zone for event in said} == {None, "strip"}
    assert {event.layer for event in said} == {1}


def test_a_walker_crosses_a_line_once_in_its_direction() -> None:
    walk = scene("static-walker", frames=110)
    across = [x for x, _ in feet(walk)]
    middle = float(np.median(across)) + 0.25
    # Looking upwards, what goes to the right in the picture goes to the right.
    fence = Zone(name="fence", kind="line", polygon=((middle, 240), (middle, 0)))
    beyond = [x > middle for x in across]
    [change] = [index for index in range(1, 110) if beyond[index] != beyond[index - 1]]
    said = events([row(index, walk.labels(index)) for index in range(110)], EventRules((fence,)))
    [crossed] = [event for event in said if event.kind == "crossed"]
    assert crossed.frame == change
    assert crossed.direction == ("right" if beyond[-1] else "left")


def test_what_trembles_at_a_border_enters_once() -> None:
    zone = Zone(name="right", polygon=((30, 0), (60, 0), (60, 40), (30, 40)))
    places = [20, 29, 29, 27, 29, 29, 27, 29, 30, 31, 27, 27, 32, 33]
    said = events([row(index, thing(x)) for index, x in enumerate(places)], EventRules((zone,)))
    assert told(said) == [("born", 0), ("entered", 7)]


def test_an_object_is_where_it_stands() -> None:
    # It reaches from row 10 to row 19.
    body = Zone(name="body", polygon=((0, 5), (60, 5), (60, 19), (0, 19)))
    ground = Zone(name="ground", polygon=((0, 19), (60, 19), (60, 20), (0, 20)))
    said = events([row(index, thing(20)) for index in range(4)], EventRules((body, ground)))
    assert [event.zone for event in said] == [None, "ground"]


def test_nothing_is_said_of_a_zone_of_the_scene_while_its_place_is_unknown() -> None:
    zone = Zone(name="right", polygon=((30, 0), (60, 0), (60, 40), (30, 40)), fixed_to="scene")
    line = Zone(name="fence", kind="line", polygon=((30, 0), (30, 40)), fixed_to="scene")
    still, turned = (
        np.eye(3),
        np.array([[1.0, 0, 20], [0, 1, 0], [0, 0, 1]]),
    )  # the scene, by 20 px to the right

    def seen(index: int, x: int, place: Array | None) -> FrameRow:
        made = row(index, thing(x))
        assert made.result is not None
        scene = None if place is None else ScenePlace.of((40, 60), place)
        return replace(made, result=replace(made.result, scene=scene))

    rows = [seen(index, 32, still) for index in range(3)]
    rows += [seen(3 + index, 52, turned) for index in range(4)]  # it goes along
    rows += [seen(7 + index, 10, None) for index in range(9)]
    rows += [seen(16 + index, 42, turned) for index in range(3)]
    said = events(rows, EventRules((zone, line)))
    kinds = [(event.kind, event.frame) for event in said]
    assert kinds == [("born", 0), ("entered", 0), ("left", 16), ("crossed", 16)]
    ended = events([*rows[:7], replace(row(7, EMPTY), status="cut")], EventRules((zone,)))
    assert told(ended)[2:] == [("left", 7), ("ended", 7)]


def test_an_object_is_hidden_and_back_and_ends() -> None:
    there, away = thing(20), EMPTY
    rows = [row(0, there), row(1, away), row(2, away), row(3, there)]  # too short to be said
    rows += [row(4 + index, away) for index in range(3)]
    rows += [row(10, there)]
    rows += [row(11 + index, away) for index in range(7)]
    said = events(rows, EventRules(remembered=6))
    assert told(said) == [("born", 0), ("hidden", 4), ("back", 10), ("hidden", 11), ("ended", 11)]
    assert said[-1].reason == "no longer found"
    assert said[-1].region == said[0].region


def test_whoever_ends_in_a_zone_leaves_it_before() -> None:
    everywhere = Zone(name="all", polygon=((0, 0), (1, 0), (1, 1), (0, 1)))
    rows = [row(index, thing(20)) for index in range(4)]
    cut = replace(row(4, thing(30, number=2)), status="cut")
    said = events([*rows, cut], EventRules((everywhere,)))
    assert told(said) == [("born", 0), ("entered", 0), ("left", 4), ("ended", 4), ("born", 4)]
    assert said[3].reason == "cut"
    at_end = events(rows, EventRules((everywhere,)), end=True)
    assert told(at_end)[2:] == [("left", 3), ("ended", 3)]
    assert at_end[-1].reason == "end of the stream"


def test_small_young_and_slow_objects_have_no_events() -> None:
    zone = Zone(name="all", polygon=((0, 0), (1, 0), (1, 1), (0, 1)))
    rows = [row(index, thing(20, width=4 if index < 6 else 8)) for index in range(10)]
    assert events(rows, EventRules((zone,), Minimum(area=100)), end=True) == []
    assert events(rows, EventRules((zone,), Minimum(speed=1)), end=True) == []
    grown = events(rows, EventRules((zone,), Minimum(area=80)))
    assert told(grown) == [("born", 0), ("entered", 0)]
    happenings, certain = Happenings(EventRules((zone,), Minimum(seconds=1))), []
    for one in rows:
        certain += [(one.frame, event.kind) for event in happenings.after(one)]
    assert certain == [(5, "born"), (5, "entered")]  # 5 frames a second


def test_speed_is_relative_to_the_background() -> None:
    # The object of a true result does not move in the picture, so under a moving camera it drives.
    rows = [row(index, thing(20), (2.0, 0.0)) for index in range(3)]
    assert told(events(rows, EventRules(minimum=Minimum(speed=9))))[0] == ("born", 0)  # 2 px, 5 a second
    assert [event.kind for event in events(rows, EventRules(minimum=Minimum(speed=11)))] == ["camera moving"]


def test_a_camera_moves_and_is_still() -> None:
    motions = [0.0] * 3 + [1.0] * 6 + [0.0] * 2 + [1.0] * 4 + [0.0] * 12 + [1.0] * 2 + [0.0]
    said = events([row(index, EMPTY, (motion, 0.0)) for index, motion in enumerate(motions)])
    assert told(said) == [("camera moving", 3), ("camera still", 15)]


def test_a_camera_is_still_when_its_picture_is_always_the_same() -> None:
    panned = [row(index, EMPTY, (1.0, 0.0)) for index in range(6)]
    same = [replace(row(index, EMPTY), status="repeated") for index in range(6, 20)]
    assert told(events(panned + same)) == [("camera moving", 0), ("camera still", 6)]
    doubled = [
        replace(row(index, EMPTY, (float(index % 2), 0.0)), status="ok" if index % 2 else "repeated")
        for index in range(12)
    ]
    assert told(events(doubled)) == [("camera moving", 1)]


def test_a_stream_is_lost_and_back() -> None:
    rows = [
        row(0, EMPTY),
        lost(1),
        lost(2),
        lost(3, "dropped"),
        row(4, EMPTY),
        lost(5, "dropped"),
        row(6, EMPTY),
    ]
    assert told(events(rows)) == [("stream lost", 1), ("stream back", 4)]


def test_a_silence_is_said_once_and_as_the_gap_would_say_it() -> None:
    gap, told_early = Happenings(EventRules()), Happenings(EventRules())
    assert told_early.silent() == []  # it has never been there
    said = [[event for one in (row(0, EMPTY), lost(1), row(2, EMPTY)) for event in gap.after(one)]]
    early = told_early.after(row(0, EMPTY)) + told_early.silent() + told_early.silent()
    said.append(early + told_early.after(replace(lost(1), pts=0.0)) + told_early.after(row(2, EMPTY)))
    assert told(said[0]) == told(said[1]) == [("stream lost", 1), ("stream back", 2)]


def test_nothing_is_said_of_many_objects_at_once() -> None:
    result = row(0, thing(20)).result
    assert result is not None
    other = replace(result, layers=(replace(result.layers[0], kind="other"),))
    assert events([replace(row(0, thing(20)), result=other)], end=True) == []
