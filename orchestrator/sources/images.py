"""A folder or a glob of images as a video: natural order, one frame per file, or per page of a single TIFF.

Images are decoded as ``cv2.imread`` does by default, so that a user's own loop sees the same pixels: grey
becomes three equal channels, 16 bits their higher 8, alpha is left out, the camera's orientation applied.
Where the higher 8 bits would show little or nothing, the values are stretched
(:mod:`orchestrator.sources.value_range`). A file that cannot be decoded stays a frame of the sequence, as
quarantined.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from mlbs_actors.messages import Array
from mlbs_actors.source import SourceFrame, SourceStatus
from orchestrator.sources.jpeg import is_cut_off_jpeg
from orchestrator.sources.presence import images_of
from orchestrator.sources.value_range import ValueRange

__all__ = ["FRAME_RATE", "ImageSequenceReader", "decode_image"]

#: Frames per second that a sequence of images is assumed to have, as files have no time.
FRAME_RATE = 25.0

_AS_STORED = cv2.IMREAD_ANYDEPTH | cv2.IMREAD_ANYCOLOR

#: Only these can hold more than 8 bits.
_DEEP_SUFFIXES = frozenset({".pgm", ".png", ".pnm", ".ppm", ".tif", ".tiff"})
_PAGED_SUFFIXES = frozenset({".tif", ".tiff"})
#: Images whose values are looked at first, evenly spread over the sequence.
_SAMPLES = 8

_PNG_END = b"IEND\xaeB`\x82"


def decode_image(data: bytes, flags: int = cv2.IMREAD_COLOR) -> Array | None:
    """Decode one image file to (H, W, 3) uint8 BGR, or as OpenCV's ``flags`` say; None if it is damaged.

    OpenCV silently fills the missing part of a truncated JPEG with grey; so its end marker is looked for.
    What is behind it, such as a phone's film of the moment, is no concern of the picture.
    """
    if _is_cut_off(data):
        return None
    try:
        # Stubs say that this never returns None; it does for other files.
        image: Array | None = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error:
        return None
    return image


def _is_cut_off(data: bytes) -> bool:
    if data.startswith(b"\x89PNG"):
        return _PNG_END not in data
    return data.startswith(b"\xff\xd8\xff") and is_cut_off_jpeg(data)


@dataclass(frozen=True, slots=True)
class _Image:
    """A file, or one page of it."""

    path: Path
    page: int | None = None

    @property
    def name(self) -> str:
        return self.path.stem if self.page is None else f"{self.page:05d}"

    @property
    def is_deep(self) -> bool:
        """Whether it can hold more than 8 bits."""
        return self.path.suffix.lower() in _DEEP_SUFFIXES

    def decoded(self, flags: int) -> Array | None:
        """Decode it as OpenCV's ``flags`` say; None if it is damaged."""
        try:
            if self.page is None:
                return decode_image(self.path.read_bytes(), flags)
            _, pages = cv2.imreadmulti(str(self.path), self.page, 1, flags=flags)
        except (OSError, cv2.error):
            return None
        return np.asarray(pages[0]) if pages else None


def _images_at(location: str) -> list[_Image]:
    paths = images_of(location)
    if paths == [Path(location)] and paths[0].suffix.lower() in _PAGED_SUFFIXES:
        pages = cv2.imcount(location)
        if pages > 1:
            return [_Image(paths[0], page) for page in range(pages)]
    return [_Image(path) for path in paths]


class ImageSequenceReader:
    """Reads a sequence of images.

    Parameters
    ----------
    location : str
        Absolute path of a folder, a glob, or one image.
    """

    def __init__(self, location: str) -> None:
        self._images = _images_at(location)
        self._next = 0
        self._undecodable: list[str] = []
        self._range = ValueRange.of(self._samples())

    @property
    def problem(self) -> str | None:
        """The images that could not be decoded."""
        if not self._undecodable:
            return None
        count = len(self._undecodable)
        return f"{count} of {self._next} images could not be decoded, the first is {self._undecodable[0]}."

    def read(self) -> SourceFrame | None:
        """Return the next image, or None at the end."""
        if self._next == len(self._images):
            return None
        one, index = self._images[self._next], self._next
        self._next += 1
        image = one.decoded(cv2.IMREAD_COLOR if self._range is None else _AS_STORED)
        if image is None:
            self._undecodable.append(one.path.name if one.page is None else f"page {one.page}")
        elif self._range is not None:
            image = self._range.stretched(image)
        status: SourceStatus = "ok" if image is not None else "quarantined"
        return SourceFrame(index, image, index / FRAME_RATE, one.name, status, length=len(self._images))

    def close(self) -> None:
        """Do nothing: no file is open."""

    def _samples(self) -> Iterator[Array]:
        """Yield some of the images with the values that their files hold."""
        last = len(self._images) - 1
        for place in sorted({round(last * share) for share in np.linspace(0, 1, _SAMPLES)}):
            one = self._images[place]
            if not one.is_deep:
                return
            if (image := one.decoded(_AS_STORED)) is not None:
                yield image
