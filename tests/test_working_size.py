"""Working on smaller pictures: what is recorded is in the size of the source."""

from __future__ import annotations

import numpy as np
import pytest

from mlbs_actors import MultilayerSubtractor, Segmentation
from mlbs_actors.actors.stream_protocol import FrameReader, GapStatus, SourceFrame, SourceSilence, StreamSink
from mlbs_actors.messages import Array, LayerSummary, Region
from orchestrator.sources.opening import SceneReader
from orchestrator.sources.synthetic import scene
from orchestrator.working_size import FullSizeSink, ShrinkingReader, enlarged, shrunk


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
    assert result.normaliser.shape == result.fallback.shape == shape


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


class Rows:
    """A sink that keeps what it is given."""

    def __init__(self) -> None:
        self.written: list[tuple[Segmentation, SourceFrame]] = []
        self.gaps: list[int] = []

    def write(self, segmentation: Segmentation, frame: SourceFrame) -> int:
        self.written.append((segmentation, frame))
        return len(self.written)

    def gap(self, index: int, pts: float, status: GapStatus) -> int:
        self.gaps.append(index)
        return len(self.written)

    def close(self) -> int:
        return len(self.written)


def test_a_stream_is_worked_on_small_and_recorded_in_full_size() -> None:
    video = scene("pan", frames=60, width=320, height=240)

    class Source(SceneReader):
        def read(self) -> SourceFrame | None:
            frame = super().read()
            return None if frame is None or frame.index == 8 else frame

    reader: FrameReader = ShrinkingReader(lambda: Source(video), 160)
    rows = Rows()
    sink: StreamSink = FullSizeSink(lambda: rows)
    subtractor = MultilayerSubtractor()
    frames: list[SourceFrame] = []
    while isinstance(frame := reader.read(), SourceFrame):
        assert frame.image is not None
        assert frame.image.shape == (120, 160, 3)
        frames.append(frame)
        for result in subtractor.apply(frame.image):
            sink.write(result, frames[result.frame_index])
    assert sink.gap(8, 0.32, "quarantined") == sink.close() == 8
    for t, (result, recorded) in enumerate(rows.written):
        assert recorded.image is not None
        np.testing.assert_array_equal(recorded.image, video.frame(t))
        assert result.labels.shape == (240, 320)
        assert {layer.layer for layer in result.layers} == set(np.unique(result.labels).tolist()) - {0}
        for layer in result.layers:
            assert layer.area == (result.labels == layer.layer).sum()
    truth = video.labels(7) > 0
    found = rows.written[7][0].labels > 0
    assert (truth & found).sum() / (truth | found).sum() > 0.6


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
