"""What a stream's failures are called."""

from __future__ import annotations

import pytest

from mlbs_actors.actors.failures import reader_lost, source_failure


@pytest.mark.parametrize(("frames", "words"), [(1, "after 1 frame"), (2, "after 2 frames")])
def test_a_single_frame_is_not_called_frames(frames: int, words: str) -> None:
    assert str(reader_lost("yard", frames)).endswith(f" {words}.")
    assert f" {words} with ValueError" in str(source_failure(ValueError("secret"), "a.mp4", frames))
