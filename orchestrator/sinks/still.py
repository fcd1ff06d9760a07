"""The newest frame of a camera as it is, without any drawing: for whoever draws zones on it."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import cv2

from mlbs_actors.messages import Array
from orchestrator.storage.durable_files import temporary_path

__all__ = ["STILL", "Still", "ask_for_still"]

#: Name of the file, in the stream's folder.
STILL = "still.jpg"

_ASKED = ".still-asked"
_JPEG_QUALITY = 90

#: Between two stills, s, and at least if somebody asks for one.
_SECONDS, _ASKED_SECONDS = 60.0, 1.0


def ask_for_still(folder: Path) -> None:
    """Ask for a newer one of the stream of a folder; disk errors are ignored."""
    with suppress(OSError):
        (folder / _ASKED).touch()


class Still:
    """Replaces one file now and then.

    Parameters
    ----------
    folder : Path
        Of the stream.
    clock : callable
        Monotonic time, s.
    """

    def __init__(self, folder: Path, clock: Callable[[], float] = time.monotonic) -> None:
        self._path = folder / STILL
        self._asked = folder / _ASKED
        self._clock = clock
        self._written: float | None = None

    def show(self, image: Array) -> None:
        """Write a frame unless the last one is new enough; disk errors are ignored."""
        now = self._clock()
        since = _SECONDS if self._written is None else now - self._written
        if since < _ASKED_SECONDS or (since < _SECONDS and not self._asked.exists()):
            return
        self._written = now
        with suppress(OSError):
            self._asked.unlink(missing_ok=True)
            _, jpeg = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
            temporary_path(self._path).write_bytes(jpeg.tobytes())
            temporary_path(self._path).replace(self._path)
