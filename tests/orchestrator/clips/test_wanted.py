"""Which events share a clip."""

from __future__ import annotations

import random

import pytest

from orchestrator.clips.settings import LONGEST_SHARED_SECONDS, ClipSettings
from orchestrator.clips.wanted import WantedClip, next_cut, wanted_clip

SETTINGS = ClipSettings(before=5, after=5)


def wanted(*times: float) -> list[WantedClip]:
    return [WantedClip(at - 5, at + 5, f"clips/{at:08.1f}.mp4") for at in times]


def test_an_event_wants_what_is_around_it_by_the_time_of_day_or_else_by_the_streams_time() -> None:
    event = {"clip": "clips/a.mp4", "time": 7.0, "clock": None}
    assert wanted_clip(event, SETTINGS) == WantedClip(2.0, 12.0, "clips/a.mp4")
    by_clock = wanted_clip(event | {"clock": "2026-05-04T09:15:31.700+00:00"}, SETTINGS)
    assert by_clock is not None
    assert by_clock.begin == pytest.approx(1777886126.7)
    assert wanted_clip(event | {"clip": None}, SETTINGS) is None
    assert wanted_clip({"time": 7.0, "clock": None}, SETTINGS) is None  # of an earlier version


def test_a_clip_is_made_once_all_of_it_has_been_taken() -> None:
    assert next_cut([], 1e9) is None
    assert next_cut(wanted(100), 105) is None
    due = next_cut(wanted(100), 110)
    assert due is not None
    assert (due.begin, due.end) == (95, 105)


def test_events_that_overlap_share_a_clip_and_those_that_do_not_have_their_own() -> None:
    due = next_cut(wanted(130, 104, 100), 200)
    assert due is not None
    assert (due.begin, due.end) == (95, 109)
    assert due.paths == ("clips/000100.0.mp4", "clips/000104.0.mp4")
    assert next_cut(wanted(100, 104), 106) is None  # it is not over yet


def test_however_many_events_there_are_each_gets_a_clip_that_holds_it_and_none_gets_too_long() -> None:
    chance = random.Random(1)
    left = wanted(*(round(chance.uniform(0, 300), 1) for _ in range(200)))
    windows = {one.path: one for one in left}
    while (due := next_cut(left, 1e9)) is not None:
        assert due.end - due.begin <= LONGEST_SHARED_SECONDS
        for path in due.paths:
            one = windows.pop(path, None)
            assert one is None or due.begin <= one.begin < one.end <= due.end
        left = [one for one in left if one.path not in due.paths]
    assert not windows
