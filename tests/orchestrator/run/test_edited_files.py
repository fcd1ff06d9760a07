"""The zones of a run that is resumed after somebody has edited their file."""

from __future__ import annotations

from pathlib import Path

import pytest

from mlbs_actors.errors import ConfigError
from orchestrator.command_line import parse
from orchestrator.run.edited_files import keep_version, newest_version

GOOD = "streams: {gate: {zones: [{name: yard, polygon: [[0, 0], [1, 0], [1, 1]]}]}}"
BAD = GOOD.replace("[1, 1]", "[1, one]")


def test_every_version_is_kept_and_the_newest_is_in_force(tmp_path: Path) -> None:
    assert newest_version(tmp_path, "zones") is None
    for text in (GOOD, GOOD, GOOD.replace("yard", "lawn"), GOOD):
        keep_version(tmp_path, "zones", text)
    kept = sorted(path.name for path in tmp_path.iterdir())
    assert kept == ["zones-0001.yaml", "zones-0002.yaml", "zones-0003.yaml"]
    newest = newest_version(tmp_path, "zones")
    assert newest is not None
    assert (newest.name, newest.read_text()) == ("zones-0003.yaml", GOOD)


def test_a_resumed_run_goes_on_with_the_zones_of_before_where_the_file_cannot_be_used(tmp_path: Path) -> None:
    file, output = tmp_path / "zones.yaml", tmp_path / "out"
    words = ["cam.mp4", "--zones", str(file), "--output", str(output)]
    file.write_text(BAD)
    output.mkdir()
    for more in ([], ["--resume"]):  # nothing is there to go on with
        with pytest.raises(ConfigError, match="line 1"):
            parse([*words, *more])
    keep_version(output, "zones", GOOD)
    with pytest.raises(ConfigError, match="line 1"):
        parse(words)
    zones = parse([*words, "--resume"]).zones
    assert zones.text == GOOD
    assert zones.path == file
    assert zones.fault is not None
    assert "line 1" in zones.fault
    assert "The zones of before hold on" in zones.fault
    file.write_text(GOOD)
    assert parse([*words, "--resume"]).zones.fault is None
    left_out = parse(["cam.mp4", "--output", str(output), "--resume"]).zones
    assert (left_out.text, "hold on" in (left_out.fault or "")) == (GOOD, True)
