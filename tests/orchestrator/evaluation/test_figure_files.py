"""The files that a researcher takes figures from: CSV frame by frame, and a LaTeX table."""

from __future__ import annotations

import csv
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from mlbs_actors.messages import Array
from orchestrator.evaluation.command import main
from orchestrator.evaluation.figures import COLUMNS
from orchestrator.evaluation.options import evaluation_parser

HEIGHT, WIDTH = 40, 60


def box(value: int, column: int) -> Array:
    labels = np.zeros((HEIGHT, WIDTH), np.uint8)
    labels[10:30, column : column + 20] = value
    return labels


def write(path: Path, labels: Array) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(labels).save(path)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A DAVIS tree without pictures, and a run that finds the dog in one of two frames, the cat_1 in both."""
    for index in range(2):
        for name, found in (("dog", index == 0), ("cat_1", True)):
            write(tmp_path / f"DAVIS/Annotations/480p/{name}/{index:05d}.png", box(255, 10))
            write(tmp_path / f"out/{name}/masks/{index:05d}.png", box(4 if found else 0, 10))
    write(tmp_path / "DAVIS/Annotations/480p/not-in-the-run/00000.png", box(255, 10))
    return tmp_path


def evaluate(folder: Path, *more: str) -> int:
    return main(["--run", f"{folder}/out", "--truth", f"{folder}/DAVIS/Annotations/480p/*", *more])


def test_a_glob_of_truth_scores_the_streams_of_those_names(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert evaluate(folder) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines[:4]] == ["sequence", "cat_1", "dog", "mean"]
    assert lines[3].split()[1:5] == ["75", "75", "75", "75"]


def test_streams_without_truth_are_told(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--run", f"{folder}/out", "--truth", f"{folder}/DAVIS/Annotations/480p/dog"]) == 0
    assert "without --truth: cat_1." in capsys.readouterr().err


def test_truth_that_fits_no_stream_is_refused(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["--run", f"{folder}/out", "--truth", f"{folder}/DAVIS/Annotations/480p/not-in-the-run"])
    assert "name of a stream" in capsys.readouterr().err


def test_csv_has_a_row_for_each_frame(folder: Path) -> None:
    assert evaluate(folder, "--csv", f"{folder}/frames.csv") == 0
    with (folder / "frames.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [(row["sequence"], row["frame"]) for row in rows] == [
        (name, f"{index:05d}") for name in ("cat_1", "dog") for index in range(2)
    ]
    assert [(row["j"], row["f"], row["ids"], row["matches"]) for row in rows[2:]] == [
        ("100.00", "100.00", "4", "1:4"),
        ("0.00", "0.00", "", "1:-"),
    ]


def test_csv_leaves_figures_without_a_meaning_empty(folder: Path) -> None:
    write(folder / "DAVIS/Annotations/480p/dog/00001.png", box(0, 10))
    assert evaluate(folder, "--csv", f"{folder}/frames.csv") == 0
    last = (folder / "frames.csv").read_text().splitlines()[-1]
    assert last == "dog,00001,100.00,100.00,100.00,,,"


def test_latex_is_a_table_of_booktabs(folder: Path) -> None:
    assert evaluate(folder, "--latex", f"{folder}/table.tex", "--columns", "J davis, j,object_f") == 0
    assert (folder / "table.tex").read_text().splitlines() == [
        r"% \usepackage{booktabs}",
        r"\begin{tabular}{lrrr}",
        r"\toprule",
        r"sequence & $\mathcal{J}$ davis & $\mathcal{J}$ & object\_f \\",
        r"\midrule",
        r"cat\_1 & -- & 100.0 & 100.0 \\",
        r"dog & -- & 50.0 & 50.0 \\",
        r"\midrule",
        r"mean & -- & 75.0 & 75.0 \\",
        r"\bottomrule",
        r"\end{tabular}",
    ]


def test_a_column_that_is_not_known_is_refused(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        evaluate(folder, "--latex", f"{folder}/table.tex", "--columns", "jj")
    assert "no column jj" in capsys.readouterr().err


def test_the_help_names_the_columns_as_they_are_asked_for() -> None:
    said = " ".join(evaluation_parser().format_help().split())
    for name in ("recall", "decay"):
        assert f" {name}," not in said
    for name in ("j recall davis", "f decay davis", "j recall davis17", "object_f first ten", "precision"):
        assert name in said
        assert name in COLUMNS


def test_pictures_of_another_size_do_not_prevent_the_score(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for index in range(2):
        picture = folder / f"DAVIS/JPEGImages/480p/dog/{index:05d}.png"
        write(picture, np.full((HEIGHT // 2, WIDTH, 3), 200, np.uint8))  # not of the size of its truth
    assert evaluate(folder, "--sheets", f"{folder}/sheets") == 0
    printed = capsys.readouterr().out
    assert printed.splitlines()[3].split()[1] == "75"
    assert "no contact sheet: the picture dog 00000 is of another size" in printed


def test_sheets_in_a_place_that_is_no_folder_do_not_prevent_the_score(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "a file").touch()
    for name in ("dog", "cat_1"):
        for index in range(2):
            picture = folder / f"DAVIS/JPEGImages/480p/{name}/{index:05d}.png"
            write(picture, np.full((HEIGHT, WIDTH, 3), 200, np.uint8))
    assert evaluate(folder, "--sheets", f"{folder}/a file") == 0
    assert "the folder given with --sheets cannot be made" in capsys.readouterr().out


def test_sheets_without_pictures_do_not_prevent_the_score(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert evaluate(folder, "--sheets", f"{folder}/sheets") == 0
    printed = capsys.readouterr().out
    assert printed.splitlines()[3].split()[1] == "75"
    assert "dog: " in printed
    assert "no contact sheet: there are no pictures" in printed


def test_sheets_show_the_pictures_of_the_runs_own_source(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for index in range(2):
        (folder / "elsewhere").mkdir(exist_ok=True)
        cv2.imwrite(f"{folder}/elsewhere/{index:05d}.png", np.full((HEIGHT, WIDTH, 3), 200, np.uint8))
    (folder / "out/run.json").write_text(f'{{"sources": {{"dog": "{folder}/elsewhere"}}}}')
    assert evaluate(folder, "--sheets", f"{folder}/sheets") == 0
    sheet = cv2.imread(f"{folder}/sheets/dog.png")
    assert sheet is not None
    assert (sheet[4 + 38, 4 + 3] == 200).all()  # a corner of the first picture, where nothing is drawn
    assert "cat_1: the truth" in capsys.readouterr().out
    assert not (folder / "sheets/cat_1.png").exists()
