"""Zones in a program of one's own say what a run says of the same results."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from record_fakes import HEIGHT, WIDTH, segmentation

from mlbs_actors import ConfigError, FrameError, MultilayerSubtractor
from mlbs_actors.messages import Array, Segmentation
from mlbs_actors.scenes import scene
from mlbs_actors.source import SourceFrame
from orchestrator import Event, Minimum, Rule, Zone, Zones
from orchestrator.events.zones import EventSettings
from orchestrator.sinks.record import StreamRecord

RATE = 10.0
MIDDLE = {"name": "middle", "polygon": [[0.2, 0], [0.4, 0], [0.4, 1], [0.2, 1]]}
SETTINGS: dict[str, Any] = {
    "zones": [MIDDLE, {"name": "fence", "kind": "line", "polygon": [[15, 0], [15, 36]]}],
    "minimum": {"area": 60, "seconds": 0.3},
    "rules": [
        {"name": "stays", "dwell": {"zone": "middle", "seconds": 0.4}},
        {"name": "both", "count": {"zone": "middle", "at_least": 2}, "cool_down": 1},
        {"name": "through", "sequence": ["middle", {"fence": "left"}], "within": 5},
    ],
}


def walks() -> Iterator[tuple[Segmentation, Array]]:
    """Object 3 walks to the right, again and again; 5 is away every other eight frames; a cut."""
    for index in range(100):
        one = segmentation(index, 3, *([5] if index // 8 % 2 else []))
        picture = np.full((HEIGHT, WIDTH, 3), 100, np.uint8)
        yield (replace(one, status="cut") if index == 60 else one), picture


def turning() -> Iterator[tuple[Segmentation, Array]]:
    """Results of the engine under a turning camera."""
    made = scene("walker", frames=40, width=160, height=120)
    for picture, result in MultilayerSubtractor().segment(made.frame(index) for index in range(len(made))):
        yield result, picture


def recorded_events(
    folder: Path, settings: dict[str, Any], results: list[tuple[Segmentation, Array]]
) -> list[tuple[object, ...]]:
    """The lines of a record of these results."""
    rules = EventSettings.model_validate(settings).event_rules(Minimum(), 90)
    record = StreamRecord(folder, "yard", frozenset({"parquet"}), rules=rules)
    for result, picture in results:
        index = result.frame_index
        record.write(result, SourceFrame(index, picture, index / RATE, f"{index:05d}"))
    record.close(whole=True)
    lines = [json.loads(line) for line in (folder / "events.jsonl").read_text().splitlines()]
    return [
        (
            *(one[key] for key in ("kind", "frame", "time", "object", "zone", "direction", "rule", "reason")),
            *(one[key] for key in ("replaced_by", "score", "area", "seconds")),
            None if one["box"] is None else tuple(one["box"]),
            None if one["objects"] is None else tuple(one["objects"]),
        )
        for one in lines
    ]


def as_line(event: Event) -> tuple[object, ...]:
    """An event as :func:`recorded_events` has it."""
    rounded = (None if one is None else round(one, 3) for one in (event.score, event.area, event.seconds))
    return (
        *(event.kind, event.frame, round(event.pts, 3), event.layer, event.zone, event.direction),
        *(event.rule, event.reason, event.replaced_by, *rounded),
        None if event.region is None else event.region.box,
        event.objects,
    )


@pytest.mark.parametrize("made", [walks, turning])
@pytest.mark.parametrize("fixed_to", ["picture", "scene"])
def test_what_is_said_of_results_is_what_a_run_records_of_them(
    tmp_path: Path, made: Any, fixed_to: str
) -> None:
    results = list(made())
    settings = SETTINGS | {"zones": [MIDDLE | {"fixed_to": fixed_to}, SETTINGS["zones"][1]]}
    zones = Zones(**settings, frame_rate=RATE)
    said = [event for result, picture in results for event in zones.update(result, image=picture)]
    said += zones.end()
    assert [as_line(event) for event in said] == recorded_events(tmp_path, settings, results)
    if made is walks and fixed_to == "picture":
        assert {event.kind for event in said} >= {"born", "entered", "left", "crossed", "rule", "ended"}


def test_results_after_the_end_have_objects_that_are_born_anew() -> None:
    zones, said = Zones([MIDDLE]), list[str]()
    for index in range(2):
        said += [event.kind for event in zones.update(segmentation(index, 3)) if event.layer == 3]
        said += [event.kind for event in zones.end()]
    assert said == ["born", "ended"] * 2
    assert zones.end() == []
    with pytest.raises(FrameError, match="after that of frame 1"):
        zones.update(segmentation(1, 3))


def test_zones_are_made_of_values_too_and_read_from_a_file(tmp_path: Path) -> None:
    by_words = Zones(**SETTINGS, frame_rate=RATE)
    by_values = Zones(
        [Zone.model_validate(one) for one in SETTINGS["zones"]],
        minimum=Minimum(area=60, seconds=0.3),
        rules=[Rule.model_validate(one) for one in SETTINGS["rules"]],
        frame_rate=RATE,
    )
    path = tmp_path / "zones.yaml"
    path.write_text(json.dumps({"streams": {"gate": SETTINGS}}))
    by_file = Zones.read(path, "gate", frame_rate=RATE)
    for result, _ in walks():
        seconds = result.frame_index / RATE
        assert by_words.update(result) == by_values.update(result, seconds=seconds) == by_file.update(result)
    with pytest.raises(ConfigError, match="no zones of a stream 'yard'; it names gate"):
        Zones.read(path, "yard")


@pytest.mark.parametrize(
    ("zones", "sentence"),
    [
        ([{"name": "a", "polygon": [[0, 0], [1, 1]]}], "zones.0: the polygon of a zone needs at least 3"),
        ([MIDDLE, MIDDLE], "cannot be used: two zones are named 'middle'"),
        ([MIDDLE | {"colour": "red"}], "zones.0.colour: there is no such key"),
        ([{"name": "a", "polygn": [[0, 0], [1, 0], [1, 1]]}], r"polygn: .*did you mean polygon\?$"),
        (MIDDLE, r"zones is a dict; give a list, of one too: zones=\[\.\.\.\]"),
    ],
)
def test_what_is_no_zone_is_refused_with_its_name(zones: list[dict[str, Any]], sentence: str) -> None:
    with pytest.raises(ConfigError, match=sentence):
        Zones(zones)


def test_a_rate_that_is_no_number_is_refused() -> None:
    for rate in ("25", 0, None):
        with pytest.raises(ConfigError, match=f"frame_rate is {rate!r}; it must be above 0"):
            Zones([MIDDLE], frame_rate=rate)  # type: ignore[arg-type]


def test_a_file_that_cannot_be_read_is_told_without_an_option_of_the_command(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"^Zones\.read: .*no\.yaml cannot be read"):
        Zones.read(tmp_path / "no.yaml", "gate")


@pytest.mark.parametrize("given", [np.zeros((4, 6, 3), np.uint8), (None, segmentation(0)), [segmentation(0)]])
def test_what_is_no_result_is_told_with_what_to_give(given: Any) -> None:
    with pytest.raises(FrameError, match="update takes the result of one frame, not"):
        Zones([MIDDLE]).update(given)


def test_a_picture_of_another_size_than_the_result_is_refused() -> None:
    zones = Zones([MIDDLE | {"fixed_to": "scene"}])
    with pytest.raises(
        FrameError, match=r"The image is \(9, 9, 3\) uint8, the label map .*frame of this result"
    ):
        zones.update(segmentation(0), image=np.zeros((9, 9, 3), np.uint8))


def test_zones_show_their_names_and_how_far_they_are() -> None:
    zones = Zones(**SETTINGS, frame_rate=RATE)
    zones.update(segmentation(0))
    assert repr(zones) == "Zones(zones middle, fence, rules stays, both, through; 10 frames/s, frames 1)"


def test_results_come_in_order_and_with_a_picture_where_the_scene_is_looked_for() -> None:
    result = segmentation(3)
    zones = Zones([MIDDLE])
    zones.update(result)
    with pytest.raises(FrameError, match="in order"):
        zones.update(result)
    with pytest.raises(FrameError, match="give the image, too"):
        Zones([MIDDLE | {"fixed_to": "scene"}]).update(result)


def test_zones_need_no_packages_of_the_extra_run_but_those_of_read() -> None:
    code = """
import sys

for package in ("av", "filelock", "jinja2", "PIL", "ray", "rich"):
    sys.modules[package] = None
import orchestrator

orchestrator.Zones([{"name": "yard", "polygon": [[0, 0], [1, 0], [1, 1]]}])
sys.modules.pop("orchestrator.events.happenings")
sys.modules["pycocotools"] = None
sys.modules.pop("orchestrator.rows.endings")
try:
    orchestrator.Zones([])
except orchestrator.events.result_zones.ConfigError:
    sys.exit(1)
except ImportError as error:
    assert "pip install 'mlbs-actors[read]'" in str(error)
"""
    subprocess.run([sys.executable, "-c", code], check=True)
