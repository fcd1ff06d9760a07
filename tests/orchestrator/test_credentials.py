"""Passwords and tokens are hidden wherever an address is shown."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from orchestrator.credentials import mask


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("rtsp://bob:pw@host/a", "rtsp://***@host/a"),
        ("rtsp://token@host/a", "rtsp://***@host/a"),
        ("rtsp://bob:p/w@host", "rtsp://***@host"),
        ("rtsp://bob:p@w@host", "rtsp://***@host"),
        ("two: rtsp://a:b@c/d and rtsps://e:f@g/h.", "two: rtsp://***@c/d and rtsps://***@g/h."),
        ("rtsp://host/a?Password=pw&channel=1", "rtsp://host/a?Password=***&channel=1"),
        ("rtsp://host/a?api_key=pw", "rtsp://host/a?api_key=***"),
        ("rtsp://host/a?pwd=it's&channel=1", "rtsp://host/a?pwd=***&channel=1"),
        ("[Errno 111] refused: 'rtsp://bob:pw@host/a'", "[Errno 111] refused: 'rtsp://***@host/a'"),
    ],
)
def test_user_information_and_secret_parameters_are_hidden(text: str, shown: str) -> None:
    assert mask(text) == shown


@pytest.mark.parametrize(
    "text", ["/data/a@b/c.mp4", "rtsp://host:554/a", "synthetic:demo?seed=1", "no address"]
)
def test_what_holds_no_secret_stays_readable(text: str) -> None:
    assert mask(text) == text


@given(st.text(st.characters(min_codepoint=33, max_codepoint=126), min_size=1))
def test_no_password_of_printable_characters_survives(password: str) -> None:
    assert mask(f"failed: rtsp://user:{password}@camera/stream !") == "failed: rtsp://***@camera/stream !"


@given(st.text())
def test_masking_twice_changes_nothing_more(text: str) -> None:
    assert mask(mask(text)) == mask(text)
