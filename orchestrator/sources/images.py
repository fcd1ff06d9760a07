"""A folder or a glob of images as a video: natural order, one frame a file.

Images are decoded as ``cv2.imread`` does by default, so that a user's own loop sees the same pixels: grey
becomes three equal channels, 16 bits their higher 8, alpha is left out, the camera's orientation applied.
A file that cannot be decoded stays a frame of the sequence, as quarantined.
"""

from __future__ import annotations

import glob
import re
from pathlib import Path

import cv2
import numpy as np

from mlbs_actors.actors.stream_protocol import SourceFrame, SourceStatus
from mlbs_actors.errors import SourceError
from mlbs_actors.messages import Array

__all__ = ["FRAME_RATE", "IMAGE_SUFFIXES", "ImageSequenceReader", "decode_image", "images_of"]

#: Frames a second that a sequence of images is taken to have: files carry no time.
FRAME_RATE = 25.0

IMAGE_SUFFIXES = frozenset(
    {".bmp", ".jpeg", ".jpg", ".pgm", ".png", ".pnm", ".ppm", ".tif", ".tiff", ".webp"}
)

_TAIL_BYTES = 64
_END_MARKERS = {b"\xff\xd8\xff": b"\xff\xd9", b"\x89PNG": b"IEND"}


def images_of(location: str) -> list[Path]:
    """List the images of a folder, or those that match a glob, in natural order.

    Raises
    ------
    SourceError
        If there are none, or two would give their masks the same name.
    """
    folder = Path(location)
    try:
        # Path.glob takes no absolute patterns.
        names = folder.iterdir() if folder.is_dir() else glob.iglob(location)  # noqa: PTH207
        found = [Path(name) for name in names]
    except OSError as error:
        raise SourceError(f"The images of {location} cannot be listed: {error.strerror}.") from None
    images = [path for path in found if path.suffix.lower() in IMAGE_SUFFIXES and path.is_file()]
    visible = sorted((path for path in images if not path.name.startswith(".")), key=_natural_order)
    if not visible:
        raise SourceError(f"There are no images at {location}; check the path ({_suffix_list()} are read).")
    first_of: dict[str, Path] = {}
    for path in visible:
        other = first_of.setdefault(path.stem, path)
        if other is not path:
            raise SourceError(
                f"{other} and {path} would have the same mask, {path.stem}.png; "
                "name one kind of file by a glob such as 'folder/*.jpg'."
            )
    return visible


def decode_image(data: bytes) -> Array | None:
    """Decode one image file to (H, W, 3) uint8 BGR; None if it is damaged or no image.

    OpenCV fills what a truncated JPEG lacks with grey and says nothing; so its end marker is looked for.
    """
    for head, end in _END_MARKERS.items():
        if data.startswith(head) and end not in data[-_TAIL_BYTES:]:
            return None
    try:
        # Stubs say that this never returns None; it does for what is no image.
        image: Array | None = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    except cv2.error:
        return None
    return image


class ImageSequenceReader:
    """Reads a sequence of images.

    Parameters
    ----------
    location : str
        Absolute path of a folder, a glob, or one image.
    """

    def __init__(self, location: str) -> None:
        self._paths = images_of(location)
        self._next = 0
        self._undecodable: list[str] = []

    @property
    def problem(self) -> str | None:
        """Which images could not be decoded."""
        if not self._undecodable:
            return None
        count = len(self._undecodable)
        return f"{count} of {self._next} images could not be decoded, the first is {self._undecodable[0]}."

    def read(self) -> SourceFrame | None:
        """Return the next image, or None at the end."""
        if self._next == len(self._paths):
            return None
        path, index = self._paths[self._next], self._next
        self._next += 1
        try:
            image = decode_image(path.read_bytes())
        except OSError:
            image = None
        if image is None:
            self._undecodable.append(path.name)
        status: SourceStatus = "ok" if image is not None else "quarantined"
        return SourceFrame(index, image, index / FRAME_RATE, path.stem, status)

    def close(self) -> None:
        """Nothing is held open."""


def _natural_order(path: Path) -> tuple[list[tuple[int, int, str]], str]:
    """Sort key by which frame10 comes after frame9; equal numbers (1, 01) fall back to the text."""
    parts = re.split(r"(\d+)", str(path))
    key = [(0, int(part), "") if part.isdecimal() else (1, 0, part) for part in parts if part]
    return key, str(path)


def _suffix_list() -> str:
    return ", ".join(sorted(suffix.removeprefix(".") for suffix in IMAGE_SUFFIXES))
