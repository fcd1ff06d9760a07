"""Pictures of events: an object as it was born, went into a zone or out of it, or over a line.

A picture is there before the line that names it, so that whoever gets the event can look at it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Collection
from pathlib import Path

import cv2
import numpy as np

from mlbs_actors.messages import Array, LayerSummary, Region
from orchestrator.storage.durable_files import remove_temporary, temporary_path

__all__ = ["PICTURES", "EventPictures", "picture_name"]

#: Folder of the pictures, in the stream's.
PICTURES = "events"

#: Newest pictures that are kept.
_MOST_PICTURES = 1000

#: What is shown around an object on each side, as a share of its box, and at least in all, of the picture.
_AROUND, _LEAST_SHARE = 0.5, 0.25

_LONGER_SIDE = 480  # px, at most
_JPEG_QUALITY = 80


def picture_name(frame: int, layer: int) -> str:
    """Return the path, in the stream's folder, of an object in the frame that made its events certain."""
    return f"{PICTURES}/{frame:08d}-{layer}.jpg"


class EventPictures:
    """Writes pictures into the folder of a stream, and deletes the oldest ones.

    Parameters
    ----------
    folder : Path
        Of the stream.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        pictures = folder / PICTURES
        pictures.mkdir(exist_ok=True)
        remove_temporary(pictures)
        self._names = deque(sorted(path.name for path in pictures.glob("*.jpg")))

    def write(self, image: Array, frame: int, layers: Collection[LayerSummary]) -> None:
        """Write one picture of each of these objects in a frame; OSError as the disk says."""
        for layer in layers:
            path = self._folder / picture_name(frame, layer.layer)
            _, jpeg = cv2.imencode(
                ".jpg", _cut_out(image, layer.region), [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY]
            )
            temporary_path(path).write_bytes(jpeg.tobytes())
            temporary_path(path).replace(path)
            if path.name not in self._names:  # a stream that goes back writes it again
                self._names.append(path.name)
        while len(self._names) > _MOST_PICTURES:
            self._delete_oldest()

    def forget_before(self, frame: int) -> None:
        """Delete the pictures of the frames before a number."""
        while self._names and self._names[0] < f"{frame:08d}":
            self._delete_oldest()

    def _delete_oldest(self) -> None:
        (self._folder / PICTURES / self._names.popleft()).unlink(missing_ok=True)


def _cut_out(image: Array, region: Region) -> Array:
    """Cut an object out with what is around it, and shrink it."""
    bounds = []
    for begin, length, whole in (
        (region.y, region.height, image.shape[0]),
        (region.x, region.width, image.shape[1]),
    ):
        side = min(max(round(length * (1 + 2 * _AROUND)), round(whole * _LEAST_SHARE)), whole)
        first = min(max(begin + length // 2 - side // 2, 0), whole - side)
        bounds.append(slice(first, first + side))
    picture = image[bounds[0], bounds[1]]
    share = _LONGER_SIDE / max(picture.shape[:2])
    if share >= 1:
        return np.ascontiguousarray(picture)
    size = (max(1, round(picture.shape[1] * share)), max(1, round(picture.shape[0] * share)))
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA))
