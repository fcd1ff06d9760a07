"""``scripts/evaluate --masks``: label maps that anybody wrote, side by side."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from mlbs_actors.errors import ConfigError, SourceError
from mlbs_actors.messages import Array
from orchestrator.evaluation.command import main
from orchestrator.evaluation.mask_folders import MaskFolder, mask_folders
from orchestrator.evaluation.sequences import FolderSequence, read_label_map
from orchestrator.sinks.label_image import davis_palette, voc_colours

HEIGHT, WIDTH, FRAMES = 40, 60, 4


def box(value: int, column: int = 10, width: int = 20) -> Array:
    labels = np.zeros((HEIGHT, WIDTH), np.uint8)
    labels[10:30, column : column + width] = value
    return labels


def write(path: Path, labels: Array) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(labels).save(path)


@pytest.fixture
def data(tmp_path: Path) -> Path:
    """The sequences set/cat and set/dog, whose one object stays where it is."""
    for name in ("cat", "dog"):
        for index in range(FRAMES):
            write(
                tmp_path / f"data/set/{name}/frames/{index:05d}.png", np.full((HEIGHT, WIDTH, 3), 9, np.uint8)
            )
            write(tmp_path / f"data/set/{name}/gt/{index:05d}.png", box(1))
    return tmp_path / "data"


def write_method(folder: Path, dog_width: int, frames: int = FRAMES) -> None:
    """Masks that have the cat, and of the dog this much."""
    for index in range(frames):
        write(folder / f"cat/{index:05d}.png", box(3))
        write(folder / f"dog/{index:05d}.png", box(3, width=dog_width))


def evaluate(data: Path, *more: str) -> int:
    return main(["--data", str(data), *more])


def test_methods_are_laid_side_by_side_with_their_differences_from_the_first(
    data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_method(tmp_path / "ours", 20)
    write_method(tmp_path / "theirs", 10)
    masks = ["--masks", f"{tmp_path}/ours", f"half={tmp_path}/theirs"]
    assert evaluate(data, *masks, "--columns", "j,object_f") == 0
    above, headings, cat, dog, mean, interval, higher, few = capsys.readouterr().out.splitlines()
    assert above.split() == ["ours", "half"]
    assert headings.split() == ["sequence", "j", "object_f", "j", "Δ", "object_f", "Δ"]
    assert cat.split() == ["set/cat", "100.0", "100.0", "100.0", "+0.0", "100.0", "+0.0"]
    assert dog.split() == ["set/dog", "100.0", "100.0", "50.0", "-50.0", "66.7", "-33.3"]
    assert mean.split() == ["mean", "of", "2", "100.0", "100.0", "75.0", "-25.0", "83.3", "-16.7"]
    assert interval.split()[3:6] == ["-50.0", "…", "+0.0"]
    assert higher.split()[2:] == ["0", "of", "2", "0", "of", "2"]
    assert "too narrow" in few
    assert above.index("half") > headings.index("object_f")


@pytest.mark.parametrize("layout", ["{name}/{stem}.png", "{name}/masks/{stem}.png", "set/{name}/{stem}.png"])
def test_masks_are_found_by_the_name_of_the_sequence_or_its_last_part(
    data: Path, tmp_path: Path, layout: str
) -> None:
    sequence = FolderSequence("set/dog", data / "set/dog/gt", data / "set/dog/frames")
    for stem in sequence.stems:
        write(tmp_path / "mine" / layout.format(name="dog", stem=stem), box(7))
    found = MaskFolder("mine", tmp_path / "mine").masks_of(sequence)
    assert found.frames == {0, 1, 2, 3}
    ((index, labels),) = found.label_maps([2])
    assert index == 2
    assert np.array_equal(labels, box(7))


@pytest.mark.parametrize("whole", [True, False])
def test_masks_may_be_arrays_of_a_frame_or_of_all(data: Path, tmp_path: Path, whole: bool) -> None:
    sequence = FolderSequence("set/dog", data / "set/dog/gt", data / "set/dog/frames")
    maps = np.stack([box(index + 300 % 256) for index in range(FRAMES)]).astype(np.int64)
    (tmp_path / "mine/dog").mkdir(parents=True)
    if whole:
        np.save(tmp_path / "mine/dog.npy", maps)
    else:
        for stem, labels in zip(sequence.stems, maps, strict=True):
            np.save(tmp_path / f"mine/dog/{stem}.npy", labels)
    found = MaskFolder("mine", tmp_path / "mine").masks_of(sequence)
    assert all(np.array_equal(labels, maps[index]) for index, labels in found.label_maps(range(FRAMES)))


def test_an_array_of_another_length_or_kind_is_refused(data: Path, tmp_path: Path) -> None:
    sequence = FolderSequence("set/dog", data / "set/dog/gt", data / "set/dog/frames")
    method = MaskFolder("mine", tmp_path)
    np.save(tmp_path / "dog.npy", np.zeros((3, HEIGHT, WIDTH), np.uint8))
    with pytest.raises(SourceError, match=r"holds 3 label maps; the sequence has 4 frames"):
        method.masks_of(sequence)
    np.save(tmp_path / "dog.npy", np.zeros((4, HEIGHT, WIDTH), np.float32))
    with pytest.raises(SourceError, match=r"label maps are \(frames, height, width\) integers"):
        method.masks_of(sequence)


@pytest.mark.parametrize("whole", [True, False])
def test_arrays_that_are_damaged_are_told(data: Path, tmp_path: Path, whole: bool) -> None:
    sequence = FolderSequence("set/dog", data / "set/dog/gt", data / "set/dog/frames")
    method, maps = MaskFolder("mine", tmp_path), np.zeros((FRAMES, HEIGHT, WIDTH), np.uint8)
    path = tmp_path / ("dog.npy" if whole else f"dog/{sequence.stems[0]}.npy")
    path.parent.mkdir(exist_ok=True)
    np.save(path, maps if whole else maps[0])
    array, archive = path.read_bytes(), io.BytesIO()
    np.savez(archive, maps)
    for content in (b"", array[:60], array[:-3], archive.getvalue(), array.replace(b"}", b"(")):
        path.write_bytes(content)
        with pytest.raises(SourceError, match="cannot be read as a label map"):
            list(method.masks_of(sequence).label_maps([0]))


@pytest.mark.parametrize("palette", [davis_palette(), voc_colours()])
def test_the_colours_of_davis_are_read_as_labels(tmp_path: Path, palette: Array) -> None:
    labels = np.arange(22, dtype=np.uint8).reshape(2, 11)
    cv2.imwrite(str(tmp_path / "coloured.png"), palette[labels][..., ::-1])
    assert np.array_equal(read_label_map(tmp_path / "coloured.png"), labels)


def test_a_wrong_layout_is_told_with_the_one_that_is_expected(
    data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write(tmp_path / "mine/some/00000.png", box(1))
    with pytest.raises(SystemExit) as ended:
        evaluate(data, "--masks", f"{tmp_path}/mine")
    assert ended.value.code == 2
    told = capsys.readouterr().err
    assert f"{tmp_path}/mine has some." in told
    assert f"{tmp_path}/mine/cat/00000.png" in told
    assert f"{tmp_path}/mine/cat/masks/00000.png" in told


def test_masks_with_other_names_than_the_frames_are_told(
    data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write(tmp_path / "mine/cat/frame1.png", box(1))
    with pytest.raises(SystemExit):
        evaluate(data, "--masks", f"{tmp_path}/mine")
    assert "mine/cat/frame1.png has not the name of a frame of set/cat" in capsys.readouterr().err


def test_a_method_without_a_sequence_keeps_the_others(
    data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_method(tmp_path / "ours", 20)
    for index in range(FRAMES):
        write(tmp_path / f"theirs/dog/{index:05d}.png", box(3, width=10))
    assert evaluate(data, "--masks", f"{tmp_path}/ours", f"{tmp_path}/theirs", "--columns", "j") == 1
    printed = capsys.readouterr()
    lines = printed.out.splitlines()
    assert lines[2].split() == ["set/cat", "100.0", "-", "-"]
    assert lines[4].split() == ["mean", "of", "1", "100.0", "50.0", "-50.0"]
    assert "theirs, set/cat: There are no masks" in printed.err


def test_only_frames_that_all_methods_have_are_compared(
    data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_method(tmp_path / "ours", 20)
    for index in (2, 3):
        write(tmp_path / f"ours/dog/{index:05d}.png", box(0))
    write_method(tmp_path / "theirs", 20, frames=2)
    assert evaluate(data, "--masks", f"{tmp_path}/ours", f"{tmp_path}/theirs", "--columns", "j") == 1
    printed = capsys.readouterr()
    assert printed.out.splitlines()[3].split() == ["set/dog", "100.0", "100.0", "+0.0"]
    assert "theirs, set/dog: 2 frames with truth have no labels." in printed.err
    assert "ours, set/dog" not in printed.err


def test_folders_of_a_short_name_do_not_serve_two_sequences(
    data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (data / "other").symlink_to(data / "set")
    write_method(tmp_path / "ours", 20)
    with pytest.raises(SystemExit):
        evaluate(data, "--masks", f"{tmp_path}/ours")
    assert "ours/other/cat/00000.png" in capsys.readouterr().err


def test_two_methods_need_two_names(tmp_path: Path) -> None:
    for name in ("a/masks", "b/masks"):
        (tmp_path / name).mkdir(parents=True)
    with pytest.raises(ConfigError, match="METHOD=DIR"):
        mask_folders([f"{tmp_path}/a/masks", f"{tmp_path}/b/masks"])
    named = mask_folders([f"a={tmp_path}/a/masks", f"b={tmp_path}/b/masks"])
    assert [one.name for one in named] == ["a", "b"]
    with pytest.raises(ConfigError, match="no folder"):
        mask_folders([f"{tmp_path}/c"])


def test_the_files_name_the_methods(data: Path, tmp_path: Path) -> None:
    write_method(tmp_path / "our_s", 20)
    write_method(tmp_path / "theirs", 10)
    files = {name: f"{tmp_path}/{name}" for name in ("json", "csv", "summary", "latex")}
    masks = ["--masks", f"{tmp_path}/our_s", f"{tmp_path}/theirs", "--columns", "j"]
    assert (
        evaluate(data, *masks, *(word for name, path in files.items() for word in (f"--{name}", path))) == 0
    )
    record = json.loads(Path(files["json"]).read_text())
    assert record["masks"]["theirs"] == f"{tmp_path}/theirs"
    difference = record["differences"]["theirs"]["j"]
    assert difference["mean"] == pytest.approx(-25)
    assert difference["sequences"] == {"set/cat": 0, "set/dog": pytest.approx(-50)}
    with Path(files["csv"]).open(newline="") as file:
        assert {row["method"] for row in csv.DictReader(file)} == {"our_s", "theirs"}
    with Path(files["summary"]).open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [(row["method"], row["sequence"], row["j"]) for row in rows][-1] == ("theirs", "set/dog", "50.000")
    assert rows[0]["j recall davis17"] == "100.000"
    lines = Path(files["latex"]).read_text().splitlines()
    assert lines[3:6] == [
        r" & \multicolumn{1}{c}{our\_s} & \multicolumn{2}{c}{theirs} \\",
        r"\cmidrule(lr){2-2}\cmidrule(lr){3-4}",
        r"sequence & $\mathcal{J}$ & $\mathcal{J}$ & $\Delta$ \\",
    ]
    assert r"set/dog & 100.0 & 50.0 & $-50.0$ \\" in lines
    assert r"95 \% interval &  &  & $-50.0$ \dots $+0.0$ \\" in lines


def test_masks_take_no_parameters_of_the_engine(
    data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        evaluate(data, "--masks", str(tmp_path), "--lookahead", "2")
    assert "leave --lookahead out" in capsys.readouterr().err
