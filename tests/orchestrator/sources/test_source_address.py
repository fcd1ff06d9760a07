"""What a source's address tells of where it can be read."""

from __future__ import annotations

from pathlib import Path

import pytest

from orchestrator.sources.address import parse_address

HERE = Path("/videos")


@pytest.mark.parametrize(
    ("text", "path"),
    [
        ("street.mp4", HERE / "street.mp4"),
        ("/data/yard/", Path("/data/yard")),
        ("yard/*/img[0-9].png", HERE / "yard"),
        ("/dev/video0", Path("/dev/video0")),
        ("rtsp://bob:hunter2@cam/x", None),
        ("synthetic:demo", None),
    ],
)
def test_a_source_on_one_machine_names_what_must_be_there(text: str, path: Path | None) -> None:
    assert parse_address(text, HERE).path == path


@pytest.mark.parametrize("text", ["RTSP://bob:Pw@Cam/Door", "Synthetic:demo"])
def test_capitals_in_a_scheme_change_nothing(text: str) -> None:
    scheme, colon, rest = text.partition(":")
    assert parse_address(text, HERE) == parse_address(scheme.lower() + colon + rest, HERE)
