"""What an operator can say of clips, and which sources have them."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from coded_video import write_video

from mlbs_actors.errors import ConfigError
from orchestrator.clips.settings import ClipSettings, clip_settings, has_clips
from orchestrator.sources.address import parse_address


def test_the_seconds_before_and_after_are_read() -> None:
    assert clip_settings("") == ClipSettings()
    assert clip_settings("3,7.5") == ClipSettings(before=3, after=7.5)


@pytest.mark.parametrize("text", ["5", "5,6,7", "a,b", "-1,5", "5,61", "nan,5", "0,0", "inf,1"])
def test_anything_else_is_refused_with_an_example(text: str) -> None:
    with pytest.raises(ConfigError, match="such as 5,10"):
        clip_settings(text)


def test_the_ring_holds_a_shared_clip_of_an_event_that_is_certain_a_minute_later() -> None:
    assert ClipSettings(before=5, after=5).ring_seconds >= 5 + 30 + 60
    assert ClipSettings(before=10, after=60).ring_seconds >= 10 + 60 + 60


def test_cameras_and_videos_have_clips_and_nothing_else(tmp_path: Path) -> None:
    write_video(tmp_path / "video.mp4", 1)
    (tmp_path / "images").mkdir()
    cv2.imwrite(str(tmp_path / "images/1.png"), np.zeros((8, 8, 3), np.uint8))
    found = [
        has_clips(parse_address(text, tmp_path))
        for text in ("rtsp://camera/1", "/dev/video0", "video.mp4", "images", "synthetic:walker")
    ]
    assert found == [True, True, True, False, False]
