"""The newest overlay of a stream as a small JPEG file for the monitor; never part of the record."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

import cv2

from orchestrator.events.zones import Zone
from orchestrator.pictures.content import DEFAULT_DRAWING, Drawing
from orchestrator.sinks.labelled_picture import LabelledPicture
from orchestrator.storage.durable_files import temporary_path

__all__ = ["LivePicture", "live_picture_path", "watch"]

_WIDTH = 640  # px, at most
_JPEG_QUALITY = 75
#: Least time between two pictures, s, so that their cost does not grow with the frame rate; and for somebody
#: who watches the stream.
_SECONDS, _WATCHED_SECONDS = 0.5, 0.1

#: How long a look counts, s.
_LOOK_SECONDS = 3.0


def live_picture_path(folder: Path, stream: str) -> Path:
    """Return the path of a stream's picture in the folder of all pictures."""
    return folder / f"{stream}.jpg"


def watch(picture: Path) -> None:
    """Ask for more pictures for a while; disk errors are ignored."""
    with suppress(OSError):
        _watched(picture).touch()


def _watched(picture: Path) -> Path:
    return picture.with_suffix(".watched")


class LivePicture:
    """Replaces one file now and then.

    Parameters
    ----------
    path : Path
        The JPEG file; its folder must exist.
    clock : callable
        Monotonic time, s.
    zones : sequence of Zone
        Drawn over the picture; may be replaced later.
    drawing : Drawing
        What is drawn beside them.
    """

    def __init__(
        self,
        path: Path,
        clock: Callable[[], float] = time.monotonic,
        zones: Sequence[Zone] = (),
        drawing: Drawing = DEFAULT_DRAWING,
    ) -> None:
        self._path = path
        self.zones = zones
        self._drawing = drawing
        self._clock = clock
        self._written: float | None = None
        self._unshown: LabelledPicture | None = None

    def show(self, picture: LabelledPicture) -> None:
        """Show a frame unless the last picture is newer than it may be; disk errors are ignored."""
        now = self._clock()
        least = _WATCHED_SECONDS if self._is_watched() else _SECONDS
        if self._written is not None and now - self._written < least:
            self._unshown = picture
        else:
            self._written, self._unshown = now, None
            self._write(picture)

    def close(self) -> None:
        """Show the stream's last frame, however recent the last picture is."""
        if self._unshown is not None:
            self._write(self._unshown)
            self._unshown = None

    def _is_watched(self) -> bool:
        try:
            return time.time() - _watched(self._path).stat().st_mtime < _LOOK_SECONDS
        except OSError:
            return False

    def _write(self, picture: LabelledPicture) -> None:
        drawn = picture.drawn(self.zones, self._drawing, _WIDTH)
        _, jpeg = cv2.imencode(".jpg", drawn, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
        with suppress(OSError):
            temporary_path(self._path).write_bytes(jpeg.tobytes())
            temporary_path(self._path).replace(self._path)
