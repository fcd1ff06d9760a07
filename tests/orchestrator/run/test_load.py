"""The load of a stream, measured with a clock that the tests move."""

from __future__ import annotations

import pytest

from mlbs_actors.actors.stream.protocol import StreamProgress
from orchestrator.run.load import LoadMeter, StreamLoad


class Camera:
    """Five frames a second, of which it takes ``cpu`` seconds each to label."""

    def __init__(self) -> None:
        self.now, self.read, self.dropped, self.cpu_seconds = 0.0, 0, 0, 0.0
        self._meter = LoadMeter(lambda: self.now)

    def run(self, seconds: float, cpu: float, drops: float = 0.0) -> StreamLoad:
        for _ in range(round(seconds)):
            self.now += 1
            self.read += 5
            self.dropped += round(5 * drops)
            self.cpu_seconds += cpu * (5 - round(5 * drops))
            load = self._meter.after(
                StreamProgress(
                    read=self.read,
                    committed=self.read - self.dropped,
                    quarantined=0,
                    dropped=self.dropped,
                    layers=1,
                    done=False,
                    cpu_seconds=self.cpu_seconds,
                )
            )
        return load


def test_the_load_is_known_after_half_a_minute() -> None:
    camera = Camera()
    assert camera.run(29, 0.02) == StreamLoad(5.0, None)
    assert camera.run(5, 0.02).cores == pytest.approx(0.1)


def test_the_load_follows_a_scene_that_fills() -> None:
    camera = Camera()
    camera.run(40, 0.01)
    assert 0.1 < (camera.run(10, 0.08).cores or 0) < 0.3
    assert camera.run(60, 0.08).cores == pytest.approx(0.4)


def test_dropped_frames_count_as_if_they_had_been_labelled() -> None:
    assert Camera().run(40, 0.1, drops=0.4).cores == pytest.approx(0.5)
