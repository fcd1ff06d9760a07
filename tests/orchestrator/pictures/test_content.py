"""What is written over pictures: the time of a camera or of a stream, and what can be left out."""

from __future__ import annotations

import pytest

from orchestrator.option_values import DRAWABLE, DRAWN, time_zone
from orchestrator.pictures.content import Drawing


def test_the_time_of_a_camera_is_that_of_the_day_in_the_zone_asked_for() -> None:
    taken = 1_777_886_131.749  # 2026-05-04T09:15:31.749 UTC
    assert Drawing(time_zone="UTC").time(5.0, taken) == "2026-05-04 09:15:31.7 UTC"
    assert Drawing(time_zone="Europe/Berlin").time(5.0, taken) == "2026-05-04 11:15:31.7 CEST"


@pytest.mark.parametrize(
    ("pts", "text"), [(0.0, "0:00:00.0"), (83.46, "0:01:23.4"), (90_061.05, "1 day, 1:01:01.0")]
)
def test_the_time_of_a_file_is_that_in_the_stream(pts: float, text: str) -> None:
    assert Drawing(clock=True, frame=False).caption(7, pts, None) == text


def test_what_is_drawn_is_chosen_by_name() -> None:
    assert Drawing.of(DRAWN, None, private=False) == Drawing()
    assert Drawing.of(DRAWABLE, None, private=False) == Drawing(clock=True)
    assert Drawing.of([], None, private=True) == Drawing(False, False, False, False, None, private=True)
    assert Drawing.of([], None, private=False).caption(7, 0.0, None) == ""
    assert Drawing.of(["clock", "frame"], None, private=False).caption(7, 1.5, None) == "0:00:01.5  frame 7"


@pytest.mark.parametrize("name", ["Europe/Nowhere", "", "../etc", "/etc/localtime"])
def test_an_unknown_time_zone_is_refused_with_an_example(name: str) -> None:
    with pytest.raises(ValueError, match="Europe/Berlin"):
        time_zone(name)
