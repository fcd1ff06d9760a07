"""Exports of a record, opened by readers that are not ours, and compared with the label maps."""

from __future__ import annotations

import builtins
import json
import shutil
from pathlib import Path
from types import ModuleType
from typing import Any

import duckdb
import numpy as np
import pyarrow.csv
import pytest
from PIL import Image
from pycocotools import mask as coco_mask
from pycocotools.coco import COCO
from pycocotools.cocoeval import COCOeval
from record_fakes import HEIGHT, WIDTH, frame, segmentation, write_run, write_stream

from mlbs_actors.errors import MlbsError
from mlbs_actors.messages import Array
from orchestrator.export.__main__ import FORMATS, main
from orchestrator.export.command import WRITERS
from orchestrator.run.stream_state import StreamState
from orchestrator.sinks.label_image import davis_palette
from orchestrator.sinks.record import StreamRecord

# pycocotools decodes through an __array__ method that NumPy 2 finds outdated.
pytestmark = pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("run")
    states = [write_stream(folder / "yard"), write_stream(folder / "gate"), StreamState("gone", "failed")]
    write_run(folder, states)
    return folder


def export(name: str, run: Path, out: Path) -> Path:
    assert main([name, str(run), str(out)]) == 0
    return out


def masks(run: Path, stream: str) -> dict[str, Array]:
    """The label maps as they were saved."""
    return {path.stem: np.asarray(Image.open(path)) for path in (run / stream / "masks").iterdir()}


def test_coco_is_read_by_pycocotools_and_gives_back_every_mask(run: Path, tmp_path: Path) -> None:
    coco = COCO(str(export("coco", run, tmp_path / "run.json")))
    assert [video["name"] for video in coco.dataset["videos"]] == ["yard", "gate"]  # one has no label map
    assert len(coco.imgs) == 2 * 39
    for image in coco.imgs.values():
        stream, name = image["file_name"].removesuffix(".png").split("/")
        labels = np.zeros((image["height"], image["width"]), np.uint16)
        for annotation in coco.loadAnns(coco.getAnnIds(imgIds=image["id"])):
            mask = coco.annToMask(annotation).astype(bool)
            assert mask.sum() == annotation["area"]
            x, y, width, height = annotation["bbox"]
            assert mask[y : y + height, x : x + width].sum() == mask.sum()
            labels[mask] = annotation["track_id"]
        np.testing.assert_array_equal(labels, masks(run, stream)[name])
    # What readers of videos go by: the order and time of the frames, and the ids that join them.
    for video in coco.dataset["videos"]:
        assert (video["width"], video["height"], video["length"]) == (WIDTH, HEIGHT, 39)
        assert video["fps"] == pytest.approx(38 / 3.9, abs=1e-4)
        images = [image for image in coco.dataset["images"] if image["video_id"] == video["id"]]
        assert [image["frame_id"] for image in images] == [index for index in range(40) if index != 10]
        assert [image["seconds"] for image in images] == [image["frame_id"] / 10 for image in images]
    tracks = {(one["video_id"], one["track_id"]) for one in coco.dataset["annotations"]}
    assert tracks == {(1, 3), (1, 5), (2, 3), (2, 5)}


@pytest.mark.parametrize(
    ("places", "expected"),
    [
        (["pictures", "rtsp://cam/x"], ["img000.jpg", "gate/img000.png"]),
        (["sites/north", "sites/south/*.jpg"], ["north/img000.jpg", "south/img000.jpg"]),
        (["gone", "other"], ["yard/img000.png", "gate/img000.png"]),
    ],
)
def test_an_image_of_coco_has_the_name_of_the_picture_that_it_is(
    run: Path, tmp_path: Path, places: list[str], expected: list[str]
) -> None:
    for place in places:
        folder = tmp_path / place.removesuffix("/*.jpg")
        if ":" not in place and place != "gone":
            folder.mkdir(parents=True)
            for index in range(40):
                (folder / ("x" * (place == "other") + f"img{index:03d}.jpg")).touch()
    sources = [place if ":" in place else str(tmp_path / place) for place in places]
    description = json.loads((run / "run.json").read_text())
    description["sources"] = dict(zip(("yard", "gate"), sources, strict=True))
    copied = tmp_path / "run"
    copied.mkdir()
    (copied / "run.json").write_text(json.dumps(description))
    for name in description["sources"]:
        (copied / name).symlink_to(run / name)
    dataset = json.loads(export("coco", copied, tmp_path / "run.json").read_text())
    names = {video["id"]: video["name"] for video in dataset["videos"]}
    first = {names[one["video_id"]]: one["file_name"] for one in dataset["images"] if one["frame_id"] == 0}
    assert [first["yard"], first["gate"]] == expected
    assert len({one["file_name"] for one in dataset["images"]}) == len(dataset["images"])
    tracks = {(one["track_id"], one["attributes"]["track_id"]) for one in dataset["annotations"]}
    assert tracks == {(3, 3), (5, 5)}


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_cocoeval_takes_a_coco_export_for_results_of_itself(run: Path, tmp_path: Path) -> None:
    truth = COCO(str(export("coco", run, tmp_path / "run.json")))
    judged = COCOeval(truth, truth.loadRes(truth.dataset["annotations"]), "segm")
    judged.evaluate()
    judged.accumulate()
    judged.summarize()
    assert judged.stats[0] == 1.0


def test_csv_is_one_table_of_every_object_in_every_frame_with_its_time(run: Path, tmp_path: Path) -> None:
    table = pyarrow.csv.read_csv(export("csv", run, tmp_path / "run.csv"))
    of_tables = duckdb.execute(
        "SELECT stream, frame, pts, layer, kind, state, x, y, w, h, area, cx, cy, vx, vy, confidence, score "
        f"FROM '{run}/*/layers-*.parquet' JOIN '{run}/*/frames-*.parquet' USING (stream, frame) "
        "ORDER BY stream = 'gate', frame, layer"
    ).fetchall()
    assert len(of_tables) == 2 * (39 + 34)
    assert [tuple(row.values()) for row in table.to_pylist()] == of_tables
    names = "stream frame seconds id kind state x y w h area cx cy vx vy confidence score"
    assert table.column_names == names.split()


def test_mot_has_a_box_a_line_counted_from_one(run: Path, tmp_path: Path) -> None:
    out = export("mot", run, tmp_path / "mot")
    assert sorted(path.name for path in out.glob("*.txt")) == ["gate.txt", "gone.txt", "yard.txt"]
    lines = np.loadtxt(out / "yard.txt", delimiter=",")
    assert lines.shape == (39 + 34, 10)
    assert lines[:3].tolist() == [
        [1, 3, 1, 6, 8, 10, 0.5, -1, -1, -1],
        [1, 5, 1, 18, 8, 10, 0.5, -1, -1, -1],
        [2, 3, 2, 6, 8, 10, 0.5, -1, -1, -1],
    ]
    saved = masks(run, "yard")
    for index, layer, left, top, width, height in lines[:, :6].astype(int).tolist():
        y, x = np.nonzero(saved[f"img{index - 1:03d}"] == layer)
        assert (x.min() + 1, y.min() + 1, np.ptp(x) + 1, np.ptp(y) + 1) == (left, top, width, height)


def test_lines_of_mots_are_read_by_pycocotools_and_give_back_every_mask(run: Path, tmp_path: Path) -> None:
    out = export("mots", run, tmp_path / "mots")
    assert sorted(path.name for path in out.glob("*.txt")) == ["gate.txt", "gone.txt", "yard.txt"]
    found: dict[str, Array] = {}
    for line in (out / "yard.txt").read_text().splitlines():
        index, number, kind, height, width, code = line.split(" ")
        assert int(number) // 1000 == int(kind) == 1
        mask = coco_mask.decode({"size": [int(height), int(width)], "counts": code.encode()})
        labels = found.setdefault(f"img{int(index):03d}", np.zeros((HEIGHT, WIDTH), np.uint16))
        labels[mask.astype(bool)] = int(number) % 1000
    saved = masks(run, "yard")
    assert found.keys() == saved.keys()
    for name, labels in found.items():
        np.testing.assert_array_equal(labels, saved[name])


@pytest.mark.parametrize(("name", "folder"), [("davis", "Annotations/480p"), ("youtube-vos", "Annotations")])
def test_palette_masks_are_read_by_pillow_and_give_back_every_mask(
    run: Path, tmp_path: Path, name: str, folder: str
) -> None:
    out = export(name, run, tmp_path / name)
    assert sorted(path.name for path in (out / folder).iterdir()) == ["gate", "yard"]
    for stem, labels in masks(run, "yard").items():
        with Image.open(out / folder / "yard" / f"{stem}.png") as image:
            assert image.mode == "P"
            assert image.getpalette() == davis_palette().ravel().tolist()
            np.testing.assert_array_equal(np.asarray(image), labels)
    if name == "davis":
        assert (out / "ImageSets/2017/val.txt").read_text() == "yard\ngate\n"
    else:
        objects = json.loads((out / "meta.json").read_text())["videos"]["yard"]["objects"]
        assert list(objects) == ["3", "5"]
        assert len(objects["5"]["frames"]) == 34


def test_a_davis_export_has_what_the_loader_of_the_benchmark_goes_by(run: Path, tmp_path: Path) -> None:
    # It takes the sequences from a list and the frames by their stems, in the order of the alphabet. Pillow
    # must give a map of indices, all of the size of the first, in which an object is its id and 255 nothing.
    out = export("davis", run, tmp_path / "davis")
    for sequence in (out / "ImageSets/2017/val.txt").read_text().split():
        paths = sorted((out / "Annotations/480p" / sequence).glob("*.png"), key=str)
        assert [path.stem for path in paths] == [f"img{index:03d}" for index in range(40) if index != 10]
        maps = []
        for path in paths:
            with Image.open(path) as image:
                assert (image.format, image.mode) == ("PNG", "P")
                maps.append(np.array(image))
        stack = np.stack(maps)  # fails if sizes differ
        assert stack.dtype == np.uint8
        assert stack.shape == (39, HEIGHT, WIDTH)
        assert stack.max() == 5
        saved = masks(run, sequence)
        for layer in range(1, 6):
            expected = np.stack([saved[path.stem] == layer for path in paths])
            np.testing.assert_array_equal(stack == layer, expected)
            assert expected.any() == (layer in (3, 5))


@pytest.mark.parametrize("name", ["mots", "davis"])
def test_trackeval_reads_every_mask_and_id_and_finds_an_export_equal_to_itself(
    run: Path, tmp_path: Path, name: str
) -> None:
    trackeval = pytest.importorskip("trackeval", reason="TrackEval is not installed, see CONTRIBUTING.md")
    out = export(name, run, tmp_path / name)
    folder = "." if name == "mots" else "Annotations/480p"
    setting = {
        "GT_FOLDER": str(out / folder),
        "GT_LOC_FORMAT": "{gt_folder}/{seq}.txt",
        "TRACKERS_FOLDER": str(tmp_path),
        "TRACKERS_TO_EVAL": [name],
        "TRACKER_SUB_FOLDER": folder,
        "SEQ_INFO": {"yard": 40},
        "PRINT_CONFIG": False,
    }
    dataset = (trackeval.datasets.KittiMOTS if name == "mots" else trackeval.datasets.DAVIS)(setting)
    raw = dataset.get_raw_seq_data(name, "yard")
    saved = masks(run, "yard")
    # DAVIS knows no frame without a mask, MOTS counts the one that could not be decoded.
    indices = [index for index in range(40) if name == "mots" or index != 10]
    for index, ids, codes in zip(indices, raw["tracker_ids"], raw["tracker_dets"], strict=True):
        labels = np.zeros((HEIGHT, WIDTH), np.uint16)
        for number, code in zip(ids, codes, strict=True):
            labels[coco_mask.decode(code).astype(bool)] = number % 1000
        np.testing.assert_array_equal(labels, saved.get(f"img{index:03d}", 0))
    data = dataset.get_preprocessed_seq_data(raw, "car" if name == "mots" else "general")
    assert trackeval.metrics.HOTA({"PRINT_CONFIG": False}).eval_sequence(data)["HOTA"].min() == 1.0


def test_the_help_names_every_format() -> None:
    assert tuple(WRITERS) == FORMATS


@pytest.mark.parametrize("name", sorted(WRITERS.keys() - {"overlay", "rerun"}))
def test_only_what_is_committed_is_exported(run: Path, tmp_path: Path, name: str) -> None:
    for stream in ("yard", "gate"):
        (tmp_path / "run" / stream).mkdir(parents=True)
        for path in (run / stream).glob("*.parquet"):
            (tmp_path / "run" / stream / path.name).write_bytes(path.read_bytes())
    (tmp_path / "run/run.json").write_bytes((run / "run.json").read_bytes())
    first = (run / "yard/commits.jsonl").read_text().splitlines()[0]
    (tmp_path / "run/yard/commits.jsonl").write_text(first + "\n")
    out = export(name, tmp_path / "run", tmp_path / "out")
    if name == "coco":
        frames = len(json.loads(out.read_text())["images"])
    elif name == "csv":
        table = pyarrow.csv.read_csv(out)
        frames = len(set(zip(table["stream"].to_pylist(), table["frame"].to_pylist(), strict=True)))
    elif name == "mot":
        frames = len(np.unique(np.loadtxt(out / "yard.txt", delimiter=",")[:, 0]))
    elif name == "mots":
        frames = len({line.split()[0] for line in (out / "yard.txt").read_text().splitlines()})
    else:
        frames = len(list(out.rglob("*.png")))
    assert frames == 8


@pytest.mark.parametrize(("name", "layer"), [("mots", 1000), ("davis", 255), ("youtube-vos", 255)])
def test_an_id_that_a_format_has_no_place_for_is_refused_and_nothing_is_left(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str, layer: int
) -> None:
    record = StreamRecord(tmp_path / "run/yard", "yard", frozenset({"parquet"}))
    record.write(segmentation(0, layer), frame(0))
    record.close(whole=True)
    write_run(tmp_path / "run", [StreamState("yard", "done")])
    assert main([name, str(tmp_path / "run"), str(tmp_path / "out")]) == 2
    assert f"layer {layer}" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["run"]


@pytest.mark.parametrize("name", ["csv", "mot"])
def test_an_export_is_replaced_only_if_that_is_asked_for(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    out = export(name, run, tmp_path / "out")
    made = out if name == "csv" else out / "yard.txt"
    whole = made.read_bytes()
    made.write_bytes(b"")
    assert main([name, str(run), str(out)]) == 2
    assert "add --replace" in capsys.readouterr().err
    assert made.read_bytes() == b""
    assert main([name, str(run), "--replace", str(out)]) == 0
    assert made.read_bytes() == whole


def test_what_no_export_has_made_is_never_replaced(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mine = tmp_path / "mine"
    mine.mkdir()
    (mine / "notes.txt").write_text("of a user")
    within = tmp_path / "made/run"
    export("mot", run, within.parent)
    shutil.copytree(run, within)
    for form, out in (("csv", mine), ("mot", mine), ("mot", mine / "notes.txt"), ("mot", within.parent)):
        assert main([form, str(within), str(out), "--replace"]) == 2
        assert "stays" in capsys.readouterr().err
    assert main(["csv", str(within), str(within / "run.json"), "--replace"]) == 2
    assert "outside of it" in capsys.readouterr().err
    assert (mine / "notes.txt").read_text() == "of a user"
    assert (within / "run.json").read_bytes() == (run / "run.json").read_bytes()


def test_what_is_there_stays_and_a_folder_without_run_is_refused(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "out").write_text("mine")
    assert main(["coco", str(run), str(tmp_path / "out")]) == 2
    assert (tmp_path / "out").read_text() == "mine"
    assert main(["mots", str(tmp_path), str(tmp_path / "new")]) == 2
    assert "holds no run" in capsys.readouterr().err


def test_duckdb_reads_the_tables(run: Path) -> None:
    query = (
        f"SELECT stream, layer, count(*), max(area) FROM '{run}/*/layers-*.parquet' GROUP BY ALL ORDER BY ALL"
    )
    assert duckdb.execute(query).fetchall() == [
        ("gate", 3, 39, 80),
        ("gate", 5, 34, 80),
        ("yard", 3, 39, 80),
        ("yard", 5, 34, 80),
    ]
    query = f"SELECT frame, name FROM '{run}/yard/frames-*.parquet' WHERE status != 'ok' OR frame = 9"
    assert duckdb.execute(f"{query} ORDER BY frame").fetchall() == [(9, "img009"), (10, None)]


def test_a_segmentation_becomes_detections_of_supervision() -> None:
    pytest.importorskip("supervision", reason="with Python 3.10 it would replace OpenCV")
    result = segmentation(4, 3, 9)
    detections = result.to_supervision()
    assert detections.tracker_id is not None
    assert detections.mask is not None
    assert detections.tracker_id.tolist() == [3, 9]
    assert detections.confidence is not None
    assert detections.confidence.tolist() == [0.5, 0.5]
    np.testing.assert_array_equal(detections.mask, [result.labels == 3, result.labels == 9])
    assert detections.xyxy.tolist() == [[4, 5, 12, 15], [4, 17, 12, 27]]
    assert detections.area.tolist() == [80, 80]
    empty = segmentation(0)
    none = type(empty)(0, empty.labels * 0, empty.normaliser, empty.fallback, (), (0.0, 0.0), 0)
    assert len(none.to_supervision()) == 0


def test_without_supervision_the_error_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    found = builtins.__import__

    def hidden(name: str, *arguments: Any, **options: Any) -> ModuleType:
        if name == "supervision":
            raise ImportError(name)
        return found(name, *arguments, **options)

    monkeypatch.setattr(builtins, "__import__", hidden)
    with pytest.raises(MlbsError, match="pip install"):
        segmentation(0).to_supervision()
