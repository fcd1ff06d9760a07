"""Messages come out of a pickle as they went in."""

from __future__ import annotations

import pickle
from dataclasses import fields

import numpy as np
import pytest
from joined_evidence import joined_evidence

from mlbs_actors.actors.ipc.shared_memory import Shared, Slot
from mlbs_actors.messages import FrameEvidence, LayerEvidence, LayerSummary, Region


def layer(number: int, points: int) -> LayerEvidence:
    rng = np.random.default_rng(number)
    positions, motions = rng.random((2, points, 2)).astype(np.float32)
    return LayerEvidence(number, "object" if number else "background", 40 + number, positions, motions)


@pytest.mark.parametrize("points", [(), (5,), (5, 0, 3)])
def test_evidence_is_the_same_in_every_field(points: tuple[int, ...]) -> None:
    rng = np.random.default_rng(9)
    evidence = joined_evidence(
        [layer(*one) for one in enumerate(points)],
        frame_index=41,
        shape=(48, 64),
        camera=rng.random((3, 3)),
        flow=rng.random((24, 32, 2)).astype(np.float32),
        flow_reliable=rng.random((24, 32)) < 0.5,
        unexplained=rng.integers(0, 256, (24, 32)).astype(np.uint8),
        colours=rng.integers(0, 256, (24, 32, 3)).astype(np.uint8),
        retired=(7, 9),
        latency_frames=2,
        stage_ms={"flow": 1.5},
        epoch=3,
    )
    again = pickle.loads(pickle.dumps(evidence, protocol=5))
    for field in fields(FrameEvidence):
        given, found = getattr(evidence, field.name), getattr(again, field.name)
        if isinstance(given, np.ndarray):
            np.testing.assert_array_equal(given, found)
            assert given.dtype == found.dtype
        else:
            assert given == found


def test_other_messages_are_equal() -> None:
    summary = LayerSummary(3, "object", Region(1, 2, 3, 4), 9, (1.5, 2.5), (0.5, -0.5), 0.75)
    shared: Shared[FrameEvidence] = Shared(Slot("posterior", 100, 7, 3, 2), 210)
    for message in (summary, shared):
        assert pickle.loads(pickle.dumps(message)) == message
