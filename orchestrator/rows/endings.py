"""How each object ends after the last frame that shows it, judged by the label maps alone."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from mlbs_actors.extras import needing
from mlbs_actors.messages import Region
from mlbs_actors.record.frame_row import ResultRow

with needing("read"):
    from pycocotools import mask as coco_mask

__all__ = ["SEEN", "Ending", "ending"]

#: Share of an object's last mask that another one must cover in the next frame to replace it.
_TAKEN_OVER = 0.5


@dataclass(frozen=True, slots=True)
class Ending:
    """How the record of an object ends.

    Attributes
    ----------
    kind : {"seen", "resized", "cut", "replaced", "left", "lost"}
        It is in the last frame; the next frame has another size, or shows another scene, which ends all
        objects; most of its pixels are another object's in the next frame (the two merged, the other occludes
        it, or the same thing continues under another id); its box reached the border; none of these (it
        became background, went behind something, or was lost).
    by : int, optional
        The other object.
    """

    kind: Literal["seen", "resized", "cut", "replaced", "left", "lost"]
    by: int | None = None

    @property
    def words(self) -> str:
        """Text for a table."""
        return {
            "seen": "in the last frame",
            "resized": "size of the picture changed",
            "cut": "cut",
            "replaced": "another object in its place",
            "left": "left the picture",
            "lost": "no longer found",
        }[self.kind]

    @property
    def sign(self) -> str:
        """Symbol for a chart."""
        return {"seen": "", "replaced": f"→{self.by}", "left": "⇥"}.get(self.kind, "×")


#: That of an object in the newest frame.
SEEN = Ending("seen")


def ending(place: int, last: ResultRow, following: ResultRow, *, cut: bool) -> Ending:
    """Judge how an object ends.

    Parameters
    ----------
    place : int
        Of the object in ``last.layers``.
    last : ResultRow
        The last frame that shows it.
    following : ResultRow
        The next frame with a label map.
    cut : bool
        Whether that is the first picture of another scene.
    """
    if following.shape != last.shape:
        return Ending("resized")
    if cut:
        return Ending("cut")
    layer = last.layers[place]
    mask = _encoded(last.run_length_codes[place], last.shape)
    for other, code in zip(following.layers, following.run_length_codes, strict=True):
        common = coco_mask.merge([mask, _encoded(code, last.shape)], intersect=True)
        if coco_mask.area(common) > _TAKEN_OVER * layer.area:
            return Ending("replaced", other.layer)
    return Ending("left" if _at_border(layer.region, last.shape) else "lost")


def _at_border(region: Region, shape: tuple[int, int]) -> bool:
    height, width = shape
    right, bottom = region.x + region.width, region.y + region.height
    return region.x == 0 or region.y == 0 or right == width or bottom == height


def _encoded(code: str, shape: tuple[int, int]) -> dict[str, object]:
    return {"size": list(shape), "counts": code.encode("ascii")}
