"""Which events a target is sent."""

from __future__ import annotations

from typing import Any, get_args

import pytest
from pydantic import ValidationError

from orchestrator.events.event import EventKind
from orchestrator.events.event_filter import EventFilter


def line(kind: EventKind, **more: Any) -> dict[str, Any]:
    """A line of the file, with what the filter may look at."""
    of_object = {"score": 0.8, "area": 600, "box": [10, 20, 20, 40], "seconds": 3.0}
    none = dict.fromkeys(("zone", "rule", "score", "area", "box", "seconds"))
    no_object = kind.startswith(("camera", "stream", "configured"))
    return {"kind": kind, "stream": "gate", **none, **({} if no_object else of_object), **more}


def wanted(filtered: EventFilter, *lines: dict[str, Any]) -> list[bool]:
    return [filtered.wants(one) for one in lines]


def test_births_and_ends_are_only_sent_if_they_are_asked_for() -> None:
    sent = {kind for kind in get_args(EventKind) if EventFilter().wants(line(kind))}
    assert set(get_args(EventKind)) - sent == {"born", "hidden", "back", "ended"}
    assert wanted(EventFilter(kinds=("born",)), line("born"), line("entered")) == [True, False]


def test_streams_are_named() -> None:
    gate = EventFilter(streams=("gate", "yard"))
    assert wanted(gate, line("entered"), line("entered", stream="road")) == [True, False]


def test_zones_that_are_named_leave_only_what_happens_in_them() -> None:
    yard = EventFilter(zones=("yard",))
    there = line("entered", zone="yard"), line("rule", zone="yard", rule="loiters")
    elsewhere = line("entered", zone="road"), line("rule", zone="road", rule="queue"), line("camera moving")
    assert wanted(yard, *there, *elsewhere) == [True, True, False, False, False]
    with_camera = EventFilter(zones=("yard",), kinds=("entered", "stream lost"))
    assert wanted(with_camera, line("stream lost"), there[0], elsewhere[0]) == [True, True, False]


def test_rules_that_are_named_leave_only_these_and_the_zones_that_are_named() -> None:
    loiters, queue = (line("rule", rule=rule, zone="yard") for rule in ("loiters", "queue"))
    entered = line("entered", zone="yard")
    assert wanted(EventFilter(rules=("loiters",)), loiters, queue, entered) == [True, False, False]
    both = EventFilter(rules=("loiters",), zones=("yard",))
    assert wanted(both, loiters, queue, entered, line("entered", zone="road")) == [True, False, True, False]


@pytest.mark.parametrize(
    ("bounds", "fits"),
    [
        ({"score": 0.8}, True),
        ({"score": 0.81}, False),
        ({"area": {"least": 600, "most": 600}}, True),
        ({"area": {"least": 601}}, False),
        ({"area": {"most": 599}}, False),
        ({"aspect": {"most": 0.5}}, True),
        ({"aspect": {"least": 0.51}}, False),
        ({"seconds": 3}, True),
        ({"seconds": 3.1}, False),
        ({"score": 0.5, "seconds": 3.1}, False),
    ],
)
def test_bounds_are_of_the_object_and_let_pass_what_has_none(bounds: dict[str, Any], fits: bool) -> None:
    filtered = EventFilter.model_validate(bounds)
    assert wanted(filtered, line("entered"), line("stream lost")) == [fits, True]


def test_lines_of_an_earlier_version_are_judged_by_what_they_have() -> None:
    old = {"kind": "entered", "stream": "gate", "zone": "yard", "box": [0, 0, 20, 40], "number": 3}
    assert wanted(EventFilter(score=0.9, zones=("yard",), rules=("loiters",)), old) == [True]


@pytest.mark.parametrize(
    "written",
    [
        {"kind": ["entered"]},
        {"kinds": ["enter"]},
        {"kinds": []},
        {"score": 1.5},
        {"area": {"least": 9, "most": 3}},
        {"area": 9},
    ],
)
def test_what_is_not_understood_is_refused(written: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        EventFilter.model_validate(written)
