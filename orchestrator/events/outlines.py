"""Where zones and lines are in a picture."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from mlbs_actors.pictures.drawing import Outline
from mlbs_actors.record.scene_place import ScenePlace
from orchestrator.events.zones import Zone

__all__ = ["outlines"]


def outlines(
    zones: Iterable[Zone], shape: tuple[int, int], scene: ScenePlace | None = None, scale: float = 1.0
) -> list[Outline]:
    """Return the outlines of zones.

    Parameters
    ----------
    zones : iterable of Zone
    shape : (H, W)
        Size of the picture that the zones are for.
    scene : ScenePlace, optional
        Where the scene is in that picture; zones that are fixed to it are left out without.
    scale : float
        Size of the picture drawn into, for that of ``shape``.
    """
    found = []
    for zone in zones:
        if zone.fixed_to == "picture":
            places = np.array(zone.corners(shape))
        elif scene is not None:
            places = scene.forth(np.array(zone.corners(scene.shape)))
        else:
            continue
        found.append(Outline(zone.name, places * scale, zone.kind == "zone"))
    return found
