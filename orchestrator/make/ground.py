"""Another video behind a cut-out: its frames by their times, from its beginning again where it is shorter."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import closing
from pathlib import Path

import cv2
import numpy as np

from mlbs_actors.errors import ConfigError, SourceError
from mlbs_actors.messages import Array
from mlbs_actors.source import SourceFrame
from orchestrator.sources.address import SourceAddress, parse_address
from orchestrator.sources.opening import open_reader

__all__ = ["Ground", "ground_of"]

_SLACK = 1e-4  # s, by which times that are rounded may differ


def ground_of(text: str) -> SourceAddress:
    """Read ``--over``, a path from the working directory on, and see whether there is a picture.

    Raises
    ------
    ConfigError
        If it is missing, holds no picture, or is a camera.
    """
    try:
        address = parse_address(text, Path.cwd())
    except ConfigError as error:
        raise ConfigError(f"--over cannot be read: {error}.") from None
    if address.live:
        raise ConfigError(f"--over takes a video file, and {address} is a camera; record it first.")
    with closing(Ground(address)):
        return address


class Ground:
    """A video that is shown again and again; a single picture stays.

    Parameters
    ----------
    address : SourceAddress
        Not of a camera.

    Raises
    ------
    ConfigError
        If it cannot be read, or holds no picture; :meth:`at` raises it, too.
    """

    def __init__(self, address: SourceAddress) -> None:
        self._frames = _endless(address)
        first = next(self._frames, None)
        assert first is not None  # or an error
        self._shown: tuple[float, SourceFrame] = first
        self._next: tuple[float, SourceFrame] | None = first
        self._scaled: tuple[tuple[int, int, float], Array] | None = None  # how the shown one is asked for

    def at(self, seconds: float, shape: tuple[int, int], pixel_aspect: float) -> Array:
        """Return what is shown at a time.

        Parameters
        ----------
        seconds : float
            From its first beginning on; no earlier than the time before.
        shape : (int, int)
            Height and width that it covers, px; the rest is cut off on both sides.
        pixel_aspect : float
            Of these pixels.

        Returns
        -------
        (H, W, 3) uint8
            BGR, the caller's own.
        """
        while self._next is not None and self._next[0] <= seconds + _SLACK:
            self._shown, self._scaled = self._next, None
            self._next = next(self._frames, None)
        wanted = (*shape, pixel_aspect)
        if self._scaled is None or self._scaled[0] != wanted:
            self._scaled = wanted, _covering(self._shown[1], shape, pixel_aspect)
        return self._scaled[1].copy()

    def close(self) -> None:
        """Close the file."""
        self._frames.close()


def _endless(address: SourceAddress) -> Generator[tuple[float, SourceFrame], None, None]:
    """Yield frames and their times, s, over and over; of a single one, once."""
    begin = 0.0
    while True:
        last, frames, pictures = 0.0, 0, 0
        try:
            with closing(open_reader(address)) as reader:
                while isinstance(frame := reader.read(), SourceFrame):
                    last, frames = frame.pts, frames + 1
                    if frame.image is not None:
                        pictures += 1
                        yield begin + frame.pts, frame
        except SourceError as error:
            raise ConfigError(f"--over cannot be read: {error}") from None
        if not pictures:
            raise ConfigError(f"--over cannot be read: {address} holds no picture; name a video.")
        if last <= 0:
            return
        begin += last * frames / (frames - 1)  # the last is shown as long as the others


def _covering(frame: SourceFrame, shape: tuple[int, int], pixel_aspect: float) -> Array:
    """Scale a picture to cover a size, keeping its middle and its proportions as they are shown."""
    picture, (height, width) = frame.image, shape
    assert picture is not None
    stretch = pixel_aspect / frame.pixel_aspect
    scale = max(height / picture.shape[0], width * stretch / picture.shape[1])
    kept = (
        min(picture.shape[0], max(1, round(height / scale))),
        min(picture.shape[1], max(1, round(width * stretch / scale))),
    )
    top, left = (picture.shape[0] - kept[0]) // 2, (picture.shape[1] - kept[1]) // 2
    middle = picture[top : top + kept[0], left : left + kept[1]]
    method = cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC
    return np.asarray(cv2.resize(middle, (width, height), interpolation=method))
