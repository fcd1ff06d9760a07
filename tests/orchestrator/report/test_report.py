"""The report of a run: true, whole in one file, legible for people and for screen readers."""

from __future__ import annotations

import base64
import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import cv2
import numpy as np
import pytest
from chromium import open_page
from record_fakes import EVERYTHING, HEIGHT, WIDTH, frame, segmentation, write_run, write_stream

from mlbs_actors.messages import Region, Segmentation
from mlbs_actors.source import SourceFrame
from orchestrator.events.zones import EventRules, Zone
from orchestrator.report.__main__ import main
from orchestrator.report.charts import object_count_chart, timeline_chart
from orchestrator.report.history import frame_ranges, read_history
from orchestrator.report.page import render_report
from orchestrator.report.pictures import overlay_strip
from orchestrator.run.stream_state import StreamState
from orchestrator.sinks.record import StreamRecord


class Tags(HTMLParser):
    """All tags of a page with their attributes."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.found: list[tuple[str, dict[str, str | None]]] = []
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found.append((tag, dict(attrs)))

    def of(self, *names: str) -> list[dict[str, str | None]]:
        return [attributes for tag, attributes in self.found if tag in names]


@pytest.fixture(scope="module")
def run_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("out")
    states = [
        write_stream(folder / "yard"),
        StreamState("a<b>", "failed", error="The file <is> gone."),
    ]
    (folder / "a<b>").mkdir()
    write_run(folder, states)
    return folder


# What was counted


def test_the_page_draws_the_counts_of_every_place_and_where_objects_stood(tmp_path: Path) -> None:
    yard = Zone(name="the <yard>", polygon=((0, 0), (1, 0), (1, 1), (0, 1)))
    fence = Zone(name="fence", kind="line", polygon=((0.3, 0), (0.3, 1)))
    record = StreamRecord(tmp_path / "yard", "yard", EVERYTHING, rules=EventRules((yard, fence)))
    for index in range(40):
        record.write(segmentation(index, 3), replace(frame(index), pts=300.0 * index))
    state = StreamState("yard", "done", read=40, committed=record.close(whole=True))
    write_run(tmp_path, [state])
    page = render_report(tmp_path)
    labels = [attributes["aria-label"] or "" for attributes in Tags(page).of("svg")]
    assert "the <yard> by the hour: entered 1; at most 1 an hour" in labels
    assert "fence by the hour: to the left 1, to the right 1; at most 1 an hour" in labels
    assert any(re.fullmatch(r"Cells in which objects stood: \d+ of 2304", label) for label in labels)
    assert "<title>hour 0: 1 entered</title>" in page
    assert 'href="yard/counts.csv"' in page


# What the tables tell


def test_the_lives_of_the_objects_are_read_from_the_record(run_folder: Path) -> None:
    history = read_history(run_folder / "yard")
    assert history is not None
    assert [(life.layer, life.frames, life.mean_area) for life in history.lives] == [(3, 39, 80), (5, 34, 80)]
    # The undecodable frame hides nobody.
    assert [life.spans for life in history.lives] == [[(0, 39)], [(0, 19), (25, 39)]]
    assert history.lost == (("quarantined", (10,)),)
    assert history.frames.tolist() == [index for index in range(40) if index != 10]
    assert history.objects_in(22) == [3]
    assert [(stage.stage, stage.mean) for stage in history.stages] == [("cut", 3.0), ("track", 2.0)]


def test_rows_that_no_line_of_the_commit_log_stands_for_do_not_count(tmp_path: Path) -> None:
    write_stream(tmp_path / "yard")
    log = tmp_path / "yard/commits.jsonl"
    first, second, _ = log.read_text().splitlines()
    log.write_text(f"{first}\n{second[:10]}")
    history = read_history(tmp_path / "yard")
    assert history is not None
    assert history.frames.tolist() == list(range(8))


def test_ranges_are_what_counting_one_by_one_gives() -> None:
    assert frame_ranges((3, 4, 5, 9, 11, 12)) == [(3, 5), (9, 9), (11, 12)]
    assert frame_ranges(()) == []


def write_telling_frames(record: StreamRecord, count: int) -> None:
    """The brightness of a picture tells its frame."""
    for index in range(count):
        given = frame(index)
        assert given.image is not None
        given.image[:] = 3 * index
        record.write(segmentation(index), given)


def assert_strip_of_70(folder: Path) -> None:
    history = read_history(folder)
    assert history is not None
    strip = overlay_strip(folder, history, 6)
    assert [picture.frame for picture in strip] == [0, 14, 28, 41, 55, 69]
    for picture in strip:
        data = np.frombuffer(base64.b64decode(picture.data.partition(",")[2]), np.uint8)
        image = cv2.imdecode(data, cv2.IMREAD_COLOR)
        assert image is not None
        assert image.shape[:2] == (picture.height, picture.width)
        assert abs(float(np.median(image[-6:])) - 3 * picture.frame) < 4


def test_the_strip_holds_the_pictures_of_the_frames_it_names(tmp_path: Path) -> None:
    record = StreamRecord(tmp_path / "a", "a", EVERYTHING)
    write_telling_frames(record, 70)
    record.close(whole=True)
    assert_strip_of_70(tmp_path / "a")


def test_the_strip_of_a_resumed_stream_is_taken_from_all_its_videos(tmp_path: Path) -> None:
    for last in (40, 70):
        record = StreamRecord(tmp_path / "a", "a", EVERYTHING)
        write_telling_frames(record, last)
        record.close(whole=False)
    assert (tmp_path / "a/overlay-00000040.mp4").exists()
    assert_strip_of_70(tmp_path / "a")


def test_a_missing_or_broken_overlay_gives_no_pictures(tmp_path: Path) -> None:
    write_stream(tmp_path / "a", frozenset({"parquet"}))
    history = read_history(tmp_path / "a")
    assert history is not None
    assert overlay_strip(tmp_path / "a", history, 6) == []
    (tmp_path / "a/overlay.mp4").write_bytes(b"no video")
    assert overlay_strip(tmp_path / "a", history, 6) == []


def test_the_timeline_has_a_bar_for_each_time_an_object_is_seen(run_folder: Path) -> None:
    history = read_history(run_folder / "yard")
    assert history is not None
    svg = timeline_chart(history, history.lives)
    titles = re.findall(r"<title>(.*?)</title>", svg)
    assert titles == [
        "quarantined: frames 10 to 10",
        "object 3: frames 0 to 39, 0.00 s to 3.90 s",
        "object 5: frames 0 to 19, 0.00 s to 1.90 s",
        "object 5: frames 25 to 39, 2.50 s to 3.90 s",
    ]


def test_the_timeline_shows_when_an_object_rests_and_the_table_its_last_state(tmp_path: Path) -> None:
    record = StreamRecord(tmp_path / "a", "a", frozenset({"parquet"}))
    for index in range(20):
        if index == 12:
            record.gap(index, index / 10, "quarantined")  # ends no rest
            continue
        made = segmentation(index, 3, 5) if index < 16 else segmentation(index, 3)
        resting = {3: 4 <= index < 8, 5: index >= 10}
        layers = tuple(
            replace(one, state="resting" if resting[one.layer] else "moving") for one in made.layers
        )
        record.write(replace(made, layers=layers), frame(index))
    write_run(tmp_path, [StreamState("a", "done", read=20, committed=record.close(whole=True))])
    history = read_history(tmp_path / "a")
    assert history is not None
    titles = re.findall(r"<title>(object \d rests.*?)</title>", timeline_chart(history, history.lives))
    assert titles == ["object 3 rests: frames 4 to 7", "object 5 rests: frames 10 to 15"]
    rows = re.findall(r"</span>(\d)</th>.*?<td>(moving|resting)</td>", render_report(tmp_path), re.DOTALL)
    assert rows == [("3", "moving"), ("5", "resting")]


def test_what_became_of_an_object_is_told_by_what_is_in_its_place(tmp_path: Path) -> None:
    boxes = [  # object → its box (x, y, side) in each of four frames, from the left
        {1: (0, 20, 8), 2: (20, 5, 10), 4: (30, 20, 8), 6: (40, 2, 5)},
        {1: (0, 20, 8), 2: (20, 5, 10), 4: (30, 20, 8), 6: (40, 2, 5)},
        {5: (21, 5, 10), 6: (40, 2, 5), 7: (10, 20, 8)},
        {6: (40, 2, 5), 7: (10, 20, 8)},
    ]
    record = StreamRecord(tmp_path / "a", "a", frozenset({"parquet"}))
    for index, there in enumerate([*boxes, {8: (3, 3, 9)}]):
        record.write(*framed(index, there, larger=index == 4))
    record.close(whole=True)
    history = read_history(tmp_path / "a")
    assert history is not None
    assert {life.layer: life.ending.words for life in history.lives} == {
        1: "left the picture",
        2: "another object in its place",
        4: "no longer found",
        5: "no longer found",
        6: "size of the picture changed",
        7: "size of the picture changed",
        8: "in the last frame",
    }
    svg = timeline_chart(history, history.lives)
    assert [svg.count(sign) for sign in ("→5<", "⇥<", "×<")] == [1, 1, 4]


def test_charts_have_an_axis_in_frames_and_one_in_seconds(tmp_path: Path) -> None:
    record = StreamRecord(tmp_path / "a", "a", frozenset({"parquet"}))
    for index in range(40):  # ten frames a second, then only two
        record.write(
            segmentation(index), replace(frame(index), pts=min(index / 10, 2) + max(index - 20, 0) / 2)
        )
    record.close(whole=True)
    history = read_history(tmp_path / "a")
    assert history is not None
    for svg in (timeline_chart(history, history.lives), object_count_chart(history)):
        texts = re.findall(r'<text x="([^"]*)" y="([^"]*)" class="[^"]*">([^<]*)</text>', svg)
        row = {text: y for _, y, text in texts if text in ("frame", "s")}
        frames, seconds = (
            {text: float(x) for x, y, text in texts if y == row[unit] and text != unit}
            for unit in ("frame", "s")
        )
        assert list(frames) == ["0", "5", "10", "15", "20", "25", "30", "35"]
        assert list(seconds) == ["0", "2", "4", "6", "8", "10"]
        assert (seconds["0"], seconds["2"]) == (frames["0"], frames["20"])
        assert seconds["4"] == pytest.approx(0.6 * frames["20"] + 0.4 * frames["30"], abs=0.2)


def test_objects_are_those_of_the_label_maps_and_the_long_ones_are_counted(tmp_path: Path) -> None:
    record = StreamRecord(tmp_path / "a", "a", EVERYTHING)
    for index in range(40):
        limbs = (20 + index,) if index % 8 == 0 else ()
        record.write(segmentation(index, *([3] if index < 11 else [5]), *limbs), frame(index))
    committed = record.close(whole=True)
    write_run(tmp_path, [StreamState("a", "done", read=40, committed=committed, layers=9)])
    page = render_report(tmp_path)
    assert "7 objects, 2 of them seen for 1 s or longer" in page
    assert re.search(r'class="n">7</td>\s*<td class="n">2</td>', page)
    assert 'href="a/objects.csv"' in page
    rows = re.findall(r'<th scope="row"><span[^>]*></span>(\d+)</th>(.*?)</tr>', page, re.DOTALL)
    cells = {int(layer): re.findall(r"<td[^>]*>([^<]*)</td>", row) for layer, row in rows}
    assert cells[3] == [
        "object",
        "0.00",
        "1.00",
        "1.00",
        "0",
        "10",
        "11",
        "0",
        "80",
        "0.50",
        "fair",
        "moving",
        "5 in its place",
    ]
    assert cells[5][1:6] == ["1.10", "3.90", "2.80", "11", "39"]
    assert cells[20][3] == "0.00"


def test_a_gap_is_told_by_its_time(tmp_path: Path) -> None:
    record = StreamRecord(tmp_path / "gate", "gate", frozenset({"parquet"}))
    for index in (0, 1, 2, 9):
        record.write(segmentation(index), frame(index))
        if index == 2:
            record.gap(3, 0.3, "gap")
    committed = record.close(whole=True)
    history = read_history(tmp_path / "gate")
    assert history is not None
    assert history.gaps == ((0.3, 0.9),)
    write_run(tmp_path, [StreamState("gate", "done", read=4, committed=committed, gaps=1)])
    assert "No picture from 0.3 s to 0.9 s." in render_report(tmp_path)


def framed(
    index: int, boxes: dict[int, tuple[int, int, int]], *, larger: bool
) -> tuple[Segmentation, SourceFrame]:
    """A frame and its label map with these square objects."""
    scale = 2 if larger else 1
    labels = np.zeros((HEIGHT * scale, WIDTH * scale), np.uint16)
    summaries = []
    for layer, (x, y, side) in boxes.items():
        labels[y : y + side, x : x + side] = layer
        summaries.append(
            replace(segmentation(0).layers[0], layer=layer, region=Region(x, y, side, side), area=side * side)
        )
    return replace(segmentation(index), labels=labels, layers=tuple(summaries)), frame(index)


# The page


def test_the_report_names_every_stream_its_state_and_faults_and_trusts_no_name(run_folder: Path) -> None:
    page = render_report(run_folder)
    assert "0 of 2 streams complete" in page
    assert "Quarantined: frames 10." in page
    assert "The file &lt;is&gt; gone." in page
    assert "<b>" not in page
    assert 'href="a%3Cb%3E/"' in page
    assert "python -m orchestrator --streams &#39;/a b/list.txt&#39;" in page
    assert "region_margin_px" in page
    assert "hunter2" not in page


def test_the_report_asks_nothing_of_the_network_and_each_id_is_unique(run_folder: Path) -> None:
    tags = Tags(render_report(run_folder))
    assert not tags.of("script", "iframe")
    for attributes in tags.of("img", "link"):
        assert (attributes.get("src") or attributes.get("href") or "").startswith("data:")
    ids = [attributes["id"] for _, attributes in tags.found if "id" in attributes]
    assert len(ids) == len(set(ids))
    targets = {(attributes.get("href") or "")[1:] for attributes in tags.of("a")}
    assert {f"stream-{number}" for number in (1, 2)} <= targets & set(ids)


def test_the_report_can_be_read_without_seeing_it(run_folder: Path) -> None:
    tags = Tags(render_report(run_folder))
    assert tags.of("html")[0]["lang"] == "en"
    assert len(tags.of("img")) == 8
    assert tags.of("img")[0]["alt"] == "Frame 0 with 2 objects outlined: 3, 5"
    assert all(attributes.get("alt") for attributes in tags.of("img"))
    assert all(attributes["role"] == "img" and attributes["aria-label"] for attributes in tags.of("svg"))
    assert all(attributes.get("scope") for attributes in tags.of("th"))
    for attributes in tags.of("div"):  # what scrolls must be reachable by key and have a name
        assert attributes["tabindex"] == "0"
        assert attributes["aria-label"]


def test_the_report_lists_the_events_of_a_stream(run_folder: Path) -> None:
    page = render_report(run_folder)
    table = page.partition('aria-label="Events of yard"')[2].partition("</table>")[0]
    events = [json.loads(line) for line in (run_folder / "yard/events.jsonl").read_text().splitlines()]
    assert table.count("<tr>") == 1 + len(events)
    rows = re.findall(r"</span>(\d+)</td>\n<td>([a-z ]+)</td>", table)
    assert rows == [(str(event["object"]), event["kind"]) for event in events if event["object"] is not None]
    assert 'aria-label="Events of a&lt;b&gt;"' not in page


def test_a_stream_that_could_not_be_opened_has_no_link_to_files(tmp_path: Path) -> None:
    write_run(tmp_path, [StreamState("gone", "failed", error="There is no such file.")])
    page = render_report(tmp_path)
    assert 'href="gone/"' not in page
    assert "nothing to plot: no label map is committed." in page
    assert page.count("0 of 1 stream complete") == 2


def test_the_report_tells_how_often_a_stream_went_back(tmp_path: Path) -> None:
    states = [StreamState(name, "done", returns=returns) for returns, name in enumerate("abc")]
    write_run(tmp_path, states)
    page = render_report(tmp_path)
    assert page.count("went back to its last snapshot") == 2
    assert "snapshot: 1 time." in page
    assert "snapshot: 2 times." in page


@pytest.mark.parametrize("save", [frozenset({"masks"}), frozenset({"parquet"})])
def test_a_run_without_tables_or_pictures_has_a_report_that_says_so(
    tmp_path: Path, save: frozenset[str]
) -> None:
    write_run(tmp_path, [write_stream(tmp_path / "yard", save)])
    page = render_report(tmp_path)
    assert ("the tables were not saved" in page) == ("parquet" not in save)
    assert ("There are no pictures" in page) == ("parquet" in save)


def test_the_report_of_fifty_streams_stays_small_and_folds_those_that_are_whole(tmp_path: Path) -> None:
    states = [StreamState(f"s{number}", "done") for number in range(49)]
    write_run(tmp_path, [*states, write_stream(tmp_path / "yard")])
    page = render_report(tmp_path)
    unfolded = [tag for tag in Tags(page).of("details") if "open" in tag]
    assert [tag["id"] for tag in unfolded] == ["stream-50"]
    assert len(Tags(page).of("img")) == 3


def test_the_report_can_be_written_anew(run_folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(run_folder)]) == 0
    assert (run_folder / "report.html").read_text() == render_report(run_folder)
    assert main([str(run_folder / "nowhere")]) == 2
    assert "holds no run" in capsys.readouterr().err


def test_the_report_of_a_run_that_goes_on_or_was_killed_says_so(run_folder: Path, tmp_path: Path) -> None:
    for name in ("run.json", "status.json"):
        (tmp_path / name).write_bytes((run_folder / name).read_bytes())
    status = json.loads((tmp_path / "status.json").read_text())
    (tmp_path / "status.json").write_text(json.dumps(status | {"ended": False, "exit_status": None}))
    assert "not ended" in render_report(tmp_path)
    (tmp_path / "status.json").write_text(json.dumps(status | {"ended": True, "exit_status": None}))
    assert "told to end, but not over" in " ".join(render_report(tmp_path).split())


@pytest.mark.long
def test_a_browser_shows_the_report_without_complaint(run_folder: Path, tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    path.write_text(render_report(run_folder))
    page = open_page(path.as_uri())
    assert "0 of 2 streams complete" in page.document
    assert page.console == []
    path.write_text("<script>console.error('seen')</script>")  # so that the silence means something
    assert any("seen" in line for line in open_page(path.as_uri()).console)
