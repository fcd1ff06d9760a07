"""Animated WebP and PNG files as videos; animated GIFs are read by libav."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from mlbs_actors.errors import SourceError
from mlbs_actors.source import SourceFrame
from mlbs_actors.wording import count_of
from orchestrator.sources.images import FRAME_RATE

__all__ = ["AnimationReader", "is_animation"]

_SUFFIXES = frozenset({".apng", ".png", ".webp"})


def is_animation(location: str) -> bool:
    """Whether a path is that of a file with several frames, to be read by :class:`AnimationReader`."""
    path = Path(location)
    if path.suffix.lower() not in _SUFFIXES or not path.is_file():
        return False
    try:
        with Image.open(path) as image:
            return bool(getattr(image, "is_animated", False))
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError):
        return False  # decoding it as an image says what is wrong


class AnimationReader:
    """Reads the frames of an animation, each as long as the file says.

    Parameters
    ----------
    location : str
        Absolute path of a file that :func:`is_animation`.
    """

    def __init__(self, location: str) -> None:
        self._location = location
        self._animation = Image.open(location)
        # A PNG may begin with a picture for viewers that show no animations.
        self._first = int(getattr(self._animation, "default_image", False))
        self._length = int(getattr(self._animation, "n_frames", 1)) - self._first
        self._next = 0
        self._pts = 0.0
        self.problem: str | None = None

    def read(self) -> SourceFrame | None:
        """Return the next frame, or None at the end.

        Raises
        ------
        SourceError
            If not a single frame can be decoded.
        """
        if self._next == self._length:
            return None
        index, pts = self._next, self._pts
        try:
            self._animation.seek(self._first + index)
            rgb = np.asarray(self._animation.convert("RGB"))
        except (EOFError, OSError, SyntaxError, ValueError):
            if index == 0:
                raise SourceError(f"Not one frame of {self._location} can be decoded.") from None
            self.problem = f"{self._location} is damaged: reading broke off after {count_of(index, 'frame')}."
            self._length = index
            return None
        self._next += 1
        self._pts += float(self._animation.info.get("duration", 0)) / 1000 or 1 / FRAME_RATE
        image = np.ascontiguousarray(rgb[..., ::-1])
        return SourceFrame(index, image, pts, f"{index:05d}", length=self._length)

    def close(self) -> None:
        """Close the file."""
        self._length = self._next
        self._animation.close()
