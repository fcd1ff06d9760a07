"""Polygons as operators and other programs write them."""

from __future__ import annotations

from typing import Any

import pytest
import yaml
from pydantic import ValidationError

from orchestrator.events.zones import Zone

SQUARE = ((0.1, 0.25), (0.5, 0.25), (0.5, 0.75))


def zone(text: str, key: str = "polygon") -> Zone:
    return Zone.model_validate({"name": "yard", key: yaml.safe_load(text)})


@pytest.mark.parametrize(
    "text",
    [
        "[[0.1, 0.25], [0.5, 0.25], [0.5, 0.75]]",
        '["10%,25%", "50%,25%", "50%,75%"]',
        '["10% 25%", "50% 25%", "50% 75%"]',
        "[[10%, 25%], [50%, 25%], [50%, 75%]]",
        "10%,25% 50%,25% 50%,75%",
        "10% 25%, 50% 25%, 50% 75%",
        "0.1,0.25,0.5,0.25,0.5,0.75",
        ".1,.25; .5,.25; .5,.75",
        "[0.1, 0.25, 0.5, 0.25, 0.5, 0.75]",
        "[{x: 0.1, y: 0.25}, {x: 0.5, y: 0.25}, {y: 0.75, x: 0.5}]",
        "[{x: 10%, y: 25%}, {x: 50%, y: 25%}, {x: 50%, y: 75%}]",
        '["0.1,0.25", "0.5,0.25", "0.5,0.75"]',
    ],
)
def test_shares_may_be_written_in_several_ways(text: str) -> None:
    assert zone(text).polygon == SQUARE
    assert zone(text, "coordinates").polygon == SQUARE


@pytest.mark.parametrize("text", ["12,240,640,240,640,480", "[[12, 240], [640, 240], [640, 480]]"])
def test_px_stay_px(text: str) -> None:
    assert zone(text).corners((480, 640)) == ((12, 240), (640, 240), (640, 480))


def test_nought_needs_no_percent() -> None:
    assert zone("0,0 100%,0 100%,100%").corners((480, 640)) == ((0, 0), (640, 0), (640, 480))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("10%,20 50%,25% 50%,75%", "some of the numbers have a %, some have none; write"),
        ("[[10%, 0.2], [50%, 25%], [50%, 75%]]", "some have none; write"),
        ("10%,25% 50%,25% 120%,75%", "more than 100%"),
        ("0.1,0.2,0.3,0.4,0.5", r"these are 5 numbers, but each point needs two; write \[\["),
        ("POLYGON((10 20, 30 40))", r"this is no polygon; write \[\["),
        ("-5,10,20,30,40,50", "this is no polygon"),
        ("0.1,0.2,640,240,640,480", "it has both shares .* and px"),
        ("[[0.1, 0.2], [640, 240], [640, 480]]", "it has both shares .* and px"),
        ("[[-1, 0], [640, 240], [640, 480]]", "greater than or equal to 0"),
        ("[[1, 2, 3], [640, 240], [640, 480]]", "at most 2 items|no more than 2|Tuple"),
        ("10%,25% 50%,25%", "at least 3 different points"),
        ("7", "valid tuple"),
        ("{x: 1, y: 2}", "valid tuple"),
    ],
)
def test_what_is_not_understood_is_refused_with_an_example(text: str, words: str) -> None:
    with pytest.raises(ValidationError, match=words):
        zone(text)


def test_both_names_at_once_are_refused() -> None:
    both: dict[str, Any] = {"name": "yard", "polygon": SQUARE, "coordinates": SQUARE}
    with pytest.raises(ValidationError, match="coordinates"):
        Zone.model_validate(both)
