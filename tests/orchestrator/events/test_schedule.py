"""When rules are in force."""

from __future__ import annotations

from datetime import datetime, timedelta, timezone
from typing import Any
from zoneinfo import ZoneInfo

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from orchestrator.events.schedule import Schedule

DAYS = ("mon", "tue", "wed", "thu", "fri", "sat", "sun")
BERLIN = ZoneInfo("Europe/Berlin")


def schedule(begin: Any = "22:00", end: Any = "06:00", **more: Any) -> Schedule:
    return Schedule.model_validate({"from": begin, "to": end, "timezone": "Europe/Berlin", **more})


def at(*local: int, fold: int = 0) -> float:
    return datetime(*local, tzinfo=BERLIN, fold=fold).timestamp()  # type: ignore[arg-type, misc]


minutes = st.integers(0, 24 * 60 - 1)


@given(st.integers(0, 2 * 10**9), minutes, minutes, st.sets(st.sampled_from(DAYS), min_size=1).map(sorted))
def test_it_is_in_force_in_the_hours_that_begin_on_its_days(
    clock: int, begin: int, end: int, days: list[str]
) -> None:
    # Walk back through the local minutes to where the hours would have begun.
    now = datetime.fromtimestamp(clock, BERLIN).replace(tzinfo=None, second=0)
    length = (end - begin) % (24 * 60) or 24 * 60
    starts = [now - timedelta(minutes=(now.hour * 60 + now.minute - begin) % (24 * 60))]
    expected = any(now < one + timedelta(minutes=length) and DAYS[one.weekday()] in days for one in starts)
    assert schedule(begin, end, days=days).holds(clock) == expected


def test_a_night_belongs_to_the_day_on_which_it_begins() -> None:
    friday = schedule(days=["fri"])
    assert not friday.holds(at(2026, 5, 1, 21, 59))  # a Friday
    assert friday.holds(at(2026, 5, 1, 22, 0))
    assert friday.holds(at(2026, 5, 2, 5, 59))
    assert not friday.holds(at(2026, 5, 2, 6, 0))
    assert not friday.holds(at(2026, 5, 1, 3, 0))
    assert not friday.holds(at(2026, 5, 2, 23, 0))


def test_its_hours_are_those_of_the_clocks_there_when_they_change() -> None:
    early = schedule("02:00", "04:00")
    # In October the hour from two comes twice; in March it does not come.
    assert early.holds(at(2026, 10, 25, 2, 30, fold=0))
    assert early.holds(at(2026, 10, 25, 2, 30, fold=1))
    before = datetime(2026, 10, 24, 23, 59, tzinfo=timezone.utc).timestamp()
    assert not early.holds(before)
    assert sum(early.holds(before + 60 * minute) for minute in range(400)) == 180
    spring = datetime(2026, 3, 29, 0, 0, tzinfo=timezone.utc).timestamp()
    assert sum(early.holds(spring + 60 * minute) for minute in range(400)) == 60


def test_without_hours_it_is_the_whole_day() -> None:
    sunday = Schedule.model_validate({"days": ["sun"], "timezone": "UTC"})
    midnight = datetime(2026, 5, 3, tzinfo=timezone.utc).timestamp()  # a Sunday
    assert [sunday.holds(midnight + 3600 * hour) for hour in (-1, 0, 12, 23, 24)] == [
        False,
        True,
        True,
        True,
        False,
    ]


@pytest.mark.parametrize("written", ["22:00", 1320])
def test_an_hour_may_stand_without_quotes(written: str | int) -> None:
    assert schedule(written) == schedule()
    assert schedule("00:00", "24:00") == schedule(0, 1440)


@pytest.mark.parametrize(
    ("written", "words"),
    [
        ({"from": "25:00", "timezone": "UTC"}, "22:00"),
        ({"from": "22", "timezone": "UTC"}, "22:00"),
        ({"from": True, "timezone": "UTC"}, "22:00"),
        ({"from": "22:00"}, "timezone"),
        ({"timezone": "Europe/Bärlin"}, "Europe/Berlin"),
        ({"timezone": "../../etc/passwd"}, "Europe/Berlin"),
        ({"timezone": "UTC", "days": ["monday"]}, "mon"),
        ({"timezone": "UTC", "days": []}, "days"),
    ],
)
def test_what_is_not_understood_is_refused_with_an_example(written: dict[str, Any], words: str) -> None:
    with pytest.raises(ValidationError, match=words):
        Schedule.model_validate(written)
