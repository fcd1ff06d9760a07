"""The background plate and the cut-outs: what they show, and that what nobody knows is marked."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from labelled_clip import LabelledClip
from record_fakes import HEIGHT, WIDTH, frame, segmentation

from mlbs_actors.messages import Array, LayerAppearance, Region
from mlbs_actors.scenes.synthetic import SyntheticScene
from orchestrator.sinks.background import background_plate
from orchestrator.sinks.cutouts import cutouts
from orchestrator.sinks.record import StreamRecord, ends_group


def appearance(known: Array, colour: int = 50) -> LayerAppearance:
    height, width = known.shape
    return LayerAppearance(
        0, 7, Region(0, 0, width, height), np.full((*known.shape, 3), colour, np.uint8), known
    )


def test_a_plate_takes_the_remembered_colours_then_the_frame_s_own_then_the_nearest() -> None:
    image = np.full((4, 6, 3), 200, np.uint8)
    labels = np.zeros((4, 6), np.uint16)
    labels[:, 2:] = 3  # an object hides the right
    remembered = np.zeros((4, 6), bool)
    remembered[:, 0] = remembered[:, 4:] = True
    plate = background_plate(appearance(remembered), image, labels)
    assert plate[1].tolist() == [
        [50, 50, 50, 255],
        [200, 200, 200, 255],
        [200, 200, 200, 0],
        [50, 50, 50, 0],
        [50, 50, 50, 255],
        [50, 50, 50, 255],
    ]
    assert (image == 200).all()


def test_away_from_objects_a_plate_is_the_frame_itself() -> None:
    image = np.random.default_rng(0).integers(0, 256, (40, 40, 3)).astype(np.uint8)
    labels = np.zeros((40, 40), np.uint16)
    labels[30:, 30:] = 3
    plate = background_plate(appearance(np.ones((40, 40), bool)), image, labels)
    np.testing.assert_array_equal(plate[:22, :, :3], image[:22])
    assert (plate[22:, 22:, :3] == 50).all()
    assert (plate[:, :, 3] == 255).all()


def test_a_frame_of_which_nothing_is_known_is_transparent() -> None:
    labels = np.full((4, 6), 2, np.uint16)
    plate = background_plate(appearance(np.zeros((4, 6), bool)), np.full((4, 6, 3), 9, np.uint8), labels)
    assert (plate[:, :, 3] == 0).all()


def test_each_object_is_cut_out_along_its_box() -> None:
    image = np.random.default_rng(0).integers(0, 256, (HEIGHT, WIDTH, 3)).astype(np.uint8)
    result = segmentation(4, 3, 9)
    result.labels[5:8, 4:6] = 0  # a bite out of the first one
    found = dict(cutouts(result, image))
    assert list(found) == [3, 9]
    assert found[3].shape == (10, 8, 4)
    np.testing.assert_array_equal(found[3][:, :, :3], image[5:15, 4:12])
    np.testing.assert_array_equal(found[3][:, :, 3] == 255, result.labels[5:15, 4:12] == 3)
    assert set(np.unique(found[3][:, :, 3])) == {0, 255}


def test_plates_and_cutouts_are_written_with_the_commits(tmp_path: Path) -> None:
    record = StreamRecord(tmp_path / "yard", "yard", frozenset({"background", "cutouts"}))
    known = np.zeros((HEIGHT, WIDTH), bool)
    for index in range(9):
        record.write(segmentation(index, 3), frame(index), appearance(known) if ends_group(index) else None)
        written = [path.name for path in (tmp_path / "yard").rglob("*.png") if not path.name.startswith(".")]
        assert len(written) == (9 if index >= 7 else 0)  # eight cut-outs and a plate
    record.close(whole=True)
    plate = cv2.imread(str(tmp_path / "yard/background/img007.png"), cv2.IMREAD_UNCHANGED)
    assert plate is not None
    assert plate.shape == (HEIGHT, WIDTH, 4)
    assert (tmp_path / "yard/cutouts/img008-3.png").exists()


def test_the_plate_of_a_scene_shows_it_without_its_objects(clip: LabelledClip) -> None:
    made, last, labels = clip.scene, clip.frames[-1], clip.results[-1].labels
    index = len(clip.frames) - 1
    assert clip.background.frame_index == index
    plate = background_plate(clip.background, last, labels)
    surfaces = tuple(surface for surface in made.surfaces if surface.label == 0)
    height, width = labels.shape
    empty = SyntheticScene(made.name, len(clip.frames), 0, width, height, surfaces, 0.0)
    truth = empty.frame(index).astype(int)
    known = plate[:, :, 3] == 255
    assert known.mean() > 0.9
    difference = np.abs(plate[:, :, :3].astype(int) - truth).mean(axis=2)
    assert difference[known].mean() < 8
    hidden = known & (made.labels(index) > 0) & (labels > 0)
    assert hidden.sum() > 100  # what the objects hide now was seen before
    shown = np.abs(last.astype(int) - truth).mean(axis=2)
    assert difference[hidden].mean() < 0.6 * shown[hidden].mean()
