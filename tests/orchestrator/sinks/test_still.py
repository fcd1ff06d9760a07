"""The newest frame of a camera without any drawing."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from record_fakes import frame, segmentation

from orchestrator.sinks.record import StreamRecord
from orchestrator.sinks.still import Still, ask_for_still


def brightness(folder: Path) -> int:
    picture = cv2.imread(str(folder / "still.jpg"))
    assert picture is not None
    return round(float(picture.mean()))


def test_a_still_is_a_minute_old_at_most_and_a_second_if_somebody_asks(tmp_path: Path) -> None:
    now = [0.0]
    still = Still(tmp_path, lambda: now[0])

    def shown_at(seconds: float, value: int) -> int:
        now[0] = seconds
        still.show(np.full((48, 64, 3), value, np.uint8))
        return brightness(tmp_path)

    assert shown_at(0, 10) == pytest.approx(10, abs=1)
    assert shown_at(59, 20) == pytest.approx(10, abs=1)
    assert shown_at(60, 30) == pytest.approx(30, abs=1)
    ask_for_still(tmp_path)
    assert shown_at(60.5, 40) == pytest.approx(30, abs=1)
    assert shown_at(61, 50) == pytest.approx(50, abs=1)
    assert shown_at(62, 60) == pytest.approx(50, abs=1)


def test_a_disk_that_cannot_be_written_to_holds_up_nothing(tmp_path: Path) -> None:
    ask_for_still(tmp_path / "gone")
    Still(tmp_path / "gone").show(np.zeros((48, 64, 3), np.uint8))


def test_a_camera_has_a_still_in_its_own_size_and_a_file_has_none(tmp_path: Path) -> None:
    for name, live in (("camera", True), ("file", False)):
        record = StreamRecord(tmp_path / name, name, frozenset(), live=live)
        record.write(segmentation(0, 3), frame(0))
    shown = frame(0).image
    picture = cv2.imread(str(tmp_path / "camera/still.jpg"))
    assert shown is not None
    assert picture is not None
    assert picture.shape == shown.shape
    assert not (tmp_path / "file/still.jpg").exists()
