"""A file of cameras: what each is asked for, and what becomes of what cannot be used."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import yaml

from mlbs_actors.config import Config
from mlbs_actors.errors import ConfigError
from orchestrator.command_line import parse
from orchestrator.option import Effect
from orchestrator.run.listed_stream import StreamsFile
from orchestrator.run.stream_list import parse_stream_list, read_stream_list
from orchestrator.run.stream_settings import StreamSettings, changes_between, settings_of
from orchestrator.yaml_file import masked_yaml

CAMERAS = """\
defaults:
  max_side: 960
  keep: [7d, 50GB]
  set: {layers.lookahead: 3}
  minimum: {area: 400}
streams:
  gate:
    source: rtsp://bob:secret@cam/gate
    save: masks
    set: {segmentation.label_cost: 9}
    zones: [{name: yard, polygon: [[0, 0], [1, 0], [1, 1]]}]
  lane: http://cam/lane
"""


def read(folder: Path, text: str, before: StreamsFile | None = None) -> StreamsFile:
    file = folder / "cameras.yaml"
    file.write_text(text)
    return parse_stream_list(file, before)


def asked(parsed: StreamsFile, name: str, *flags: str) -> StreamSettings:
    stream = next(one for one in parsed.streams if one.name == name)
    return settings_of(stream, parse(["--streams", "x", *flags]), Config())


def test_each_camera_has_its_own_values_then_the_defaults_then_those_of_the_command(tmp_path: Path) -> None:
    parsed = read(tmp_path, CAMERAS)
    assert parsed.faults == {}
    assert [(one.name, one.line) for one in parsed.streams] == [("gate", 7), ("lane", 12)]
    gate, lane = (asked(parsed, name, "--save", "parquet", "--max-frames", "9") for name in ("gate", "lane"))
    assert (gate.save, lane.save) == (frozenset({"masks"}), frozenset({"parquet"}))
    assert (gate.max_side, lane.max_side, gate.max_frames) == (960, 960, 9)
    assert gate.config.layers.lookahead == lane.config.layers.lookahead == 3
    assert (gate.config.segmentation.label_cost, lane.config.segmentation.label_cost) != (9.0, 9.0)
    assert gate.config.segmentation.label_cost == 9.0
    assert gate.keep is not None
    assert (gate.keep.seconds, gate.keep.size, gate.segment) == (7 * 86400, 50 * 10**9, 3600)
    assert [zone.name for zone in gate.rules.zones] == ["yard"]
    assert gate.rules.minimum.area == lane.rules.minimum.area == 400
    assert "secret" not in f"{parsed!r}"


@pytest.mark.parametrize(
    ("before", "after", "line", "words"),
    [
        ("max_side: 960", "max_side: nine", 2, "max_side 'nine' is not a whole number"),
        ("save: masks", "save: maks", 9, "knows no 'maks'"),
        ("save: masks", "sav: masks", 9, "no key 'sav'; did you mean save?"),
        ("label_cost: 9", "lable_cost: 9", 10, "did you mean"),
        ("[1, 1]", "[1, one]", 11, "zones"),
        ("rtsp://bob", "ftp://bob", 8, "source: 'ftp' is no known kind"),
        ("lane: http://cam/lane", "lane: {}", 12, "lane has no source"),
        ("lane:", "../lane:", 12, "cannot be the name"),
        ("streams:", "steams: {}\nstreams:", 6, "there is no key 'steams'"),
    ],
)
def test_a_value_that_cannot_be_used_is_told_with_its_line_and_the_one_before_stands_in(
    tmp_path: Path, before: str, after: str, line: int, words: str
) -> None:
    good = read(tmp_path, CAMERAS)
    text = CAMERAS.replace(before, after)
    parsed = read(tmp_path, text, good)
    assert list(parsed.faults) == [line]
    assert words in parsed.faults[line]
    assert "secret" not in parsed.faults[line]
    now = {one.name: one for one in parsed.streams}
    for stream in good.streams:
        if "../" not in after or stream.name != "lane":  # whose name is gone
            kept = asked(parsed, stream.name).described()
            if before != "max_side: 960":
                assert kept == asked(good, stream.name).described()
            assert now[stream.name].source == stream.source
    with pytest.raises(ConfigError, match=f"line {line}:"):
        read_stream_list(tmp_path / "cameras.yaml")


def test_a_new_camera_waits_until_its_faults_are_mended(tmp_path: Path) -> None:
    good = read(tmp_path, CAMERAS)
    parsed = read(tmp_path, CAMERAS + "  door: {source: rtsp://cam/door, save: all}\n", good)
    assert [one.name for one in parsed.streams] == ["gate", "lane"]
    parsed = read(tmp_path, CAMERAS + "  door: {source: rtsp://cam/door, save: masks}\n", good)
    assert [one.name for one in parsed.streams] == ["gate", "lane", "door"]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "names no stream"),
        ("- a\n", "names no stream"),
        ("streams:\n  a: b\n  a: c\n", "stands there twice"),
    ],
)
def test_a_file_without_streams_or_with_one_twice_is_refused(tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        read(tmp_path, text)


def test_of_names_that_differ_only_in_case_the_second_is_told(tmp_path: Path) -> None:
    parsed = read(tmp_path, "streams:\n  Gate: http://cam/1\n  gate: http://cam/2\n")
    assert [one.name for one in parsed.streams] == ["Gate"]
    assert parsed.faults == {3: "some disks take 'gate' for 'Gate'; choose another name"}


@pytest.mark.parametrize(
    ("before", "after", "effects"),
    [
        ("yard", "drive", {"rules": Effect.AT_ONCE}),
        ("keep: [7d, 50GB]", "keep: 8d", {"keep": Effect.AT_ONCE}),
        ("save: masks", "save: parquet", {"save": Effect.RESTART, "rules": Effect.AT_ONCE}),
        ("max_side: 960", "max_side: 480", {"max_side": Effect.EPOCH, "rules": Effect.AT_ONCE}),
        ("label_cost: 9", "label_cost: 8", {"config": Effect.EPOCH, "rules": Effect.AT_ONCE}),
    ],
)
def test_a_change_takes_effect_when_its_option_says(
    tmp_path: Path, before: str, after: str, effects: dict[str, Effect]
) -> None:
    was = asked(read(tmp_path, CAMERAS), "gate").described()
    now = asked(read(tmp_path, CAMERAS.replace(before, after)), "gate").described()
    assert changes_between(was, now) == effects
    assert changes_between(was, was) == {}


def test_a_camera_whose_mask_cannot_be_read_runs_with_the_one_before_or_none(tmp_path: Path) -> None:
    masked = CAMERAS.replace("save: masks", "save: masks\n    ignore: corner.txt")
    (tmp_path / "corner.txt").write_text("0,0,1,0,0,1")
    good = read(tmp_path, masked)
    (tmp_path / "corner.txt").unlink()
    for before, digest in ((good, asked(good, "gate").described()["ignore"]), (None, "")):
        parsed = read(tmp_path, masked, before)
        assert [one.name for one in parsed.streams] == ["gate", "lane"]
        assert asked(parsed, "gate").described()["ignore"] == digest
        assert list(parsed.faults) == [10]
        assert parsed.faults[10].startswith(f"ignore: {tmp_path / 'corner.txt'} cannot be read")


@pytest.mark.parametrize(
    ("entry", "words"),
    [
        ("keep: forever", "keep takes an age"),
        ("segment: week", "segment takes hour, day"),
        ("set: {layers: 3}", "'layers=3' sets no parameter"),
    ],
)
def test_a_fault_speaks_of_the_keys_of_the_file_not_of_flags(tmp_path: Path, entry: str, words: str) -> None:
    parsed = read(tmp_path, f"events: [{{url: ftp://x}}]\nstreams:\n  a: {{source: rtsp://cam/a, {entry}}}\n")
    assert parsed.faults[1].startswith("events takes mqtt://")
    assert words in parsed.faults[3]
    assert "--" not in "".join(parsed.faults.values())


def test_a_mistake_in_the_defaults_leaves_every_camera_as_it_was(tmp_path: Path) -> None:
    good = read(tmp_path, CAMERAS)
    parsed = read(tmp_path, CAMERAS.replace("max_side: 960", "max_side: nine"), good)
    for name in ("gate", "lane"):
        assert asked(parsed, name).described() == asked(good, name).described()


@pytest.mark.parametrize(
    ("entry", "words"),
    [
        ("  door: {source: rtsp://cam/door, was: gate}", "'gate' is a stream of this file"),
        ("  door: {source: rtsp://cam/door, was: 7}", "7 is a stream"),
        ("  door: {source: rtsp://cam/door, save: }", "save has no value; leave the key out"),
        ('  door: {source: rtsp://cam/door, set: {layers.lookahead: "2024-13-45"}}', "month"),
        ("  on: rtsp://cam/door", "True is no text in YAML; put the name in quotes"),
        ("  007: rtsp://cam/door", "7 is no text in YAML"),
        ('  "\\ud83d\\ude00": rtsp://cam/door', "control character"),
        ('  "a\\0b": rtsp://cam/door', "control character"),
        ("  cameras-0001.yaml: rtsp://cam/door", "name of a file of the run"),
        ('  door: "rtsp://cam/\\ud83d\\ude00"', "source"),
        ("  GATE: rtsp://cam/door", "some disks take 'GATE' for 'gate'"),
    ],
)
def test_whatever_stands_there_is_a_fault_and_ends_nothing(tmp_path: Path, entry: str, words: str) -> None:
    good = read(tmp_path, CAMERAS)
    parsed = read(tmp_path, f"{CAMERAS}{entry}\n", good)
    assert {one.name for one in good.streams} <= {one.name for one in parsed.streams}
    assert re.search(words, " ".join(parsed.faults.values())), parsed.faults
    assert parsed.text is None  # it is no version to go on with


@pytest.mark.parametrize(
    "url",
    [
        '"mqtt://bob:pa[ss@broker/t"',
        '"mqtt://bob:s3cret@:x/t"',
        "bob:s3cret@broker/t",
        "{a: b}",
        '"mqtt://h"',
    ],
)
def test_a_target_that_cannot_be_used_is_a_fault_without_its_password(tmp_path: Path, url: str) -> None:
    good = read(tmp_path, f"events: [{{url: mqtt://broker/t}}]\n{CAMERAS}")
    parsed = read(tmp_path, f"events: [{{url: {url}}}]\n{CAMERAS}", good)
    assert parsed.targets == good.targets
    assert list(parsed.faults) == [1]
    assert not any(secret in parsed.faults[1] for secret in ("pa[ss", "s3cret"))


def test_aliases_of_aliases_are_read_in_no_time(tmp_path: Path) -> None:
    lines = ["a0: &a0 [x, x]", *(f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]" for n in range(1, 12))]
    parsed = read(tmp_path, "\n".join([*lines, CAMERAS]))
    assert [one.name for one in parsed.streams] == ["gate", "lane"]


def test_a_kept_version_says_the_same_without_any_secret() -> None:
    text = """\
# once rtsp://bob:old@cam/
events:
  - {url: "mqtt://bob:s3cret@broker/t", kinds: [rule]}
  - {url: mqtt://b/c, password: s3cret}
  - url: bob:s3cret@broker/t
streams:
  gate: {source: "http://cam/x?token=s3cret", save: masks}   # the yard
  lane: "rtsp:\\/\\/bob:s3cret@cam/h"
  road: {source: 'rtmp://cam/live/s3cret', max_side: 960}
"""
    hidden = masked_yaml(text)
    assert "s3cret" not in hidden
    assert "old" not in hidden
    was, now = yaml.safe_load(text), yaml.safe_load(hidden)
    assert now["streams"].keys() == was["streams"].keys()
    assert now["streams"]["gate"] == {"source": "http://cam/x?token=***", "save": "masks"}
    assert now["streams"]["road"]["max_side"] == 960
    assert now["events"][0] == {"url": "mqtt://***@broker/t", "kinds": ["rule"]}
    assert "# the yard" in hidden
