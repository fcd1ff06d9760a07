"""A camera whose frames arrive when its test lets them, read as OpenCV's are."""

from __future__ import annotations

from collections.abc import Sequence
from threading import Condition

from mlbs_actors.messages import Array


class PacedCamera:
    """Hands out the frames that have arrived; ``read`` waits for the next one, and fails at the end."""

    def __init__(self, frames: Sequence[Array] | Array) -> None:
        self._frames = frames
        self._arrived = 0
        self._given = 0
        self._asked = 0
        self._changed = Condition()
        self.released = False

    def let_arrive(self, count: int) -> None:
        """Let as many more frames arrive; after the last of all, the camera is at its end."""
        with self._changed:
            self._arrived += count
            self._changed.notify_all()

    def wait_until_taken(self) -> None:
        """Return once the reader has dealt with every frame that has arrived and asks for another."""
        with self._changed:
            self._changed.wait_for(lambda: self._asked > self._arrived)

    def read(self) -> tuple[bool, Array | None]:
        """Return whether there is a frame, and the frame, as ``cv2.VideoCapture.read`` does."""
        with self._changed:
            self._asked += 1
            self._changed.notify_all()
            self._changed.wait_for(lambda: self._arrived > self._given)
            self._given += 1
            if self._given > len(self._frames):
                return False, None
            return True, self._frames[self._given - 1]

    def release(self) -> None:
        """Note that it was released."""
        self.released = True
