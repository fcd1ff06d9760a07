"""The whole pipeline with the product's parameters at sizes that people film in, against exact truth."""

from __future__ import annotations

import numpy as np
import pytest

from mlbs_actors import MultilayerSubtractor
from orchestrator.evaluation.metrics import count_overlap, id_switches, match_objects, object_level
from orchestrator.sources.synthetic import scene

FRAMES = 12
#: By this frame all is found that moves from the start on.
SETTLED = 8


@pytest.mark.parametrize(("width", "height"), [(854, 480), (1280, 720), (480, 854)])
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
