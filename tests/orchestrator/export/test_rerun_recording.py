"""The export to rerun, read back by rerun's own reader."""

from __future__ import annotations

import builtins
from pathlib import Path
from types import ModuleType
from typing import Any

import cv2
import numpy as np
import pytest
from PIL import Image
from record_fakes import HEIGHT, WIDTH, write_stream

from mlbs_actors.config import Config
from mlbs_actors.messages import Array
from mlbs_actors.pictures.layer_colours import layer_colour
from mlbs_actors.scenes.synthetic import scene
from orchestrator.export.__main__ import main
from orchestrator.options import recorded
from orchestrator.run.listed_stream import ListedStream
from orchestrator.run.run_description import describe_run
from orchestrator.run.run_folder import RunFolder
from orchestrator.sources.address import parse_address

# pycocotools decodes through an __array__ method that NumPy 2 finds outdated.
pytestmark = pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")

SAVED = frozenset({"masks", "parquet"})
SOURCES = {
    "yard 2": f"synthetic:demo?frames=40&width={WIDTH}&height={HEIGHT}",
    "gate": "rtsp://bob:hunter2@cam/x",
    "moved": "/nowhere/film.mp4",
}


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("run")
    for name in SOURCES:
        write_stream(folder / name, SAVED)
    streams = [
        ListedStream(name, parse_address(source, folder), line)
        for line, (name, source) in enumerate(SOURCES.items(), start=1)
    ]
    RunFolder(folder).create(describe_run(streams, Config(), recorded({"save": SAVED})))
    return folder


@pytest.fixture(scope="module")
def tables(run: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[dict[str, Any]]]:
    """Entity → its rows, as rerun's reader finds them."""
    chunk = pytest.importorskip("rerun.chunk", reason="rerun is not installed, see CONTRIBUTING.md")
    out = tmp_path_factory.mktemp("export") / "run.rrd"
    assert main(["rerun", str(run), str(out)]) == 0
    rows: dict[str, list[dict[str, Any]]] = {}
    for one in chunk.RrdReader(out).stream():
        rows.setdefault(one.entity_path, []).extend(one.to_record_batch().to_pylist())
    return rows


def by_frame(rows: list[dict[str, Any]]) -> dict[int, dict[str, Any]]:
    return {row["frame"]: row for row in rows}


def test_every_label_map_is_given_back_with_its_frame_and_time(
    run: Path, tables: dict[str, list[dict[str, Any]]]
) -> None:
    for entity, name in (("/yard\\ 2/labels", "yard 2"), ("/gate/labels", "gate")):
        found = by_frame(tables[entity])
        assert list(found) == [index for index in range(40) if index != 10]
        for index, row in found.items():
            labels = np.array(row["SegmentationImage:buffer"][0], np.uint8).view(np.uint16)
            saved: Array = np.asarray(Image.open(run / name / f"masks/img{index:03d}.png"))
            np.testing.assert_array_equal(labels.reshape(HEIGHT, WIDTH), saved)
            assert row["time"].total_seconds() == pytest.approx(index / 10)


def test_each_object_has_its_box_motion_and_area_and_is_cleared_while_it_is_hidden(
    tables: dict[str, list[dict[str, Any]]],
) -> None:
    rows = tables["/gate/layers/5"]
    boxes = by_frame([row for row in rows if row.get("Boxes2D:centers")])
    assert list(boxes) == [index for index in range(40) if index != 10 and not 20 <= index < 25]
    assert (boxes[4]["Boxes2D:centers"], boxes[4]["Boxes2D:half_sizes"]) == ([[8.0, 22.0]], [[4.0, 5.0]])
    assert boxes[4]["Boxes2D:class_ids"] == [5]
    assert [row["frame"] for row in rows if row.get("Clear:is_recursive")] == [20]
    motion = by_frame(tables["/gate/layers/5/motion"])[4]
    assert (motion["Arrows2D:origins"], motion["Arrows2D:vectors"]) == ([[7.5, 21.5]], [[1.0, 0.0]])
    assert by_frame(tables["/gate/layers/5/area"])[4]["Scalars:scalars"] == [80.0]
    assert by_frame(tables["/gate/camera"])[4]["Scalars:scalars"] == [0.5, -0.25]


def test_a_class_has_the_id_and_the_colour_of_its_layer(tables: dict[str, list[dict[str, Any]]]) -> None:
    (row,) = tables["/gate"]
    classes = [one["class_description"]["info"] for one in row["AnnotationContext:context"][0]]
    background = classes.pop(0)
    assert (background["id"], background["color"] & 255) == (0, 0)  # else it would hide the picture
    for one, layer in zip(classes, (3, 5), strict=True):
        blue, green, red = layer_colour(layer)
        assert (one["id"], one["label"]) == (layer, str(layer))
        assert one["color"] == (red << 24 | green << 16 | blue << 8 | 255)


def test_pictures_are_there_where_the_source_can_be_read_again(
    tables: dict[str, list[dict[str, Any]]],
) -> None:
    pictures = by_frame(tables["/yard\\ 2/image"])
    assert len(pictures) == 39
    shown = cv2.imdecode(np.array(pictures[30]["EncodedImage:blob"][0], np.uint8), cv2.IMREAD_COLOR)
    assert shown is not None
    made = scene("demo", frames=40, width=WIDTH, height=HEIGHT).frame(30)
    assert np.abs(shown.astype(int) - made).mean() < 6
    assert "/gate/image" not in tables
    assert "/moved/image" not in tables
    assert "/moved/labels" in tables


def test_without_rerun_the_error_says_what_to_install(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    found = builtins.__import__

    def hidden(name: str, *arguments: Any, **options: Any) -> ModuleType:
        if name.startswith(("rerun", "orchestrator.export.rerun")):
            raise ImportError(name)
        return found(name, *arguments, **options)

    monkeypatch.setattr(builtins, "__import__", hidden)
    assert main(["rerun", str(run), str(tmp_path / "out.rrd")]) == 2
    assert "pip install" in capsys.readouterr().err
    assert not any(tmp_path.iterdir())
