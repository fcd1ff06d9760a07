"""How long a run is expected to take."""

from __future__ import annotations

import pytest

from orchestrator.run.expected_time import expected_seconds, words_on_expected_time
from orchestrator.sources.survey import SourceContent

VGA = SourceContent(1000, (480, 640))


def test_more_frames_take_longer_and_more_cores_less_up_to_two_a_file() -> None:
    least, most = expected_seconds([VGA], 1)
    assert 20 < least < 40  # 28 ms a frame with one object
    assert least < most < 200
    assert expected_seconds([VGA, VGA], 1) == pytest.approx((2 * least, 2 * most))
    assert expected_seconds([VGA], 2) == expected_seconds([VGA], 8) == pytest.approx((least / 2, most / 2))
    assert expected_seconds([VGA, VGA], 4) == pytest.approx((least / 2, most / 2))


def test_the_time_grows_with_the_size_that_is_processed() -> None:
    sides = ((240, 320), (480, 640), (600, 800), (720, 1280), (1080, 1920), (2160, 3840), (4320, 7680))
    times = [expected_seconds([SourceContent(100, size)], 2) for size in sides]
    assert times == sorted(times)
    assert [most for _, most in times] == sorted(most for _, most in times)
    shrunk = expected_seconds([SourceContent(100, (1080, 1920))], 2, None, 640)
    assert shrunk == pytest.approx(expected_seconds([SourceContent(100, (360, 640))], 2))


@pytest.mark.parametrize(
    ("contents", "max_frames", "words"),
    [
        ([VGA], 20, "1 file, 20 frames: up to 2 seconds once running (an estimate from other machines)."),
        ([VGA], 120, "1 file, 120 frames: about 1 to 10 seconds once running (an"),
        ([VGA] * 3, None, "3 files, 3,000 frames: up to 4 minutes once running (an"),
        ([VGA] * 3, 1, "3 files, 3 frames: up to 1 second once running (an"),
        ([VGA] * 30, None, "30 files, 30,000 frames: about 7 to 38 minutes once running (an"),
        ([SourceContent(), VGA], None, "1 file of known length, 1,000 frames: about"),
        ([SourceContent(fault="It is gone.")], None, None),
        ([], None, None),
    ],
)
def test_it_is_told_as_a_range_where_lengths_are_known(
    contents: list[SourceContent], max_frames: int | None, words: str | None
) -> None:
    told = words_on_expected_time(contents, 2, max_frames, None)
    assert told == words or (words is not None and told is not None and told.startswith(words))
