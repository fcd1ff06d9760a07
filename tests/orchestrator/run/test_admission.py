"""What is said of streams that the machine has no place for; which of them start is in test_driver.py."""

from __future__ import annotations

import pytest

from orchestrator.run.admission import warn_of_cameras


@pytest.mark.parametrize(
    ("cameras", "streams", "waiting"),
    [
        (4, 4, None),
        (3, 50, None),
        (0, 50, None),
        (10, 10, "6 streams"),
        (4, 5, "1 stream may"),
        (9, 30, "26 str"),
    ],
)
def test_streams_that_may_never_start_because_of_cameras_are_told(
    cameras: int, streams: int, waiting: str | None
) -> None:
    said = warn_of_cameras(cameras, streams, 4)
    assert (said is None) == (waiting is None)
    assert (waiting or "") in (said or "")
