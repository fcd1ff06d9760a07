"""Pictures of events: an object as it was born, went into a zone or out of it, or over a line.

The object is boxed, the zone or line outlined, and the time written in the corner.

A picture is there before the line that names it, so that whoever gets the event can look at it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from mlbs_actors.messages import Array, LayerSummary, Region
from mlbs_actors.pictures.drawing import Outline, draw_box, draw_caption, draw_outlines
from orchestrator.events.file_names import PICTURES, frame_of, in_order, picture_name
from orchestrator.storage.durable_files import remove_temporary, temporary_path

__all__ = ["EventPictures", "Pictured"]

#: Newest pictures that are kept.
_MOST_PICTURES = 1000

#: What is shown around an object on each side, as a share of its box, and at least in all, of the picture.
_AROUND, _LEAST_SHARE = 0.5, 0.25

#: Least width for the height, and the other way round, so that there is room for the time.
_LEAST_ASPECT = 0.75

_LONGER_SIDE = 480  # px
_JPEG_QUALITY = 80


@dataclass(frozen=True, slots=True)
class Pictured:
    """An object of which a picture is taken.

    Attributes
    ----------
    layer : LayerSummary
    outlines : sequence of Outline
        Of the zones and lines that its events are of, px of the frame.
    """

    layer: LayerSummary
    outlines: Sequence[Outline] = ()


class EventPictures:
    """Writes pictures into the folder of a stream, and deletes the oldest ones.

    Parameters
    ----------
    folder : Path
        Of the stream.
    ids : bool
        Whether objects' ids are written at their boxes.
    """

    def __init__(self, folder: Path, *, ids: bool = True) -> None:
        self._folder = folder
        self._ids = ids
        pictures = folder / PICTURES
        pictures.mkdir(exist_ok=True)
        remove_temporary(pictures)
        self._names = deque(sorted((path.name for path in pictures.glob("*.jpg")), key=in_order))

    def write(self, image: Array, frame: int, time: str, objects: Iterable[Pictured]) -> None:
        """Write one picture of each of these objects in a frame; OSError as the disk says."""
        for one in objects:
            path = self._folder / picture_name(frame, one.layer.layer)
            picture = self._picture(image, time, one)
            _, jpeg = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
            temporary_path(path).write_bytes(jpeg.tobytes())
            temporary_path(path).replace(path)
            if path.name not in self._names:  # a stream that goes back writes it again
                self._names.append(path.name)
        while len(self._names) > _MOST_PICTURES:
            self._delete_oldest()

    def forget_before(self, frame: int) -> None:
        """Delete the pictures of the frames before a number."""
        while self._names and frame_of(self._names[0]) < frame:
            self._delete_oldest()

    def _picture(self, image: Array, time: str, one: Pictured) -> Array:
        """Cut an object out with what is around it, and draw what is known of it."""
        region = one.layer.region
        shown = _surroundings(region, (image.shape[0], image.shape[1]))
        scale = _LONGER_SIDE / max(shown.width, shown.height)
        size = max(1, round(shown.width * scale)), max(1, round(shown.height * scale))
        way = cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC
        picture = np.asarray(cv2.resize(image[shown.slices], size, interpolation=way))
        corner = np.array([shown.x, shown.y])
        draw_outlines(
            picture,
            (replace(line, corners=(line.corners - corner) * scale) for line in one.outlines),
        )
        left, top = (round(place * scale) for place in (region.x - shown.x, region.y - shown.y))
        width, height = (max(1, round(length * scale)) for length in (region.width, region.height))
        draw_box(picture, (left, top, width, height), one.layer.layer, ids=self._ids)
        draw_caption(picture, time)
        return picture

    def _delete_oldest(self) -> None:
        (self._folder / PICTURES / self._names.popleft()).unlink(missing_ok=True)


def _surroundings(region: Region, shape: tuple[int, int]) -> Region:
    """Return the part of a picture of ``shape`` (H, W) that shows an object and what is around it."""
    wanted = [
        max(round(length * (1 + 2 * _AROUND)), round(whole * _LEAST_SHARE))
        for length, whole in zip((region.height, region.width), shape, strict=True)
    ]
    height, width = (
        min(max(side, round(other * _LEAST_ASPECT)), whole)
        for side, other, whole in zip(wanted, wanted[::-1], shape, strict=True)
    )
    x = min(max(region.x + region.width // 2 - width // 2, 0), shape[1] - width)
    y = min(max(region.y + region.height // 2 - height // 2, 0), shape[0] - height)
    return Region(x, y, width, height)
