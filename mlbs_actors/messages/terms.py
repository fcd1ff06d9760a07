"""What several messages contain: arrays, regions, kinds of layers, statuses of frames."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from mlbs_actors.pickling import pickled_by_values

__all__ = ["BACKGROUND", "NO_PICTURE", "Array", "FrameStatus", "LayerKind", "Region"]

# Not npt.NDArray: since NumPy 2.5 that alias hides its class, and states are checked by class.
Array = np.ndarray[tuple[Any, ...], np.dtype[Any]]
LayerKind = Literal["background", "object", "other"]

#: What a frame with a label map shows: the scene, the first picture of another one (``"cut"``), or too little
#: to tell the camera's motion (``"untracked"``): layers go on there, but none begins. The
#: others are no picture of it: they are of one brightness, repeat the last picture, are lit up for a moment,
#: or do not fit between the pictures before and after. They carry the labels of the last picture, and nothing
#: is learnt from them.
FrameStatus = Literal["ok", "cut", "untracked", "blank", "repeated", "flash", "damaged"]

#: Those from which nothing is learnt.
NO_PICTURE: frozenset[FrameStatus] = frozenset(("blank", "repeated", "flash", "damaged"))

#: Id of the background layer.
BACKGROUND = 0


@pickled_by_values
@dataclass(frozen=True, slots=True)
class Region:
    """A half-open rectangle of pixels: columns x … x+width−1, rows y … y+height−1."""

    x: int
    y: int
    width: int
    height: int

    @property
    def slices(self) -> tuple[slice, slice]:
        """Row and column slices that cut this region out of a full-frame array."""
        return slice(self.y, self.y + self.height), slice(self.x, self.x + self.width)

    @property
    def box(self) -> tuple[int, int, int, int]:
        """Left, top, width and height, for compiled functions."""
        return self.x, self.y, self.width, self.height

    @property
    def area(self) -> int:
        """Number of pixels."""
        return self.width * self.height
