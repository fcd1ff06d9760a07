"""Working on smaller pictures: what is recorded is in the size of the source."""

from __future__ import annotations

from pathlib import Path

import av
import numpy as np
import pytest
from PIL import Image

from mlbs_actors import MultilayerSubtractor, Segmentation
from mlbs_actors.actors.stream.protocol import StreamSink
from mlbs_actors.messages import Array, LayerSummary, Region
from mlbs_actors.record.record_tables import read_table
from mlbs_actors.scenes.synthetic import scene
from mlbs_actors.source import FrameReader, SourceFrame, SourceSilence
from orchestrator.sources.opening import SceneReader
from orchestrator.working_size import FullSizeRecord, ShrinkingReader, enlarged, shrunk


def segmentation(labels: Array) -> Segmentation:
    layers = []
    for layer in np.unique(labels[labels > 0]).tolist():
        y, x = np.nonzero(labels == layer)
        box = Region(int(x.min()), int(y.min()), int(np.ptp(x)) + 1, int(np.ptp(y)) + 1)
        centroid = float(x.mean()), float(y.mean())
        layers.append(LayerSummary(layer, "object", box, len(x), centroid, (1.0, -2.0), 0.5))
    maps = labels.astype(np.uint8), labels.astype(np.int8)
    return Segmentation(3, labels.astype(np.uint16), *maps, tuple(layers), (0.5, 0.25), 0)


@pytest.mark.parametrize("shape", [(10, 14), (11, 15), (5, 21), (37, 7)])
def test_each_pixel_takes_the_label_of_the_nearest_one(shape: tuple[int, int]) -> None:
    small = np.random.default_rng(1).integers(0, 4, (5, 7))
    result = enlarged(segmentation(small), shape)
    for y in range(shape[0]):
        for x in range(shape[1]):
            rows = np.abs((np.arange(5) + 0.5) / 5 - (y + 0.5) / shape[0])
            columns = np.abs((np.arange(7) + 0.5) / 7 - (x + 0.5) / shape[1])
            near = small[np.ix_(rows <= rows.min() + 1e-9, columns <= columns.min() + 1e-9)]
            assert result.labels[y, x] in near
    assert result.labels.dtype == np.uint16


def test_what_the_tables_tell_is_measured_in_full_size() -> None:
    small = np.zeros((6, 8), np.int64)
    small[2:4, 1:4] = 5
    result = enlarged(segmentation(small), (12, 24))
    assert result.layers == (LayerSummary(5, "object", Region(3, 4, 9, 4), 36, (7.0, 5.5), (3.0, -4.0), 0.5),)
    assert result.camera_motion == (1.5, 0.5)
    assert enlarged(result, (12, 24)) is result


@pytest.mark.parametrize(
    ("shape", "most", "expected"),
    [
        ((480, 640), 320, (240, 320)),
        ((640, 480), 320, (320, 240)),
        ((48, 64), 320, (48, 64)),
        ((1, 900), 90, (1, 90)),
    ],
)
def test_no_side_is_longer_than_asked_and_none_is_enlarged(
    shape: tuple[int, int], most: int, expected: tuple[int, int]
) -> None:
    assert shrunk(np.zeros((*shape, 3), np.uint8), most).shape == (*expected, 3)


def test_a_stream_is_worked_on_small_and_recorded_in_full_size(tmp_path: Path) -> None:
    video = scene("pan", frames=60, width=320, height=240)
    reader: FrameReader = ShrinkingReader(lambda: SceneReader(video), 160)
    record: StreamSink = FullSizeRecord(tmp_path / "pan", "pan", frozenset({"masks", "parquet", "overlay"}))
    subtractor = MultilayerSubtractor()
    frames: list[SourceFrame] = []
    while len(frames) < 8 and isinstance(frame := reader.read(), SourceFrame):
        assert frame.image is not None
        assert frame.image.shape == (120, 160, 3)
        frames.append(frame)
        for result in subtractor.apply(frame.image):
            record.write(result, frames[result.frame_index])
    record.gap(8, 0.32, "quarantined")
    assert record.close(whole=True) == 8
    labels = np.asarray(Image.open(tmp_path / "pan/masks/00007.png"))
    truth, found = video.labels(7) > 0, labels > 0
    assert (truth & found).sum() / (truth | found).sum() > 0.6
    rows = read_table(tmp_path / "pan", "frames").to_pylist()
    assert [(row["height"], row["width"]) for row in rows] == [(240, 320)] * 8 + [(None, None)]
    layers = read_table(tmp_path / "pan", "layers").to_pylist()
    last = [row for row in layers if row["frame"] == 7]
    assert {row["layer"]: row["area"] for row in last} == {
        int(layer): int((labels == layer).sum()) for layer in np.unique(labels[found])
    }
    with av.open(str(tmp_path / "pan/overlay.mp4")) as overlay:
        assert (overlay.streams.video[0].height, overlay.streams.video[0].width) == (240, 320)


def test_silence_and_undecodable_frames_pass_through() -> None:
    said: list[SourceFrame | SourceSilence | None] = [
        SourceSilence("stalled"),
        SourceFrame(0, None, 0.0, "a", "quarantined"),
        None,
    ]

    class Source:
        problem = "damaged"

        def read(self) -> SourceFrame | SourceSilence | None:
            return said.pop(0)

        def close(self) -> None:
            return

    expected = list(said)
    reader = ShrinkingReader(Source, 100)
    assert [reader.read() for _ in range(3)] == expected
    assert reader.problem == "damaged"
