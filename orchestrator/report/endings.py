"""How each object ends after the last frame that shows it, judged by the label maps alone."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import pyarrow as pa
import pyarrow.compute
from pycocotools import mask as coco_mask

from mlbs_actors.messages import Array

__all__ = ["ENDING_COLUMNS", "Ending", "ending"]

#: Columns of ``layers`` that are needed to judge an ending.
ENDING_COLUMNS = ("frame", "layer", "x", "y", "w", "h", "area", "rle")

#: Share of an object's last mask that another one must cover in the next frame to replace it.
_TAKEN_OVER = 0.5


@dataclass(frozen=True, slots=True)
class Ending:
    """How the record of an object ends.

    Attributes
    ----------
    kind : {"seen", "resized", "replaced", "left", "lost"}
        It is in the last frame; the next frame has another size, which ends all objects; most of its pixels
        are another object's in the next frame (the two merged, the other occludes it, or the same thing
        continues under another id); its box reached the border; none of these (it came to rest, went behind
        something, or was lost).
    by : int
        The other object, −1 if there is none.
    """

    kind: Literal["seen", "resized", "replaced", "left", "lost"]
    by: int = -1

    @property
    def words(self) -> str:
        """Text for a table."""
        return {
            "seen": "in the last frame",
            "resized": "the picture changed its size",
            "replaced": f"{self.by} in its place",
            "left": "left the picture",
            "lost": "at rest, hidden or lost",
        }[self.kind]

    @property
    def sign(self) -> str:
        """Symbol for a chart."""
        return {"seen": "", "replaced": f"→{self.by}", "left": "⇥"}.get(self.kind, "×")


def ending(row: int, layers: pa.Table, frames: Array, shapes: Array) -> Ending:
    """Judge how an object ends.

    Parameters
    ----------
    row : int
        Of the object's last frame, in ``layers``.
    layers : table
        With :data:`ENDING_COLUMNS`.
    frames : (n,) int64
        Those with a label map, ascending.
    shapes : (n, 2) int64
        Their height and width, px.
    """
    last = layers.slice(row, 1).to_pylist()[0]
    place = int(np.searchsorted(frames, last["frame"]))
    if place + 1 == len(frames):
        return Ending("seen")
    height, width = shapes[place].tolist()
    if shapes[place + 1].tolist() != [height, width]:
        return Ending("resized")
    mask = _encoded(last["rle"], height, width)
    for other in layers.filter(pa.compute.equal(layers["frame"], frames[place + 1])).to_pylist():
        common = coco_mask.merge([mask, _encoded(other["rle"], height, width)], intersect=True)
        if coco_mask.area(common) > _TAKEN_OVER * last["area"]:
            return Ending("replaced", other["layer"])
    right, bottom = last["x"] + last["w"], last["y"] + last["h"]
    at_border = last["x"] == 0 or last["y"] == 0 or right == width or bottom == height
    return Ending("left" if at_border else "lost")


def _encoded(code: str, height: int, width: int) -> dict[str, object]:
    return {"size": [height, width], "counts": code.encode("ascii")}
