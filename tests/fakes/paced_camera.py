"""A camera that delivers its pictures at a rate of its own, read as OpenCV's are."""

from __future__ import annotations

import time
from collections.abc import Sequence

from mlbs_actors.messages import Array


class PacedCamera:
    """Waits ``interval`` s before each picture; after the last one it gives no more."""

    def __init__(self, pictures: Sequence[Array], interval: float) -> None:
        self.pictures = pictures
        self.interval = interval
        self.given = 0
        self.released = False

    def read(self) -> tuple[bool, Array | None]:
        time.sleep(self.interval)
        if self.given == len(self.pictures):
            return False, None
        self.given += 1
        return True, self.pictures[self.given - 1]

    def release(self) -> None:
        self.released = True
