"""``--zones``: what the file may say, and where its faults are reported."""

from __future__ import annotations

import re
from pathlib import Path
from typing import get_args

import pytest
import yaml

from mlbs_actors.errors import ConfigError
from orchestrator.command import run_command
from orchestrator.events.event import EventKind
from orchestrator.events.ground import crossing, is_inside
from orchestrator.events.zones import EventRules, EventSettings, Minimum, Zone, read_zones

GOOD = """
minimum: {area: 50}
streams:
  gate:
    minimum: {seconds: 0.5, speed: 4}
    zones:
      - name: yard
        polygon: [[0, 0.5], [1, 0.5], [1, 1], [0, 1]]
      - {name: fence, kind: line, polygon: [[10, 20], [300, 20]]}
    rules:
      - {name: stays, dwell: {zone: yard, seconds: 10}}
      - {name: goes in, sequence: [{fence: right}, yard], within: 30}
      - {name: queue, count: {zone: yard, at_least: 3, seconds: 20}}
      - {name: rush, count: {line: fence, at_least: 9, within: 60}}
  door: {zones: []}
"""


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "zones.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def test_shares_and_pixels_and_least_sizes_are_read(tmp_path: Path) -> None:
    zones = read_zones(written(tmp_path, GOOD))
    gate = zones.rules_of("gate", 30)
    yard, fence = gate.zones
    assert yard.corners((480, 640)) == ((0, 240), (640, 240), (640, 480), (0, 480))
    assert fence.corners((480, 640)) == ((10, 20), (300, 20))
    assert (gate.minimum.area, gate.minimum.seconds, gate.minimum.speed) == (0, 0.5, 4)
    assert zones.rules_of("door", 30).minimum.area == zones.rules_of("street", 30).minimum.area == 50
    assert zones.rules_of("street", 30).zones == ()
    assert zones.streams == {"gate", "door"}


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (
            ("name: yard", "nam: yard"),
            r"line 7: streams\.gate\.zones\.0\.nam: there is no such key; did you mean name\?",
        ),
        (("kind: line", "kind: wall"), r"line 9: streams\.gate\.zones\.1\.kind: .*'zone' or 'line'"),
        (("[300, 20]", "[10, 20]"), r"line 9: .* needs at least 2 different points"),
        (("[0, 1]]", "[0, 1.0, 2]]"), r"line 8: streams\.gate\.zones\.0\.polygon\.3"),
        (
            ("seconds: 0.5", "seconds: -1"),
            r"line 5: streams\.gate\.minimum\.seconds: .*greater than or equal",
        ),
        (("name: fence", "name: yard"), r"line 4: streams\.gate: two zones are named 'yard'"),
        (("door:", "gate:"), r"line 15: 'gate' stands there twice"),
        (("[10, 20]", "[10, 20"), r"line 9: "),
        (("0.5], [1, 0.5]", "0.5], [640, 0.5]"), r"line 8: .*polygon: it has both shares .* and px \(640\)"),
        (("name: stays", "name: rush"), r"line 4: streams\.gate: two rules are named 'rush'"),
        (("zone: yard, seconds: 10", "zone: yrad, seconds: 10"), r"'stays' names 'yrad', .*'yard', 'fence'"),
        (("zone: yard, seconds: 10", "zone: fence, seconds: 10"), r"'stays' needs a zone; 'fence' is none"),
        (("line: fence, at", "line: yard, at"), r"'rush' needs a line; 'yard' is none"),
        (("{fence: right}", "{yard: right}"), r"'goes in' has a direction of 'yard', which is no line"),
        (("{fence: right}", "{fence: up}"), r"line 12: .*'left' or 'right'"),
        ((", within: 30", ""), r"line 12: .*a 'sequence' needs 'within'"),
        (("at_least: 9, within: 60", "at_least: 9"), r"line 14: .*'within' some seconds"),
        (("seconds: 20", "within: 20"), r"line 13: .*are of a line"),
        (("dwell: {zone: yard, seconds: 10}", "cool_down: 3"), r"line 11: .*needs one of 'dwell'"),
        (("[{fence: right}, yard]", "[yard]"), r"line 12: "),
        ((GOOD, ""), r"is empty"),
    ],
)
def test_a_fault_is_reported_with_its_line(tmp_path: Path, change: tuple[str, str], told: str) -> None:
    with pytest.raises(ConfigError, match=told):
        read_zones(written(tmp_path, GOOD.replace(*change)))


def test_a_stream_that_is_not_of_the_run_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    zones = written(tmp_path, GOOD)
    command = ["demo", "--output", str(tmp_path / "out"), "--zones", str(zones)]
    assert run_command(command) == 2
    assert "--zones names the stream 'door', which is not one of this run." in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_point_is_inside_by_the_even_odd_rule() -> None:
    bay = [(0.0, 0.0), (9.0, 0.0), (9.0, 9.0), (6.0, 9.0), (6.0, 3.0), (3.0, 3.0), (3.0, 9.0), (0.0, 9.0)]
    assert is_inside((1, 8), bay)
    assert is_inside((8, 8), bay)
    assert not is_inside((4.5, 8), bay)
    assert not is_inside((10, 1), bay)


def test_the_settings_of_one_stream_are_read_as_they_stand_in_the_file(tmp_path: Path) -> None:
    entry = yaml.safe_load(GOOD)["streams"]["gate"]
    rules = EventSettings.model_validate(entry).event_rules(Minimum(), 30)
    assert rules == read_zones(written(tmp_path, GOOD)).rules_of("gate", 30)
    assert [rule.name for rule in rules.rules] == ["stays", "goes in", "queue", "rush"]


def test_settings_without_rules_have_the_digest_of_before_there_were_rules() -> None:
    zone = Zone(name="yard", polygon=((0, 0.5), (1, 0.5), (1, 1)))
    assert EventRules((zone,), Minimum(area=50), 30).digest == "7d4f6fa2faae632f"


@pytest.mark.parametrize(
    "text", ["{{ yard }}: x", "streams: {a: {zones: [{name: 2024-99-99}]}}", "&a {x: *a}"]
)
def test_what_yaml_itself_stumbles_over_is_refused_too(tmp_path: Path, text: str) -> None:
    with pytest.raises(ConfigError, match="--zones"):
        read_zones(written(tmp_path, text))


def test_the_side_is_that_of_somebody_who_looks_along_the_line() -> None:
    upwards = [(5.0, 10.0), (5.0, 0.0)]
    assert crossing((2, 5), (8, 5), upwards) == "right"
    assert crossing((8, 5), (2, 5), upwards) == "left"
    assert crossing((2, 12), (8, 12), upwards) is None  # around its end
    assert crossing((2, 5), (4, 5), upwards) is None
    corner = [(5.0, 0.0), (5.0, 10.0), (15.0, 10.0)]
    assert crossing((4, 8), (20, 20), corner) is None
    assert crossing((4, 5), (8, 12), [(5.0, 0.0), (5.0, 20.0)]) == "left"


def test_the_page_shows_a_file_that_is_accepted_and_every_kind_of_event(tmp_path: Path) -> None:
    page = (Path(__file__).parents[3] / "docs/events.md").read_text(encoding="utf-8")
    example = page.split("```yaml\n")[1].partition("```")[0]
    assert read_zones(written(tmp_path, example)).rules_of("gate", 30).zones[1].kind == "line"
    of_rules = page.partition("## Rules")[2].split("```yaml\n")[1].partition("```")[0]
    assert read_zones(written(tmp_path, of_rules)).rules_of("gate", 30).rules
    rows = page.partition("| `kind` | when |")[2].partition("\n\n")[0].splitlines()[2:]
    kinds = [kind for row in rows for kind in re.findall(r"`([a-z ]+)`", row.split("|")[1])]
    assert sorted(kinds) == sorted(get_args(EventKind))
