"""A source that is segmented again as a run did."""

from __future__ import annotations

from pathlib import Path

import cv2
import pytest

from mlbs_actors import Config, MultilayerSubtractor
from mlbs_actors.record.recorded_stream import recorded_stream
from mlbs_actors.scenes.synthetic import scene
from mlbs_actors.source import SourceFrame
from orchestrator.export.replay import inspected
from orchestrator.sinks.record import StreamRecord

# pycocotools decodes through an __array__ method that NumPy 2 finds outdated.
pytestmark = pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")

UNDECODABLE, LABEL_MAPS = 1, 6


def test_the_label_maps_that_a_run_was_limited_to_are_made_again_past_a_frame_without_one(
    tmp_path: Path,
) -> None:
    video = scene("pan", frames=60, width=160, height=120)
    images, folder = tmp_path / "images", tmp_path / "pan"
    images.mkdir()
    for t in range(10):
        cv2.imwrite(str(images / f"{t:05d}.png"), video.frame(t))
    (images / f"{UNDECODABLE:05d}.png").write_bytes(b"damaged")
    record = StreamRecord(folder, "pan", frozenset({"masks", "parquet"}))
    subtractor = MultilayerSubtractor(Config())
    read = [t for t in range(10) if t != UNDECODABLE][:LABEL_MAPS]
    results = [one for t in read for one in subtractor.apply(video.frame(t))] + subtractor.flush()
    for t, result in zip(read, results, strict=True):
        if t == UNDECODABLE + 1:
            record.gap(UNDECODABLE, UNDECODABLE / 25, "quarantined")
        record.write(result, SourceFrame(t, video.frame(t), t / 25, f"{t:05d}"))
    record.close(whole=True)
    again = list(inspected(recorded_stream(folder), str(images), Config(), LABEL_MAPS))
    assert [one.recorded.index for one in again] == read
    assert all(one.same_labels for one in again)
