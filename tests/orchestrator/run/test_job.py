"""The streams of a run whose file of zones is edited meanwhile."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from mlbs_actors.config import Config
from mlbs_actors.errors import ConfigError
from mlbs_actors.record.recorded_stream import read_description
from orchestrator.command_line import parse
from orchestrator.events.delivery import Deliveries
from orchestrator.events.zones import EventRules
from orchestrator.options import Arguments
from orchestrator.pictures.privacy import is_private
from orchestrator.run import file_watch
from orchestrator.run.argument_streams import argument_streams
from orchestrator.run.edited_files import newest_version
from orchestrator.run.job import Job
from orchestrator.run.listed_stream import StreamsFile
from orchestrator.run.run_folder import RunFolder
from orchestrator.run.stream_list import read_stream_list
from orchestrator.sinks.private_record import PrivateRecord

ZONES = """streams:
  a: {zones: [{name: yard, polygon: [[0, 0], [1, 0], [1, 1]]}]}
  b: {zones: [{name: lawn, polygon: [[0, 0], [1, 0], [1, 1]]}]}
"""


def job_of(
    listed: StreamsFile, arguments: Arguments, folder: Path, say: Callable[[str], None] = print
) -> Job:
    deliveries = Deliveries((), folder, say)
    return Job(listed, arguments, Config(), RunFolder(folder), None, say, deliveries)


def test_an_edited_file_of_zones_configures_the_streams_whose_rules_have_changed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(file_watch, "_LOOK_SECONDS", 0.0)
    file, listed, output = tmp_path / "zones.yaml", tmp_path / "list.txt", tmp_path / "out"
    file.write_text(ZONES)
    listed.write_text("a synthetic:demo\nb synthetic:demo\n")
    words = ["--streams", str(listed), "--zones", str(file), "--output", str(output), "--watch"]
    said: list[str] = []
    job = job_of(read_stream_list(listed), parse(words), output, said.append)
    output.mkdir()
    assert [job.changes() for _ in range(3)] == [None] * 3

    def edited(text: str) -> object:
        draft = tmp_path / "draft"
        draft.write_text(text)
        draft.replace(file)
        assert job.changes() is None, "a file that may be half-written was taken"
        return job.changes()

    change = edited(ZONES.replace("yard", "drive"))
    assert change is not None
    [(spec, rules)] = change.configured  # type: ignore[attr-defined]
    assert isinstance(rules, EventRules)
    assert (spec.name, rules.zones[0].name) == ("a", "drive")
    assert spec.open_sink.keywords["rules"] == rules
    assert rules.told["max_side"] is None
    assert rules.described().keys() >= {"max_side", "save", "zones.drive"}
    assert said == ["From now on for a: other zones or rules."]
    newest, description = newest_version(output, "zones"), read_description(output)
    assert newest is not None
    assert newest.read_text() == file.read_text()
    assert description is not None
    assert description["zones"] == parse(words).zones.digest
    # A fault is told, and changes nothing until it is mended.
    assert edited(ZONES.replace("[1, 1]", "[1, one]")) is None
    assert said[-1].endswith("The zones of before hold on.")
    assert "line 2" in said[-1]
    assert edited(ZONES.replace("yard", "drive") + "# mended\n") is not None
    assert "can be read again" in said[-1]
    edited(ZONES.replace("a:", "aa:"))
    assert said[-2:] == [
        "--zones names aa, not streams of this run at present.",
        "From now on for a: other zones or rules.",
    ]


def test_what_is_edited_before_the_run_looks_at_its_files_is_taken_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(file_watch, "_LOOK_SECONDS", 0.0)
    zones, cameras = tmp_path / "zones.yaml", tmp_path / "cameras.yaml"
    zones.write_text(ZONES)
    cameras.write_text("streams: {a: 'synthetic:demo', b: 'synthetic:demo'}\n")
    stamp = file_watch.stamp_of(cameras)
    listed = replace(read_stream_list(cameras), stamp=stamp)
    words = ["--streams", str(cameras), "--zones", str(zones), "--output", str(tmp_path), "--watch"]
    arguments = parse(words)
    zones.write_text(ZONES.replace("yard", "driveway"))
    cameras.write_text("streams: {a: 'synthetic:demo', b: 'synthetic:demo', c: 'synthetic:demo'}\n")
    job = job_of(listed, arguments, tmp_path)
    assert job.changes() is None
    change = job.changes()
    assert change is not None
    assert [spec.name for spec in change.added] == ["c"]
    change = job.changes() if not change.configured else change
    assert change is not None
    [(spec, rules)] = change.configured
    assert isinstance(rules, EventRules)
    assert (spec.name, rules.zones[0].name) == ("a", "driveway")


@pytest.mark.parametrize("side", [[], ["--max-side", "96"]])
def test_the_record_of_a_private_run_gets_blurred_pictures_only(tmp_path: Path, side: list[str]) -> None:
    arguments = parse(["demo", "--private", *side, "--output", str(tmp_path / "out")])
    streams = argument_streams(arguments.sources)
    job = job_of(StreamsFile(streams, {}), arguments, tmp_path / "out")
    [spec] = job.specs
    assert isinstance(spec.open_sink(), PrivateRecord)
    assert is_private(job.description)


def test_what_was_not_private_does_not_become_so(tmp_path: Path) -> None:
    folder = RunFolder(tmp_path / "out")
    folder.path.mkdir()
    plain = job_of(StreamsFile((), {}), parse(["demo"]), folder.path).description
    hidden = job_of(StreamsFile((), {}), parse(["demo", "--private"]), folder.path).description
    with pytest.raises(ConfigError, match="--private"):
        folder.refuse_other(plain, hidden)
    with pytest.raises(ConfigError, match="--save cutouts"):
        parse(["demo", "--private", "--save", "cutouts"])
