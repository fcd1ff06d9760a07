"""An appearance model of the caller's own, in place of the density of a layer's remembered colours.

The engine makes one for each layer that is born, has it learn what the layer has won, and asks it how well
each colour of a new frame suits the layer. What becomes of its answers, their weight and the rule for what a
layer does not know, stays as it is (:mod:`mlbs_actors.appearance.fusion`).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np

from mlbs_actors.errors import LayerError
from mlbs_actors.messages import Array, LayerKind, Region
from mlbs_actors.wording import described

__all__ = ["Appearance", "AppearanceFactory", "asked", "is_appearance", "made_by"]


class Appearance(Protocol):
    """What one layer looks like.

    Colours are the means of cells, squares of a few pixels; regions are in units of cells, and the same cell
    has the same place in every frame. An object that moves is at other cells in the next frame: ``motion``
    says where each was. A layer that sleeps and wakes, and every layer after a cut, begins anew.
    """

    def update(self, colours: Array, won: Array, region: Region) -> None:
        """Learn from a frame that is labelled.

        Parameters
        ----------
        colours : (h, w, 3) uint8
            BGR.
        won : (h, w) bool
            Cells that are the layer's in the label map, where that is certain.
        region : Region
            Where the cells are in the frame.
        """

    def log_density(self, colours: Array, region: Region, motion: Array) -> Array:
        """Say how well the colours of the next frame suit the layer.

        Parameters
        ----------
        colours : (h, w, 3) uint8
            BGR.
        region : Region
            Where the cells are in the frame.
        motion : (h, w, 2) float32
            The layer's backward motion at each cell, (x, y) in cells: what is seen at a cell was there plus
            its motion in the last frame.

        Returns
        -------
        (h, w) float
            Log of the density of each colour, nats per unit RGB volume: −16.6 (−3 log 256) is as good as
            chance. NaN where nothing is known.
        """


#: Makes the model of a layer that is born, such as a class whose only argument is the layer's kind.
AppearanceFactory = Callable[[LayerKind], Appearance]


def is_appearance(model: object) -> bool:
    """Whether a model, or the class of one, has the methods of :class:`Appearance`."""
    return all(callable(getattr(model, name, None)) for name in ("update", "log_density"))


def made_by(factory: AppearanceFactory, kind: LayerKind) -> Appearance:
    """Make the model of a layer that is born.

    Raises
    ------
    LayerError
        If something else is made.
    """
    made = factory(kind)
    if not is_appearance(made):
        raise LayerError(
            f"appearance({kind!r}) made {described(made)}; it must make an object with the methods "
            "update and log_density."
        )
    return made


def asked(
    own: Appearance, colours: Array, region: Region, motion: Array, certainty: int
) -> tuple[Array, Array]:
    """Ask a model for its density.

    Parameters
    ----------
    certainty : int
        Samples that a known colour counts as.

    Returns
    -------
    log_density : (h, w) float32
        NaN where nothing is known.
    samples : (h, w) uint8
        ``certainty`` where something is, 0 elsewhere.

    Raises
    ------
    LayerError
        If it returns anything else.
    """
    returned = own.log_density(colours, region, motion)
    if not isinstance(returned, np.ndarray):
        raise LayerError(
            f"log_density of the appearance returned {type(returned).__name__}; it must return an array "
            f"{colours.shape[:2]} float, the log density of each cell's colour."
        )
    if returned.shape != colours.shape[:2] or not np.issubdtype(returned.dtype, np.floating):
        raise LayerError(
            f"log_density of the appearance returned {returned.shape} {returned.dtype}; it must return the "
            f"log density of each cell's colour, {colours.shape[:2]} float."
        )
    log_density = np.ascontiguousarray(returned, np.float32)
    return log_density, np.where(np.isnan(log_density), 0, certainty).astype(np.uint8)
