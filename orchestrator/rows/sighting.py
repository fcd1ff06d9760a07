"""Where an object is in one frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mlbs_actors.messages import LayerSummary, Region
from mlbs_actors.record.frame_row import FrameRow

__all__ = ["Sighting"]


@dataclass(frozen=True, slots=True)
class Sighting:
    """An object in one frame.

    Attributes
    ----------
    frame : int
    pts : float
        s.
    region : Region
        Bounding box.
    centroid : (float, float)
        (cx, cy), px, in the precision of the tables.
    """

    frame: int
    pts: float
    region: Region
    centroid: tuple[float, float]

    @classmethod
    def of(cls, layer: LayerSummary, row: FrameRow) -> Sighting:
        """Note where an object is in a frame."""
        x, y = np.asarray(layer.centroid, np.float32).tolist()
        return cls(row.frame, row.pts, layer.region, (x, y))
