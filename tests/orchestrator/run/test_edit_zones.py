"""Zones that were drawn, in the file that holds them: they are there, and nothing else has changed."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from mlbs_actors.errors import ConfigError
from orchestrator.run.edit_zones import DrawnZone, ZoneEditor, ZoneFiles
from orchestrator.run.stream_list import parse_stream_list
from orchestrator.run.zone_text import WrittenZone, with_zones

YARD = {"name": "yard", "polygon": [[0, 0.5], [1, 0.5], [1, 1]]}
NEW = WrittenZone(YARD)
LINE = "- {name: yard, polygon: [[0, 0.5], [1, 0.5], [1, 1]]}"

#: A file, the stream, and the file with one more zone.
ADDED = {
    "below the other keys": (
        "streams:\n  gate:\n    source: x   # ours\n    # nothing yet\n\n  lane: y\n",
        "gate",
        f"streams:\n  gate:\n    source: x   # ours\n    zones:\n      {LINE}\n    # nothing yet\n\n"
        "  lane: y\n",
    ),
    "below an address alone, whose comment stays": (
        "streams:\n    lane:   /dev/video0 # alone\n    gate: y\n",
        "lane",
        "streams:\n    lane:\n        source: /dev/video0 # alone\n        zones:\n"
        f"            {LINE}\n    gate: y\n",
    ),
    "in braces": (
        "streams: {gate: {source: 'x', }, lane: y}  # short",
        "gate",
        f"streams: {{gate: {{source: 'x', zones: [{LINE[2:]}], }}, lane: y}}  # short",
    ),
    "in braces, of an address alone": (
        "streams: {gate: {source: x}, lane: 'rtsp://b:p,w@h/[1]'}",
        "lane",
        f"streams: {{gate: {{source: x}}, lane: {{source: 'rtsp://b:p,w@h/[1]', zones: [{LINE[2:]}]}}}}",
    ),
    "in an empty list": (
        "streams:\n  gate:\n    zones: []  # none\n    source: x\n",
        "gate",
        f"streams:\n  gate:\n    zones: [{LINE[2:]}]  # none\n    source: x\n",
    ),
    "behind those that are there, at their column": (
        "streams:\n  gate:\n    zones:\n    - name: a\n      polygon: 0,0,1,0,1,1   # as it came\n"
        "    # end\n    source: x\n",
        "gate",
        "streams:\n  gate:\n    zones:\n    - name: a\n      polygon: 0,0,1,0,1,1   # as it came\n"
        f"    {LINE}\n    # end\n    source: x\n",
    ),
    "in a list in brackets over several lines": (
        "streams:\n  gate:\n    zones: [{name: a, polygon: '0,0,1,0,1,1'},  # a\n"
        "            {name: b, polygon: '0,0,1,0,1,1'},]\n",
        "gate",
        "streams:\n  gate:\n    zones: [{name: a, polygon: '0,0,1,0,1,1'},  # a\n"
        "            {name: b, polygon: '0,0,1,0,1,1'},\n"
        f"            {LINE[2:]},]\n",
    ),
    "where no line has an end, or all have two": (
        "\ufeffstreams:\r\n  'gate':\r\n    source: x\r\n    note: |\r\n      a # b\r\n"
        '  "la:ne":\r\n    source: y',
        "la:ne",
        "\ufeffstreams:\r\n  'gate':\r\n    source: x\r\n    note: |\r\n      a # b\r\n"
        f'  "la:ne":\r\n    source: y\r\n    zones:\r\n      {LINE}',
    ),
    "behind a block of text": (
        "streams:\n  gate:\n    source: |-\n      x\n      # y\n\n  lane: z\n",
        "gate",
        f"streams:\n  gate:\n    source: |-\n      x\n      # y\n    zones:\n      {LINE}\n\n  lane: z\n",
    ),
    "of a stream that the file does not name": (
        "minimum: {area: 200}  # all\nstreams:\n  gate:\n    minimum: {area: 3}\n",
        "la#ne",
        "minimum: {area: 200}  # all\nstreams:\n  gate:\n    minimum: {area: 3}\n"
        f"  la#ne:\n    zones:\n      {LINE}\n",
    ),
    "of a stream whose name needs quotes": (
        "streams: {}\n",
        "- 1: 'a'",
        f"streams: {{'- 1: ''a''': {{zones: [{LINE[2:]}]}}}}\n",
    ),
    "in a file without streams": (
        "minimum: {area: 200}",
        "gate",
        f"minimum: {{area: 200}}\nstreams:\n  gate:\n    zones:\n      {LINE}",
    ),
    "below a name with nothing": (
        "streams:\n  gate:   # later\n  lane: x\n",
        "gate",
        f"streams:\n  gate:   # later\n    zones:\n      {LINE}\n  lane: x\n",
    ),
}

LIST = """\
streams:
  gate:
    zones:  # ours
      # the yard
      - name: a
        polygon: [[0, 0], [1, 0], [1, 1]]

      # what follows was copied
      - {name: b, coordinates: "0,0,1,0,1,1"}   # from there
      -
        name: c
        polygon: [[10, 10], [99, 10], [99, 99]]
    # end
    source: x
"""


@pytest.mark.parametrize("case", ADDED)
def test_a_new_zone_is_written_and_all_else_stays_as_it_was(case: str) -> None:
    text, stream, meant = ADDED[case]
    there = len(yaml.safe_load(meant)["streams"][stream]["zones"]) - 1
    assert with_zones(text, stream, [*(WrittenZone({}, place) for place in range(there)), NEW]) == meant
    assert yaml.safe_load(meant)["streams"][stream]["zones"][-1] == YARD


def test_deleting_and_changing_zones_leaves_the_text_of_the_others() -> None:
    kept = [WrittenZone({}, place) for place in range(3)]
    assert with_zones(LIST, "gate", kept) == LIST
    moved = WrittenZone({"name": "b", "polygon": [[0, 0.25], [1, 0], [1, 1]]}, 1, changed=True)
    assert with_zones(LIST, "gate", [kept[0], moved, kept[2]]) == LIST.replace(
        '{name: b, coordinates: "0,0,1,0,1,1"}', "{name: b, polygon: [[0, 0.25], [1, 0], [1, 1]]}"
    )
    without = LIST.replace("      - name: a\n        polygon: [[0, 0], [1, 0], [1, 1]]\n", "")
    assert with_zones(LIST, "gate", kept[1:]) == without
    last = LIST[LIST.index("      -\n") : LIST.index("    # end")]
    assert with_zones(LIST, "gate", kept[:2]) == LIST.replace(last, "")
    assert with_zones(LIST, "gate", [kept[0], NEW]).count("# what follows was copied") == 1
    none = with_zones(LIST, "gate", [])
    assert none.splitlines()[2:4] == ["    zones: []  # ours", "      # the yard"]
    assert yaml.safe_load(none) == {"streams": {"gate": {"zones": [], "source": "x"}}}


def test_a_zone_that_is_the_end_of_the_file_goes_without_leaving_an_end_of_line() -> None:
    text = "streams:\n  gate:\n    zones:\n      - {name: a}\n      - {name: b}"
    assert with_zones(text, "gate", [WrittenZone({}, 0)]) == text[: text.index("\n      - {name: b")]


def test_what_stands_elsewhere_in_the_file_is_not_changed_for_one_stream() -> None:
    text = "streams:\n  a: {source: x, zones: &all [{name: z}]}\n  b: {source: y, zones: *all}\n"
    with pytest.raises(ConfigError, match="zones is an alias"):
        with_zones(text, "b", [NEW])
    items = (
        "streams:\n  a: {source: x, zones: [&z {name: z}]}\n  b:\n    zones:\n      - *z\n      - {name: q}\n"
    )
    with pytest.raises(ConfigError, match="zones is an alias"):
        with_zones(items, "b", [WrittenZone({}, 1)])


NAMES = st.text(st.characters(exclude_categories=["Cs", "Cc", "Zl", "Zp"]), min_size=1, max_size=12)
SHARES = st.floats(0, 1)
POLYGONS = st.lists(
    st.tuples(SHARES, SHARES), min_size=4, max_size=7, unique_by=lambda p: (round(p[0], 3), round(p[1], 3))
)


def styled(content: object, style: str) -> str:
    """Write a file of cameras in one of several ways, with comments where blocks allow some."""
    flow = {"flow": True, "block": False, "mixed": None}[style]
    text = yaml.safe_dump(content, default_flow_style=flow, allow_unicode=True, sort_keys=False)
    if style == "flow":
        return text.replace("\n", "\r\n")
    return "# first\n" + text.replace("/dev/video1\n", "/dev/video1  # here\n    # below\n") + "# last"


@settings(max_examples=60, deadline=None)
@given(
    st.dictionaries(
        st.sampled_from(["gate", "la ne", "Hof, 1", "'q'", "ü#"]),
        st.lists(NAMES, max_size=3, unique=True) | st.none(),
        min_size=1,
    ),
    st.sampled_from(["flow", "block", "mixed"]),
    st.lists(st.tuples(NAMES, POLYGONS), max_size=2),
    st.data(),
)
def test_whatever_is_drawn_is_what_the_file_says_and_its_other_streams_stay_to_the_letter(
    tmp_path_factory: pytest.TempPathFactory,
    before: dict[str, list[str] | None],
    style: str,
    new: list[Any],
    data: st.DataObject,
) -> None:
    streams = {
        stream: "/dev/video0"
        if names is None
        else {
            "source": "/dev/video1",
            "zones": [{"name": name, "polygon": [[0, 0.5], [1, 0.5], [1, 1]]} for name in names],
        }
        for stream, names in before.items()
    }
    path = tmp_path_factory.mktemp("files") / "cameras.yaml"
    path.write_bytes(styled({"defaults": {"max_side": 960}, "streams": streams}, style).encode())
    text, stream = path.read_bytes().decode(), data.draw(st.sampled_from(sorted(before)))
    editor = ZoneEditor(ZoneFiles(path))
    known = editor.read(stream)
    kept = [one for one in known.zones if data.draw(st.booleans())]
    drawn = [DrawnZone(name=one.name, was=one.name) for one in kept]
    drawn += [DrawnZone(name=name, polygon=tuple(polygon)) for name, polygon in new]
    if len({one.name for one in drawn}) < len(drawn):
        with pytest.raises(ConfigError, match="Two zones are named"):
            editor.write(stream, drawn, known.version)
        assert path.read_bytes().decode() == text
        return
    editor.write(stream, drawn, known.version)
    after = editor.read(stream).zones
    assert [one.name for one in after] == [one.name for one in drawn]
    for one, (_, polygon) in zip(after[len(kept) :], new, strict=True):
        assert sum(one.polygon, ()) == pytest.approx(sum(polygon, ()), abs=1e-4)
    parsed = parse_stream_list(path)
    assert not parsed.faults
    assert {one.name: one.own.options for one in parsed.streams} == {
        name: {"max_side": 960} for name in before
    }
    for other in before.keys() - {stream}:
        lines = yaml.safe_dump({other: streams[other]}, allow_unicode=True)
        assert yaml.safe_load(path.read_bytes())["streams"][other] == yaml.safe_load(lines)[other]
    comments = [line.partition("#")[2] for line in text.splitlines() if "# " in line]
    assert all(comment in path.read_text(encoding="utf-8") for comment in comments)


# Which file, and what is refused


def cameras(folder: Path, text: str = LIST) -> Path:
    path = folder / "cameras.yaml"
    path.write_text(text.replace("source: x", "source: /dev/video0"))
    return path


def drawn(name: str = "new", was: str | None = None) -> DrawnZone:
    return DrawnZone(name=name, polygon=None if was else ((0, 0.12345678), (1, 0.5), (1, 1)), was=was)


def test_a_zone_keeps_what_was_not_drawn_of_it(tmp_path: Path) -> None:
    scene = "{name: b, fixed_to: scene, kind: line, coordinates: '0,0,1,0'}"
    path = cameras(tmp_path, f"streams:\n  gate:\n    source: x\n    zones: [{scene}]\n")
    editor = ZoneEditor(ZoneFiles(path))
    moved = DrawnZone(name="c", kind="line", polygon=((0, 0.5), (0.25, 1)), was="b")
    editor.write("gate", [moved], editor.read("gate").version)
    (zone,) = editor.read("gate").zones
    assert (zone.name, zone.kind, zone.fixed_to, zone.polygon) == (
        "c",
        "line",
        "scene",
        ((0, 0.5), (0.25, 1)),
    )


def test_a_file_keeps_its_mode_and_a_link_to_it_stays_one(tmp_path: Path) -> None:
    path, link = cameras(tmp_path), tmp_path / "link.yaml"
    path.chmod(0o640)
    link.symlink_to(path.name)
    editor = ZoneEditor(ZoneFiles(link))
    editor.write("gate", [drawn()], editor.read("gate").version)
    assert path.stat().st_mode & 0o777 == 0o640
    assert link.is_symlink()
    assert [one.name for one in editor.read("gate").zones] == ["new"]
    assert sorted(one.name for one in tmp_path.iterdir()) == ["cameras.yaml", "link.yaml"]


def test_what_somebody_else_has_changed_meanwhile_is_not_lost(tmp_path: Path) -> None:
    path = cameras(tmp_path)
    editor = ZoneEditor(ZoneFiles(path))
    version = editor.read("gate").version
    cameras(tmp_path, LIST.replace("name: a", "name: other"))
    with pytest.raises(ConfigError, match="reload the page"):
        editor.write("gate", [drawn()], version)
    assert "other" in path.read_text()


def test_a_zone_that_a_rule_names_stays(tmp_path: Path) -> None:
    rule = "    rules:\n      - {name: long, dwell: {zone: a, seconds: 3}}\n"
    path = cameras(tmp_path, LIST + rule)
    editor, text = ZoneEditor(ZoneFiles(path)), path.read_text()
    for zones in ([], [drawn("renamed", was="a")]):
        with pytest.raises(ConfigError, match="The rule 'long' names 'a'"):
            editor.write("gate", zones, editor.read("gate").version)
    assert path.read_text() == text


def test_zones_of_all_streams_are_written_out_for_the_one_that_gets_another(tmp_path: Path) -> None:
    defaults = "defaults: {zones: [{name: d, polygon: '0,0,1,0,1,1'}]}\n"
    path = cameras(tmp_path, f"{defaults}streams:\n  gate: /dev/video0\n  lane: /dev/video1\n")
    editor = ZoneEditor(ZoneFiles(path))
    editor.write("gate", [drawn("d", was="d"), drawn()], editor.read("gate").version)
    assert [one.name for one in editor.read("gate").zones] == ["d", "new"]
    assert [one.name for one in editor.read("lane").zones] == ["d"]
    assert path.read_text().startswith(defaults)


def test_zones_go_where_those_of_the_stream_are(tmp_path: Path) -> None:
    path, zones = (
        cameras(tmp_path, "streams:\n  gate: /dev/video0\n  lane: /dev/video1\n"),
        tmp_path / "zones.yaml",
    )
    zones.write_text("streams:\n  gate:\n    minimum: {area: 3}\n")
    editor = ZoneEditor(ZoneFiles(path, zones))
    for stream in ("gate", "lane"):
        editor.write(stream, [drawn(stream)], editor.read(stream).version)
    assert "gate" in (
        line.strip("- {").split(",")[0].removeprefix("name: ") for line in zones.read_text().splitlines()
    )
    assert "name: lane" in path.read_text()
    assert "name: lane" not in zones.read_text()


def test_a_run_of_a_plain_list_says_what_to_do(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="write its streams into a file of cameras"):
        ZoneEditor(ZoneFiles()).read("gate")
    zones = tmp_path / "zones.yaml"
    zones.write_text("streams: {}\n")
    editor = ZoneEditor(ZoneFiles(zones=zones))
    editor.write("gate", [drawn()], editor.read("gate").version)
    assert zones.read_text().startswith(
        "streams: {gate: {zones: [{name: new, polygon: [[0, 0.1235], [1, 0.5], [1, 1]]}]}}"
    )


def test_a_file_that_cannot_be_replaced_safely_is_left_alone(tmp_path: Path) -> None:
    text = "streams:\n  gate: {source: x, zones: [&a {name: a, polygon: '0,0,1,0,1,1'}]}\n"
    text += "  lane: {source: x, zones: [*a]}\n"
    path = cameras(tmp_path, text)
    editor, text = ZoneEditor(ZoneFiles(path)), path.read_text()
    with pytest.raises(ConfigError, match=r"cameras\.yaml is written in a way"):
        editor.write("gate", [], editor.read("gate").version)
    assert path.read_text() == text


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_folder_that_cannot_be_written_to_is_told(tmp_path: Path) -> None:
    path = cameras(tmp_path)
    editor = ZoneEditor(ZoneFiles(path))
    tmp_path.chmod(0o500)
    with pytest.raises(ConfigError, match=r"cameras\.yaml cannot be written: Permission denied"):
        editor.write("gate", [drawn()], editor.read("gate").version)
    tmp_path.chmod(0o700)
