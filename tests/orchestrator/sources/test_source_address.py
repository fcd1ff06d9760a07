"""What a source's address tells of where it can be read."""

from __future__ import annotations

from pathlib import Path

import pytest

from mlbs_actors.errors import ConfigError
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


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("udp://@:5000", "udp-5000"),
        ("udp://@239.1.2.3:5000?localaddr=10.0.0.7", "239.1.2.3"),
        ("tcp://gate.local:99/", "gate.local"),
        ("rtmp://bob:hunter2@cam/live/hunter2?token=x", "live"),
        ("srt://cam:9000?passphrase=hunter2", "cam"),
        ("https://cam/hls/gate.m3u8", "gate"),
    ],
)
def test_a_camera_of_any_protocol_is_live_and_named_after_its_path_or_host(text: str, name: str) -> None:
    address = parse_address(text, HERE)
    assert (address.live, address.default_name) == (True, name)
    assert "hunter2" not in f"{address} {address!r}"


@pytest.mark.parametrize("text", ["http://cam:80a/x", "http://cam:99999/x", "https://bob:a[b@cam/x"])
def test_a_host_or_port_that_cannot_be_read_is_refused_at_once(text: str) -> None:
    with pytest.raises(ConfigError, match="the host or the port cannot be read"):
        parse_address(text, HERE)
