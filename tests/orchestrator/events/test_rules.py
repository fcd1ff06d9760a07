"""Rules, each against a slow obvious version that looks at all rows again."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from pydantic import TypeAdapter

from mlbs_actors.messages import LayerSummary, Region
from mlbs_actors.record.frame_row import FrameRow, ResultRow, run_length_code
from mlbs_actors.record.scene_place import ScenePlace
from orchestrator.events.event import Event
from orchestrator.events.event_file import event_id
from orchestrator.events.event_state import EventState
from orchestrator.events.happenings import HOLD, Happenings
from orchestrator.events.zones import EventRules, EventSettings, Minimum

#: What objects walk about in: 60 px wide, two zones at its sides, and a line between them.
SHAPE = (20, 60)
PLACES = [
    {"name": "west", "polygon": [[0, 0], [20, 0], [20, 20], [0, 20]]},
    {"name": "east", "polygon": [[40, 0], [60, 0], [60, 20], [40, 20]]},
    {"name": "fence", "kind": "line", "polygon": [[30, 20], [30, 0]]},  # to the right is to the east
]

#: Frames a second; their times are exact.
RATE = 4.0

#: Without pixels no object is replaced by another one.
NO_MASK = run_length_code(np.zeros(SHAPE, np.uint16), 1, Region(0, 0, 1, 1))
STATE = TypeAdapter(EventState)

#: Who is where: of each frame the middles of objects, by their numbers.
Places = list[dict[int, int]]


def rules_of(*rules: dict[str, Any], minimum: Minimum | None = None) -> EventRules:
    settings = EventSettings.model_validate({"zones": PLACES, "rules": rules})
    return settings.event_rules(minimum or Minimum(), 4)


def row(index: int, places: dict[int, int], score: Callable[[int, int], float] = lambda *_: 1.0) -> FrameRow:
    layers = tuple(
        LayerSummary(
            number,
            "object",
            Region(x - 2, 2, 4, 10),
            40 * number,
            (x, 7.0),
            (0, 0),
            1.0,
            score=score(index, number),
        )
        for number, x in sorted(places.items())
    )
    result = ResultRow(layers, (NO_MASK,) * len(layers), SHAPE, 1.0, (0.0, 0.0), 0, {})
    return FrameRow(index, index / RATE, "ok", result)


def walks(seed: int, frames: int = 400) -> Places:
    """Objects that walk to and fro, stand about, and are away for a moment."""
    chance = random.Random(seed)
    places: Places = [{} for _ in range(frames)]
    for number in range(1, 9):
        begin = chance.randrange(frames)
        x, speed = chance.randrange(2, 58), 0
        for index in range(begin, min(begin + chance.randrange(200), frames)):
            if chance.random() < 0.1:
                speed = chance.choice([-4, -2, 0, 0, 2, 4])
            x = min(max(x + speed, 2), 57)
            if chance.random() > 0.05:
                places[index][number] = x
    return places


def said(rules: EventRules, rows: list[FrameRow], began: float | None = None) -> list[Event]:
    happenings = Happenings(rules)
    clocks = [None if began is None else began + one.pts for one in rows]
    return [event for one, clock in zip(rows, clocks, strict=True) for event in happenings.after(one, clock)]


def told(events: list[Event]) -> list[tuple[int, tuple[int, ...]]]:
    """Frames and objects of what rules have said."""
    return [(one.frame, one.objects or ()) for one in events if one.kind == "rule"]


def is_in(name: str, x: int) -> bool:
    return 0 <= x < 20 if name == "west" else 40 <= x < 60


def certain(places: Places, name: str, number: int) -> Iterator[tuple[int, int, bool]]:
    """Yield each change of who is in a zone: frame in which it is certain, in which it began, and what it is.

    Three label maps in a row that show the object say the same, but for those in which nothing is seen.
    """
    inside, row = False, []
    for index, here in enumerate(places):
        if number in here and is_in(name, here[number]) != inside:
            row.append(index)
        else:
            row = []
        if len(row) == HOLD:
            inside, begin, row = not inside, row[0], []
            yield index, begin, inside


def lives(places: Places) -> list[Places]:
    """One scene for each life of an object: it ends when it was away in more than four label maps."""
    found = []
    for number in sorted({number for here in places for number in here}):
        seen = [index for index, here in enumerate(places) if number in here]
        begin = seen[0]
        for one, following in zip(seen, [*seen[1:], 10**9], strict=True):
            if following - one > 5:
                found.append(
                    [
                        {number: here[number]} if number in here and begin <= index <= one else {}
                        for index, here in enumerate(places)
                    ]
                )
                begin = following
    return found


def visits(places: Places, name: str) -> list[tuple[int, int, str | None]]:
    """Return who comes into a zone or over the fence: certain in, began in, direction; of one life."""
    [number] = {number for here in places for number in here}
    if name != "fence":
        return [(sure, begin, None) for sure, begin, inside in certain(places, name, number) if inside]
    found: list[tuple[int, int, str | None]] = []
    side: bool | None = None
    row: list[int] = []
    for index, here in enumerate(places):
        if number in here and side is None:
            side = here[number] >= 30
        if number in here and (here[number] >= 30) != side:
            row.append(index)
        else:
            row = []
        if len(row) == HOLD:
            side = not side
            found.append((index, row[0], "right" if side else "left"))
            row = []
    return found


def slow_dwell(places: Places, zone: str, frames: int) -> list[tuple[int, tuple[int, ...]]]:
    """All who have been in a zone for so many frames, by the first frame that shows each of them there."""
    due: dict[int, list[int]] = {}
    for life in lives(places):
        [number] = {number for here in life for number in here}
        last = max(index for index, here in enumerate(life) if here)
        changes = [*certain(life, zone, number), (last + 1, last + 1, False)]
        for (sure, begin, inside), (out, *_) in pairwise(changes):
            if inside:
                stays = [
                    index
                    for index in range(sure, out)
                    if index - begin >= frames and number in life[index] and is_in(zone, life[index][number])
                ]
                if stays:
                    due.setdefault(stays[0], []).append(number)
    return [(index, tuple(sorted(numbers))) for index, numbers in sorted(due.items())]


def slow_sequence(places: Places, steps: list[tuple[str, str | None]], frames: int) -> list[tuple[int, int]]:
    """Frames and objects of one step and the other."""
    found = []
    for life in lives(places):
        [number] = {number for here in life for number in here}
        happened = sorted(
            (sure, begin, name, direction)
            for name in {name for name, _ in steps}
            for sure, begin, direction in visits(life, name)
        )
        earlier: list[int] = []
        for _, begin, name, direction in happened:
            does = [step == name and way in (None, direction) for step, way in steps]
            if does[1] and any(0 < begin - one <= frames for one in earlier):
                found.append((begin, number))
                earlier = []
            elif does[0]:
                earlier.append(begin)
    return sorted(found)


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("seconds", [0, 1, 6])
def test_dwell_is_said_once_a_stay_when_it_has_lasted_long_enough(seed: int, seconds: int) -> None:
    places = walks(seed)
    rules = rules_of({"name": "stays", "dwell": {"zone": "west", "seconds": seconds}})
    events = said(rules, [row(index, here) for index, here in enumerate(places)])
    assert told(events) == slow_dwell(places, "west", round(seconds * RATE))


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize(
    "steps",
    [
        [("west", None), ("east", None)],
        [("fence", None), ("fence", None)],
        [("fence", "right"), ("east", None)],
        [("east", None), ("fence", "left")],
    ],
)
def test_a_sequence_is_said_of_the_same_object_within_its_seconds(
    seed: int, steps: list[tuple[str, str | None]]
) -> None:
    places = walks(seed)
    written = [name if way is None else {name: way} for name, way in steps]
    rules = rules_of({"name": "passes", "sequence": written, "within": 8})
    events = said(rules, [row(index, here) for index, here in enumerate(places)])
    expected = slow_sequence(places, steps, round(8 * RATE))
    assert sorted((frame, number) for frame, who in told(events) for number in who) == expected


@pytest.mark.parametrize("seed", range(12))
def test_a_count_in_a_zone_is_said_when_enough_have_been_in_it_long_enough(seed: int) -> None:
    places = walks(seed)
    rule = {"name": "crowd", "count": {"zone": "west", "at_least": 2, "seconds": 2}}
    events = said(rules_of(rule), [row(index, here) for index, here in enumerate(places)])
    inside = [set[int]() for _ in places]
    for life in lives(places):
        [number] = {number for here in life for number in here}
        last = max(index for index, here in enumerate(life) if here)
        changes = [*certain(life, "west", number), (min(last + 5, len(places)), 0, False)]
        for (sure, _, is_inside), (out, *_) in pairwise(changes):
            for index in range(sure, out) if is_inside else ():
                inside[index].add(number)
    expected = []
    for index in range(len(places)):
        begin = index - round(2 * RATE)
        before = begin < 1 or len(inside[begin - 1]) < 2
        if begin >= 0 and before and all(len(inside[one]) >= 2 for one in range(begin, index + 1)):
            expected.append((index, tuple(sorted(inside[index]))))
    assert told(events) == expected


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("direction", [None, "left"])
def test_crossings_are_counted_within_their_seconds_and_each_in_one_event(
    seed: int, direction: str | None
) -> None:
    places = walks(seed)
    rule = {"name": "rush", "count": {"line": "fence", "at_least": 3, "within": 12, "direction": direction}}
    events = said(rules_of(rule), [row(index, here) for index, here in enumerate(places)])
    crossed: dict[int, list[tuple[int, int]]] = {}
    for life in lives(places):
        [number] = {number for here in life for number in here}
        for sure, begin, way in visits(life, "fence"):
            if direction in (None, way):
                crossed.setdefault(sure, []).append((begin, number))
    expected, since = [], list[tuple[int, int]]()
    for _, new in sorted(crossed.items()):
        since += new
        newest = sorted(since)[-3:]
        if len(newest) == 3 and newest[-1][0] - newest[0][0] <= 12 * RATE:
            expected.append((max(new)[0], tuple(sorted({number for _, number in newest}))))
            since = []
    assert told(events) == expected


#: All kinds of rules at once, with all that limits them.
EVERYTHING: list[dict[str, Any]] = [
    {"name": "stays", "dwell": {"zone": "west", "seconds": 2}, "cool_down": 5},
    {"name": "stays large", "dwell": {"zone": "west", "seconds": 1}, "objects": {"area": {"least": 200}}},
    {"name": "passes", "sequence": [{"fence": "right"}, "east"], "within": 20, "cool_down": 3},
    {"name": "crowd", "count": {"zone": "east", "at_least": 2, "seconds": 1}},
    {
        "name": "rush",
        "count": {"line": "fence", "at_least": 2, "within": 9},
        "schedule": {"from": "23:59", "to": "00:01", "timezone": "Europe/Berlin"},
    },
]

#: 2026-06-01, 23:58:40 in Berlin.
EVENING = 1_780_351_120.0


@pytest.mark.parametrize("seed", range(4))
def test_a_stream_that_goes_back_to_any_row_says_the_same_again(seed: int) -> None:
    rules, rows = rules_of(*EVERYTHING), [row(index, here) for index, here in enumerate(walks(seed, 240))]
    happenings, states, events = Happenings(rules), [STATE.dump_json(EventState())], list[list[Event]]()
    for one in rows:
        events.append(happenings.after(one, EVENING + one.pts))
        states.append(STATE.dump_json(happenings.state))
    for index, one in enumerate(rows):
        again = Happenings(rules, STATE.validate_json(states[index]))
        assert again.after(one, EVENING + one.pts) == events[index]
        assert STATE.dump_json(again.state) == states[index + 1]


def test_every_rule_has_spoken_and_each_event_has_an_id_of_its_own() -> None:
    events = list[Event]()
    for seed in range(4):
        rows = [row(index, here) for index, here in enumerate(walks(seed, 240))]
        now = said(rules_of(*EVERYTHING), rows, EVENING)
        assert len({event_id("gate", one) for one in now}) == len(now)
        events += now
    assert {one.rule for one in events} == {None, *(rule["name"] for rule in EVERYTHING)}


def test_of_a_thousand_events_a_minute_a_rule_says_one_a_cool_down() -> None:
    def middle(number: int, index: int) -> int:
        return 10 if (index + 2 * (number % 3)) // 5 % 2 else 50

    rows = [row(index, {number: middle(number, index) for number in range(1, 41)}) for index in range(480)]
    common = {"cool_down": 10}
    rules = rules_of(
        {"name": "stays", "dwell": {"zone": "west", "seconds": 0}, **common},
        {"name": "passes", "sequence": ["west", "east"], "within": 60, **common},
        {"name": "crowd", "count": {"zone": "east", "at_least": 20}, **common},
        {"name": "rush", "count": {"line": "fence", "at_least": 5, "within": 60}, **common},
    )
    happenings, events = Happenings(rules), list[tuple[float, Event]]()
    for one in rows:
        events += [(one.pts, event) for event in happenings.after(one)]
    minutes = 480 / RATE / 60
    assert sum(event.kind != "rule" for _, event in events) / minutes > 1000
    for name in ("stays", "passes", "crowd", "rush"):
        for times in (
            [event.pts for _, event in events if event.rule == name],  # when it happened
            [sure for sure, event in events if event.rule == name],  # when it was sent
        ):
            assert 10 <= len(times) <= 12
            assert min(later - earlier for earlier, later in pairwise(times)) >= 10


def test_whoever_stays_is_told_after_the_cool_down_and_all_at_once() -> None:
    rule = {"name": "stays", "dwell": {"zone": "west", "seconds": 1}, "cool_down": 10}
    places = [
        {1: 10} | ({2: 10} if index >= 8 else {}) | ({3: 10} if index >= 12 else {}) for index in range(60)
    ]
    events = said(rules_of(rule), [row(index, here) for index, here in enumerate(places)])
    assert told(events) == [(4, (1,)), (44, (2, 3))]
    [first, second] = [one for one in events if one.kind == "rule"]
    assert (first.layer, first.zone, first.seconds, first.area) == (1, "west", 1.0, 40)
    assert (second.layer, second.seconds) == (2, 9.0)  # who has been there for longest
    assert second.region == Region(8, 2, 4, 10)


def test_a_rule_counts_only_the_objects_that_it_asks_for() -> None:
    places = [{1: 10, 2: 10, 5: 10} for _ in range(20)]

    def stays(**objects: Any) -> list[tuple[int, tuple[int, ...]]]:
        rule = {"name": "stays", "dwell": {"zone": "west", "seconds": 1}, "objects": objects}
        rows = [
            row(index, here, lambda index, number: 0.2 if number == 1 and index < 9 else 0.8)
            for index, here in enumerate(places)
        ]
        return told(said(rules_of(rule), rows))

    assert stays() == [(4, (1, 2, 5))]
    assert stays(score=0.5) == [(4, (2, 5)), (9, (1,))]
    assert stays(area={"least": 80, "most": 199}) == [(4, (2,))]
    assert stays(aspect={"most": 0.4}) == [(4, (1, 2, 5))]
    assert stays(aspect={"least": 0.5}) == []
    assert stays(seconds=3) == [(12, (1, 2, 5))]


def test_a_rule_has_the_objects_that_reach_the_minimum() -> None:
    rule = {"name": "crowd", "count": {"zone": "west", "at_least": 2}}
    rows = [row(index, {1: 10, 2: 10, 5: 10}) for index in range(9)]
    assert told(said(rules_of(rule, minimum=Minimum(area=60)), rows)) == [(2, (2, 5))]
    assert told(said(rules_of(rule, minimum=Minimum(area=100)), rows)) == []


def test_a_rule_that_stays_the_same_goes_on_and_another_one_begins_anew() -> None:
    stays = {"name": "stays", "dwell": {"zone": "west", "seconds": 1}, "cool_down": 20}
    other = {"name": "other", "dwell": {"zone": "west", "seconds": 2}}
    happenings = Happenings(rules_of(stays, other))
    rows = [row(index, {1: 10} | ({2: 10} if index >= 20 else {})) for index in range(120)]
    events = [event for one in rows[:30] for event in happenings.after(one)]
    assert told(events) == [(4, (1,)), (8, (1,)), (28, (2,))]
    happenings.configured(rules_of(other | {"cool_down": 1}, stays))
    events = [event for one in rows[30:] for event in happenings.after(one)]
    # The one that is other looks at stays from then on; the one that is the same waits until it may speak.
    assert [(one.frame, one.rule, one.objects) for one in events if one.kind == "rule"] == [
        (38, "other", (1, 2)),
        (84, "stays", (2,)),
    ]
    assert happenings.configured(rules_of(other)) != []
    happenings.after(row(120, {}))
    assert list(happenings.state.rules) == ["other"]


def test_a_rule_is_silent_while_its_schedule_is_not_in_force() -> None:
    schedule = {"from": "23:59", "to": "00:01", "timezone": "Europe/Berlin"}
    rules = rules_of(
        {"name": "stays", "dwell": {"zone": "west", "seconds": 1}, "schedule": schedule},
        {"name": "passes", "sequence": ["west", "east"], "within": 60, "schedule": schedule},
    )
    places = [{1: 10} for _ in range(10)] + [{1: 50} for _ in range(10)] + [{1: 10} for _ in range(80)]
    places += [{1: 50} for _ in range(10)]
    events = said(rules, [row(index, here) for index, here in enumerate(places)], EVENING)
    # It stays there at 23:59, 20 s after the first frame; it went over before, and once more.
    assert [(one.rule, one.frame) for one in events if one.kind == "rule"] == [("stays", 80), ("passes", 100)]


def test_a_file_has_no_time_of_day_and_the_rule_says_what_then() -> None:
    def stays(**more: str) -> list[tuple[str, int]]:
        schedule = {"from": "22:00", "to": "06:00", "timezone": "UTC", **more}
        rule = {"name": "stays", "dwell": {"zone": "west", "seconds": 1}, "schedule": schedule}
        events = said(rules_of(rule), [row(index, {1: 10}) for index in range(9)])
        return [(one.kind, one.frame) for one in events if one.rule == "stays"]

    assert stays() == [("fault", 0)]
    assert stays(without_clock="never") == []
    assert stays(without_clock="always") == [("rule", 4)]


def test_a_rule_is_silent_while_nobody_knows_where_its_zone_is() -> None:
    west = PLACES[0] | {"fixed_to": "scene"}
    rules = [
        {"name": "stays", "dwell": {"zone": "west", "seconds": 2}},
        {"name": "crowd", "count": {"zone": "west", "at_least": 2, "seconds": 2}},
    ]
    settings = EventSettings.model_validate({"zones": [west], "rules": rules})
    rows, place = [], ScenePlace.of(SHAPE, np.eye(3))
    for index in range(30):
        seen = row(index, {1: 10, 2: 10})
        assert seen.result is not None
        known = index < 6 or index >= 20
        rows.append(replace(seen, result=replace(seen.result, scene=place if known else None)))
    events = said(settings.event_rules(Minimum(), 4), rows)
    assert told(events) == [(20, (1, 2)), (20, (1, 2))]
