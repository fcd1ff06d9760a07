"""A layer reads of a frame what its segmenter has, and the segmenter of its posterior what the layer has."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from joined_evidence import joined_evidence

from mlbs_actors.actors.layer_notes import (
    FrameNotes,
    SharedFrame,
    read_posterior,
    read_step,
    write_posterior,
)
from mlbs_actors.actors.shared_memory import SharedMemory, SlotPool
from mlbs_actors.actors.stream_protocol import SourceFrame
from mlbs_actors.errors import LayerError
from mlbs_actors.messages import (
    FrameEvidence,
    LayerEvidence,
    LayerKind,
    LayerPosterior,
    LayerSummary,
    Region,
    Segmentation,
)

RANDOM = np.random.default_rng(4)
KINDS: tuple[LayerKind, ...] = ("background", "object", "other", "object")


def some_evidence() -> FrameEvidence:
    layers = [
        LayerEvidence(7 * number, kind, 40 - number, *RANDOM.random((2, points, 2)).astype(np.float32))
        for number, (kind, points) in enumerate(zip(KINDS, (5, 3, 0, 2), strict=True))
    ]
    return joined_evidence(
        layers,
        frame_index=41,
        shape=(48, 64),
        camera=RANDOM.random((3, 3)).T,  # not row by row
        flow=RANDOM.random((24, 32, 2)).astype(np.float16),
        flow_reliable=RANDOM.random((24, 32)) < 0.5,
        unexplained=RANDOM.integers(0, 256, (24, 32)).astype(np.uint8),
        retired=(7, 9),
        latency_frames=2,
        stage_ms={"flow": 1.5},
        epoch=3,
    )


def some_segmentation() -> Segmentation:
    summaries = tuple(
        LayerSummary(layer, "object", Region(layer, 2, 3, 4), 9, (1.5, 2.5), (0.1, -0.5), 0.75)
        for layer in (7, 12, 21)
    )
    labels = RANDOM.integers(0, 22, (48, 64)).astype(np.uint16)
    normaliser = RANDOM.integers(0, 256, (24, 32)).astype(np.uint8)
    return Segmentation(
        40, labels, normaliser, normaliser.view(np.int8), summaries, (0.5, 1.5), 2, {"cut": 1.0}
    )


def assert_same(one: object, other: object) -> None:
    for field in fields(one):  # type: ignore[arg-type]
        given, found = getattr(one, field.name), getattr(other, field.name)
        if isinstance(given, np.ndarray):
            np.testing.assert_array_equal(given, found)
            assert (given.dtype, found.flags.writeable) == (found.dtype, False)
        else:
            assert given == found, field.name


@pytest.mark.parametrize("layer", [0, 7, 14, 21])
@pytest.mark.parametrize("first", [False, True])
def test_a_layer_is_told_all_that_concerns_it(layer: int, first: bool) -> None:
    slots, memory = SlotPool(), SharedMemory()
    evidence, previous = some_evidence(), None if first else some_segmentation()
    frame = SourceFrame(50, RANDOM.integers(0, 256, (48, 64, 3), dtype=np.uint8), 0.1, "img 50")
    assert frame.image is not None
    where = (
        memory.share(evidence, slots.take("evidence")),
        memory.share(frame, slots.take("frame")),
        None if previous is None else memory.share(previous, slots.take("segmentation")),
    )
    answer, wanted = slots.take("posterior"), slots.take("appearance") if layer == 0 else None
    notes = FrameNotes(SharedFrame(evidence, frame.image, previous, *where))
    step = read_step(notes.to(layer, answer, wanted), SharedMemory())

    assert (step.answer, step.appearance) == (answer, wanted)
    np.testing.assert_array_equal(step.image, frame.image)
    own = evidence.tracks if layer == 0 else tuple(one for one in evidence.tracks if one.layer == layer)
    assert_same(replace(evidence, tracks=own, retired=(), latency_frames=0, stage_ms={}), step.evidence)
    assert_same(evidence.of(layer), step.evidence.of(layer))
    if previous is None:
        assert step.previous is None
    else:
        summaries = tuple(one for one in previous.layers if layer in (0, one.layer))
        told = replace(previous, layers=summaries, camera_motion=(0.0, 0.0), latency_frames=0, stage_ms={})
        assert_same(told, step.previous)


@pytest.mark.parametrize("stage_ms", [{}, {"update": 0.25}, {"gabp": 1.5, "the rest": 2.5}])
@pytest.mark.parametrize("shape", [(0, 0), (31, 17)])
def test_a_posterior_comes_back_as_it_was(stage_ms: dict[str, float], shape: tuple[int, int]) -> None:
    slot, writer = SlotPool().take("posterior"), SharedMemory()
    cost = RANDOM.integers(0, 256, (2 * shape[0], shape[1])).astype(np.uint8)[
        ::2
    ]  # rows not one after the other
    posterior = LayerPosterior(
        layer=9,
        frame_index=41,
        kind="other",
        region=Region(2, 4, 2 * shape[1], 2 * shape[0]),
        cell=2,
        cost=cost,
        log_ratio=cost.view(np.int8),
        samples=cost // 2,
        outside_cost=255,
        confidence=1 / 3,
        velocity=np.array([0.1, -7], np.float32),
        stage_ms=stage_ms,
    )
    note = write_posterior(posterior, writer, slot)
    assert_same(posterior, read_posterior(note, SharedMemory(), slot))


def test_a_note_that_is_read_too_late_is_refused() -> None:
    slots, memory = SlotPool(), SharedMemory()
    evidence = some_evidence()
    where = memory.share(evidence, slots.take("evidence"))
    image = np.zeros((48, 64, 3), np.uint8)
    frame = memory.share(SourceFrame(50, image, 0.1, "img 50"), slots.take("frame"))
    note = FrameNotes(SharedFrame(evidence, image, None, where, frame, None)).to(0, slots.take("posterior"))
    slots.give_back([where.slot])
    memory.share(evidence, slots.take("evidence"))
    with pytest.raises(LayerError, match="lent again"):
        read_step(note, memory)
