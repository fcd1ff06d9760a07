"""The trees of public data sets, read as they come."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from mlbs_actors.errors import ConfigError, SourceError
from mlbs_actors.messages import Array
from orchestrator.evaluation.datasets import find_sequences, open_sequence

HEIGHT, WIDTH = 6, 8


def write(path: Path, pixels: Array) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(pixels).save(path)


def picture(path: Path, grey: int = 90) -> None:
    write(path, np.full((HEIGHT, WIDTH, 3), grey, np.uint8))


def truth_of(value: int) -> Array:
    truth = np.zeros((HEIGHT, WIDTH), np.uint8)
    truth[2:4, 1:5] = value
    return truth


def test_a_davis_tree_has_a_folder_for_the_resolution(tmp_path: Path) -> None:
    for name, value in (("dog", 255), ("goat", 255)):
        for index in range(2):
            picture(tmp_path / f"DAVIS/JPEGImages/480p/{name}/{index:05d}.jpg")
            write(tmp_path / f"DAVIS/Annotations/480p/{name}/{index:05d}.png", truth_of(value))
    picture(tmp_path / "DAVIS/JPEGImages/480p/test-set-has-no-truth/00000.jpg")
    assert find_sequences(tmp_path) == ["DAVIS/480p/dog", "DAVIS/480p/goat"]
    assert find_sequences(tmp_path / "DAVIS/Annotations/480p") == ["dog", "goat"]
    sequence = open_sequence("480p/dog", tmp_path / "DAVIS")
    assert sequence.stems == ("00000", "00001")
    assert open_sequence("480p/dog", str(tmp_path / "DAVIS")).stems == sequence.stems
    np.testing.assert_array_equal(sequence.truth(0), truth_of(1))
    assert sequence.frame(0).shape == (HEIGHT, WIDTH, 3)


def test_the_truth_of_the_unsupervised_task_has_a_name_of_its_own(tmp_path: Path) -> None:
    picture(tmp_path / "JPEGImages/480p/dog/00000.jpg")
    write(tmp_path / "Annotations/480p/dog/00000.png", truth_of(1))
    write(tmp_path / "Annotations_unsupervised/480p/dog/00000.png", truth_of(2))
    names = ["480p/dog", "Annotations_unsupervised/480p/dog"]
    assert find_sequences(tmp_path) == names
    truths = [open_sequence(name, tmp_path).truth(0) for name in names]
    assert [int(truth.max()) for truth in truths if truth is not None] == [1, 2]


def test_a_youtube_vos_tree_has_truth_for_some_frames(tmp_path: Path) -> None:
    for index in range(0, 11):
        picture(tmp_path / f"train/JPEGImages/003234408d/{index:05d}.jpg")
        if index % 5 == 0:
            write(tmp_path / f"train/Annotations/003234408d/{index:05d}.png", truth_of(3))
    (name,) = find_sequences(tmp_path)
    assert name == "train/003234408d"
    sequence = open_sequence(name, tmp_path)
    assert [index for index in range(11) if sequence.has_truth(index)] == [0, 5, 10]


def test_grey_written_as_colours_is_a_label_map(tmp_path: Path) -> None:
    picture(tmp_path / "JPEGImages/480p/bear/00077.jpg")
    grey = truth_of(255)
    opaque = np.full_like(grey, 255)
    write(tmp_path / "Annotations/480p/bear/00077.png", np.dstack([grey, grey, grey, opaque]))
    np.testing.assert_array_equal(open_sequence("480p/bear", tmp_path).truth(0), truth_of(1))


DEFINITION = """\
Ground truth definition file; do not change!

Total number of regions:
{count}
{regions}
Confusion penality matrix:
0 1
1 0

Total number of frames in this shot:
4
Total number of labeled frames for this shot:
2
{frames}"""


def write_definition(
    path: Path, regions: list[int], frames: list[tuple[int, str, str]], end: str = "\n"
) -> None:
    text = DEFINITION.format(
        count=len(regions),
        regions="".join(f"Scale of region {place}:\n{value}\n" for place, value in enumerate(regions)),
        frames="".join(
            f"Frame number:\n{number}\nFile name:\n{truth}\nInput file name:\n{shown}\n"
            for number, truth, shown in frames
        ),
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(text.replace("\n", end).encode())


@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_bms_has_grey_truth_beside_the_pictures_with_black_for_the_background(
    tmp_path: Path, end: str
) -> None:
    for index in range(1, 5):
        picture(tmp_path / f"cars1/cars1_{index:02d}.ppm")
    for index in (1, 4):
        write(tmp_path / f"cars1/cars1_{index:02d}.pgm", truth_of(170))
    frames = [(0, "cars1_01.pgm", "cars1_01.ppm"), (3, "cars1_04.pgm", "cars1_04.ppm")]
    write_definition(tmp_path / "cars1/cars1Def.dat", [85, 0, 170], frames, end)
    assert find_sequences(tmp_path) == ["cars1"]
    sequence = open_sequence("cars1", tmp_path)
    assert sequence.stems == ("cars1_01", "cars1_02", "cars1_03", "cars1_04")
    assert [sequence.has_truth(index) for index in range(4)] == [True, False, False, True]
    np.testing.assert_array_equal(sequence.truth(3), truth_of(2))  # the second region that is no background
    assert "background" in (sequence.remark or "")


def test_fbms_has_coloured_truth_in_a_folder_with_white_for_the_background(tmp_path: Path) -> None:
    folder = tmp_path / "Testset/horses01"
    for index in range(1, 5):
        picture(folder / f"horses01_{index:04d}.jpg")
    # Red, an odd colour that no region has, and the picture of how sure it is.
    colours = np.full((HEIGHT, WIDTH, 3), 255, np.uint8)
    colours[2:4, 1:5] = (255, 0, 0)
    colours[5, 7] = (1, 2, 3)
    write(folder / "GroundTruth/horses01_0002_gt.ppm", colours)
    write(folder / "GroundTruth/PROB_horses01_0002_gt.pgm", truth_of(9))
    # Pictures are stored as JPEG, but defined as PPM.
    write_definition(
        folder / "GroundTruth/horses01Def.dat",
        [256**3 - 1, 255 * 256**2],
        [(1, "horses01_0002_gt.ppm", "horses01_0002.ppm")],
    )
    assert find_sequences(tmp_path) == ["Testset/horses01"]
    sequence = open_sequence("Testset/horses01", tmp_path)
    expected = truth_of(1)
    expected[5, 7] = 255
    np.testing.assert_array_equal(sequence.truth(1), expected)
    assert len(sequence.stems) == 4


def test_truth_is_matched_by_number_if_the_definition_names_other_pictures(tmp_path: Path) -> None:
    for index in range(1, 4):
        picture(tmp_path / f"cars1/frame_{index:02d}.jpg")
    write(tmp_path / "cars1/cars1_03.pgm", truth_of(85))
    write_definition(tmp_path / "cars1/cars1Def.dat", [0, 85], [(2, "cars1_03.pgm", "cars1_03.ppm")])
    sequence = open_sequence("cars1", tmp_path)
    assert [sequence.has_truth(index) for index in range(3)] == [False, False, True]


def test_a_definition_without_its_truth_is_refused(tmp_path: Path) -> None:
    picture(tmp_path / "cars1/cars1_01.jpg")
    write_definition(tmp_path / "cars1/cars1Def.dat", [0, 85], [(0, "cars1_01.pgm", "cars1_01.jpg")])
    with pytest.raises(SourceError, match=r"cars1_01\.pgm"):
        open_sequence("cars1", tmp_path)


@pytest.mark.parametrize(
    ("old", "new"), [("Frame number:\n0", "Frame number:\nzero"), ("Input file", "Other file")]
)
def test_a_definition_of_another_form_is_refused(tmp_path: Path, old: str, new: str) -> None:
    picture(tmp_path / "cars1/cars1_01.jpg")
    definition = tmp_path / "cars1/cars1Def.dat"
    write_definition(definition, [0, 85], [(0, "cars1_01.pgm", "cars1_01.jpg")])
    definition.write_text(definition.read_text().replace(old, new))
    with pytest.raises(SourceError, match=r"cars1Def\.dat is no definition"):
        open_sequence("cars1", tmp_path)


def test_a_sequence_that_is_not_there_is_told_with_those_that_are(tmp_path: Path) -> None:
    picture(tmp_path / "JPEGImages/480p/dog/00000.jpg")
    write(tmp_path / "Annotations/480p/dog/00000.png", truth_of(1))
    with pytest.raises(ConfigError, match="480p/dog"):
        open_sequence("dog", tmp_path)


def test_a_picture_that_is_in_no_known_place_makes_no_sequence(tmp_path: Path) -> None:
    picture(tmp_path / "JPEGImages/dog/00000.jpg")
    cv2.imwrite(str(tmp_path / "Annotations.png"), truth_of(1))
    write(tmp_path / "masks/dog/00000.png", truth_of(1))
    assert find_sequences(tmp_path) == []
