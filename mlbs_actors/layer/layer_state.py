"""The state of a layer between two frames."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mlbs_actors.appearance.colour_model import AppearanceModel, empty_model
from mlbs_actors.messages import Array, Region

__all__ = ["LayerState"]


@dataclass(slots=True)
class LayerState:
    """Everything that determines the layer's next frame.

    Attributes
    ----------
    last_frame : int
        Frame evaluated last, −1 before the first.
    home : Region
        Where it has samples: the frame for the background, else ``region``.
    region : Region
        Where it was evaluated.
    cell : int
        Side of the cells of all these arrays, px.
    model : AppearanceModel
        Samples at ``last_frame``, without that frame's own colours, cell by cell of ``home``.
    cost : (rows, columns) uint8
        Unnormalised posterior of ``last_frame`` without the colours, as sent to the segmenter.
    log_ratio : (rows, columns) int8
    samples : (rows, columns) uint8
        The colours' part, as sent to the segmenter.
    image : (home's rows, home's columns, 3) uint8
        Mean colours of that frame, to learn from once its labels are known.
    velocity : (2,) float32
        Median forward motion of the layer's trajectories, px/frame.
    trusted : bool
        Cells of ``home`` in which the layer may learn that frame.
    """

    last_frame: int
    home: Region
    region: Region
    cell: int
    model: AppearanceModel
    cost: Array
    log_ratio: Array
    samples: Array
    image: Array
    velocity: Array
    trusted: Array

    @staticmethod
    def beginning(sample_count: int) -> LayerState:
        """Return the state before the first frame, with room for ``sample_count`` samples a cell."""
        nowhere = Region(0, 0, 0, 0)
        return LayerState(
            last_frame=-1,
            home=nowhere,
            region=nowhere,
            cell=1,
            model=empty_model(nowhere, sample_count),
            cost=np.zeros((0, 0), np.uint8),
            log_ratio=np.zeros((0, 0), np.int8),
            samples=np.zeros((0, 0), np.uint8),
            image=np.zeros((0, 0, 3), np.uint8),
            velocity=np.zeros(2, np.float32),
            trusted=np.zeros((0, 0), bool),
        )
