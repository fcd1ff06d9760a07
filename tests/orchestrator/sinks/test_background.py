"""The background plate and the cut-outs: what they show, and that what nobody knows is marked."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from record_fakes import HEIGHT, WIDTH, frame, segmentation

from mlbs_actors import MultilayerSubtractor
from mlbs_actors.messages import Array, LayerAppearance, Region
from orchestrator.sinks.background import background_plate
from orchestrator.sinks.cutouts import cutouts
from orchestrator.sinks.record import StreamRecord, ends_group
from orchestrator.sources.synthetic import SyntheticScene, scene


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


@pytest.fixture(scope="module")
def watched() -> tuple[SyntheticScene, Array, Array]:
    """A scene, its last label map, and the plate of its last frame."""
    made = scene("demo", frames=24, width=160, height=120)
    subtractor = MultilayerSubtractor()
    results = [result for index in range(24) for result in subtractor.apply(made.frame(index))]
    labels = results[-1].labels
    background = subtractor._layers[0].appearance()
    assert background.frame_index == 23
    return made, labels, background_plate(background, made.frame(23), labels)


def test_the_plate_of_a_scene_shows_it_without_its_objects(
    watched: tuple[SyntheticScene, Array, Array],
) -> None:
    made, labels, plate = watched
    surfaces = tuple(surface for surface in made.surfaces if surface.label == 0)
    truth = SyntheticScene(made.name, 24, 0, 160, 120, surfaces, 0.0).frame(23).astype(int)
    known = plate[:, :, 3] == 255
    assert known.mean() > 0.9
    difference = np.abs(plate[:, :, :3].astype(int) - truth).mean(axis=2)
    assert difference[known].mean() < 8
    hidden = known & (made.labels(23) > 0) & (labels > 0)
    assert hidden.sum() > 100  # what the objects hide now was seen before
    shown = np.abs(made.frame(23).astype(int) - truth).mean(axis=2)
    assert difference[hidden].mean() < 0.6 * shown[hidden].mean()
