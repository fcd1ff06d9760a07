"""The whole pipeline with the product's parameters at sizes that people film in, against exact truth."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from mlbs_actors import MultilayerSubtractor
from mlbs_actors.messages import Array
from mlbs_actors.scenes.synthetic import scene
from orchestrator.evaluation.metrics import match_objects, object_level
from orchestrator.evaluation.overlap import count_overlap
from orchestrator.evaluation.track_metrics import id_switches

FRAMES = 12
#: By this frame all is found that moves from the start on.
SETTLED = 8


@pytest.mark.parametrize(
    ("width", "height"), [(854, 480), pytest.param(1280, 720, marks=pytest.mark.long), (480, 854)]
)
def test_each_mover_gets_a_good_mask_and_a_lasting_label_and_the_ground_none(width: int, height: int) -> None:
    video = scene("street", seed=1, width=width, height=height)
    subtractor = MultilayerSubtractor()
    results = [one for t in range(FRAMES) for one in subtractor.apply(video.frame(t))]
    assert [one.frame_index for one in results] == list(range(FRAMES))
    overlaps = [
        count_overlap(one.labels, video.labels(one.frame_index), one.frame_index) for one in results[SETTLED:]
    ]
    for overlap in overlaps:
        assert overlap.objects.tolist() == [1, 2, 3]
        assert object_level(overlap).f > 0.95
        assert sorted(match_objects(overlap).values()) == overlap.labels.tolist()
        on_the_ground = overlap.counts[0, 1:]
        assert (on_the_ground < 0.1 * overlap.counts[:, 1:].sum(axis=0)).all()
        assert on_the_ground.sum() < 0.003 * np.sum(overlap.counts[0])
    assert id_switches(overlaps) == 0


def textured(generator: np.random.Generator, height: int, width: int) -> Array:
    """A surface with structure of every size, BGR."""
    values = np.full((height, width, 3), 120, np.float32)
    for spread, contrast in ((2, 5), (8, 9), (32, 22), (100, 43)):
        coarse = generator.normal(0, 1, (height // spread + 2, width // spread + 2, 3)).astype(np.float32)
        values += contrast / 2 * cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
    return np.clip(values, 0, 255).astype(np.uint8)


@pytest.mark.long
def test_small_things_in_a_large_picture_are_found() -> None:
    """As from a drone: 56×32 px in 1920×1080."""
    frames, (width, height) = 30, (1920, 1080)
    generator = np.random.default_rng(2)
    ground = textured(generator, height, width + 4 * frames)
    car = (textured(generator, 32, 56) // 2 + np.array([40, 50, 120])).astype(np.uint8)
    subtractor, found = MultilayerSubtractor(), 0
    for t in range(frames):
        frame = ground[:, 4 * t : 4 * t + width].copy()
        at = 400 + 2 * t
        frame[500:532, at : at + 56] = car
        frame = np.clip(frame + generator.normal(0, 1.5, frame.shape), 0, 255).astype(np.uint8)
        for result in subtractor.apply(frame):
            on_it = result.labels[500:532, at : at + 56] > 0
            found += bool(on_it.mean() > 0.8 and (result.labels > 0).sum() < 1.2 * on_it.size)
    assert found > frames // 2
