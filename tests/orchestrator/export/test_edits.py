"""Ids corrected by hand: in every export, in the report, and in what is made of a run."""

from __future__ import annotations

import csv
import json
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from made_run import FRAMES, two_objects, write_pictures, write_run_over
from PIL import Image
from pycocotools import mask as coco_mask

from mlbs_actors.errors import ConfigError
from mlbs_actors.messages import Array
from mlbs_actors.record.edits import NO_EDITS
from mlbs_actors.record.record_tables import read_rows
from mlbs_actors.record.recorded_stream import edits_of, recorded_stream
from orchestrator.export.__main__ import main as export
from orchestrator.make.__main__ import main as make
from orchestrator.report.page import render_report

# pycocotools decodes through an __array__ method that NumPy 2 finds outdated.
pytestmark = pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("finished")
    return write_run_over(folder / "run", {"yard": write_pictures(folder / "yard")})


@pytest.fixture
def run(finished: Path, tmp_path: Path) -> Path:
    """A copy, in which a test may write."""
    return Path(shutil.copytree(finished, tmp_path / "run"))


def corrected(run: Path, lines: str) -> Path:
    (run / "yard/edits.csv").write_text(lines)
    return run


LINES: dict[str, tuple[str, Callable[[Array, int], Array]]] = {
    "merge": ("merge,5,3\n", lambda labels, _: np.where(labels == 5, 3, labels)),
    "drop": ("drop,3\n", lambda labels, _: np.where(labels == 3, 0, labels)),
    "split": ("split,5,20\n", lambda labels, index: np.where((labels == 5) & (index >= 20), 6, labels)),
    "all": (
        "# the second half of 5 is 3 again\nsplit, 5, 20\n\nmerge, 6, 3\ndrop, 5\n",
        lambda labels, index: np.where(labels == 5, 3 if index >= 20 else 0, labels),
    ),
}


@pytest.mark.parametrize("name", LINES)
def test_label_maps_are_those_of_the_corrected_ids(run: Path, name: str) -> None:
    lines, change = LINES[name]
    frames = list(recorded_stream(corrected(run, lines) / "yard"))
    assert len(frames) == FRAMES
    for frame in frames:
        labels = change(two_objects(frame.index).labels, frame.index)
        np.testing.assert_array_equal(frame.labels(), labels)
        assert [one.layer for one in frame.objects] == np.unique(labels[labels > 0]).tolist()
        for one in frame.objects:
            rows, columns = np.nonzero(labels == one.layer)
            assert one.area == len(rows)
            region = one.region
            assert region.slices == (
                slice(rows.min(), rows.max() + 1),
                slice(columns.min(), columns.max() + 1),
            )
            assert one.centroid == pytest.approx((columns.mean(), rows.mean()))
            assert 0.2 <= one.score <= 0.9


def of_csv(path: Path) -> Iterator[tuple[int, int]]:
    for row in csv.DictReader(path.read_text().splitlines()):
        yield int(row["frame"]), int(row["id"])


def of_coco(path: Path) -> Iterator[tuple[int, int]]:
    content = json.loads(path.read_text())
    frames = {image["id"]: image["frame_id"] for image in content["images"]}
    for one in content["annotations"]:
        assert coco_mask.area(one["segmentation"]) == one["area"]
        yield frames[one["image_id"]], one["track_id"]


def of_mot(path: Path) -> Iterator[tuple[int, int]]:
    for line in (path / "yard.txt").read_text().splitlines():
        yield int(line.split(",")[0]) - 1, int(line.split(",")[1])


def of_mots(path: Path) -> Iterator[tuple[int, int]]:
    for line in (path / "yard.txt").read_text().splitlines():
        yield int(line.split()[0]), int(line.split()[1]) - 1000


def of_masks(path: Path) -> Iterator[tuple[int, int]]:
    for mask in sorted(path.rglob("*.png")):
        with Image.open(mask) as image:
            ids = np.unique(np.asarray(image))
        yield from ((int(mask.stem.removeprefix("img")), layer) for layer in ids[ids > 0].tolist())


READERS = {
    "csv": of_csv,
    "coco": of_coco,
    "mot": of_mot,
    "mots": of_mots,
    "davis": of_masks,
    "youtube-vos": of_masks,
}


@pytest.mark.parametrize("name", READERS)
def test_an_export_has_the_corrected_ids(run: Path, tmp_path: Path, name: str) -> None:
    corrected(run, "split,5,20\nmerge,6,3\n")
    assert export([name, str(run), str(tmp_path / "out")]) == 0
    found = set(READERS[name](tmp_path / "out"))
    assert found == {(index, 3) for index in range(FRAMES)} | {(index, 5) for index in range(20)}


def test_the_overlay_is_drawn_with_the_corrected_ids(run: Path, tmp_path: Path) -> None:
    assert export(["overlay", str(run), str(tmp_path / "plain")]) == 0
    corrected(run, "drop,5\n")
    assert export(["overlay", str(run), str(tmp_path / "out")]) == 0
    assert (tmp_path / "plain/yard.mp4").read_bytes() != (tmp_path / "out/yard.mp4").read_bytes()


def test_what_is_made_has_the_corrected_ids_or_those_of_another_file(run: Path, tmp_path: Path) -> None:
    corrected(run, "drop,3\n")
    assert make(["cutout", str(run), "--format", "png"]) == 0
    with Image.open(run / "yard/made/cutout/img000.png") as image:
        np.testing.assert_array_equal(np.asarray(image)[..., 3] > 0, two_objects(0).labels == 5)
    (tmp_path / "other.csv").write_text("drop,5\n")
    other = ["--replace", "--edits", str(tmp_path / "other.csv")]
    assert make(["cutout", str(run), "--format", "png", *other]) == 0
    with Image.open(run / "yard/made/cutout/img000.png") as image:
        np.testing.assert_array_equal(np.asarray(image)[..., 3] > 0, two_objects(0).labels == 3)


def test_the_report_has_the_corrected_ids_and_says_so(run: Path) -> None:
    assert "object 6: frames" not in render_report(run)
    page = render_report(corrected(run, "split,5,20\ndrop,3\n"))
    assert "object 5: frames 0 to 19" in page
    assert "object 6: frames 20 to 39" in page
    assert "object 3: frames" not in page
    assert "Objects have the ids of edits.csv, with 2 corrections" in page


def test_a_report_with_wrong_corrections_is_written_without_them_and_tells_the_line(run: Path) -> None:
    page = render_report(corrected(run, "drop,5\ndrop,9\n"))
    assert "edits.csv, line 2: there is no object 9" in page
    assert "object 5: frames 0 to 39" in page


def test_the_record_stays_as_it_is(run: Path) -> None:
    before = list(read_rows(run / "yard"))
    with Image.open(run / "yard/masks/img000.png") as image:
        mask = np.asarray(image)
    corrected(run, "merge,5,3\n")
    assert make(["blur", str(run)]) == 0
    assert list(read_rows(run / "yard")) == before
    with Image.open(run / "yard/masks/img000.png") as image:
        np.testing.assert_array_equal(np.asarray(image), mask)
    assert [frame.labels().max() for frame in recorded_stream(run / "yard", NO_EDITS)] == [5] * FRAMES


def test_ids_of_splits_do_not_change_when_lines_are_added(run: Path) -> None:
    corrected(run, "split,5,20\n")
    (first,) = edits_of(run / "yard").edits
    corrected(run, "split,5,20\nsplit,3,10\ndrop,5\nsplit,6,30\n")
    edits = edits_of(run / "yard").edits
    assert edits[0] == first
    assert [edit.new for edit in edits] == [6, 7, None, 8]


@pytest.mark.parametrize(
    ("lines", "told"),
    [
        ("drop,9\n", "line 1: there is no object 9 in the record"),
        ("drop,3\nmerge,3,5\n", "line 2: object 3 was dropped above"),
        ("merge,3,5\ndrop,3\n", "line 2: object 3 was merged into 5 above"),
        ("merge,3,3\n", "line 1: object 3 cannot be merged into itself"),
        ("merge,3\n", "line 1: 'merge,3' is no correction; write merge,A,B"),
        ("# a remark\n\njoin,3,5\n", "line 3: 'join,3,5' is no correction; write merge,A,B, drop,C or split"),
        ("drop,three\n", "line 1: 'three' is no object's id"),
        ("split,5,-3\n", "line 1: '-3' is no frame"),
        ("split,5,40\n", "line 1: object 5 is seen in frames 0 to 39, and cannot be split at 40"),
        ("split,5,0\n", "and cannot be split at 0"),
        ("split,5,20\nsplit,5,30\n", "line 2: object 5 is seen in frames 0 to 19"),
    ],
)
def test_faults_are_told_with_their_line(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], lines: str, told: str
) -> None:
    corrected(run, lines)
    with pytest.raises(ConfigError, match=r"edits\.csv, line"):
        edits_of(run / "yard")
    assert export(["csv", str(run), str(tmp_path / "out.csv")]) == 2
    assert told in capsys.readouterr().err
    assert not (tmp_path / "out.csv").exists()
    assert make(["blur", str(run)]) == 2
    assert told in capsys.readouterr().err


def test_another_file_of_corrections_that_is_not_there_is_told(
    run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert make(["blur", str(run), "--edits", str(run / "none.csv")]) == 2
    assert "none.csv cannot be read" in capsys.readouterr().err
