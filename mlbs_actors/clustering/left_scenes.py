"""Scenes that a cut has ended: if one of them comes back, so do its objects (§4).

Not in the paper. What passes close to the lens, or a view of something else in between, ends a scene like any
other cut. If a picture of the scene as it was before is found again in a later one, its objects are lost
objects of the new scene, where the camera's motion in between has taken them, and are recognised as those are
(:mod:`~mlbs_actors.clustering.reidentification`). Nothing else of it is taken up.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from mlbs_actors.clustering.registry_state import RegistryState
from mlbs_actors.flow.consistency import DenseFlow
from mlbs_actors.flow.estimate import Picture
from mlbs_actors.messages import BACKGROUND, Array

__all__ = ["LeftScene", "moved_registry"]

#: From one cell whose flow tells the camera's motion to the next.
STEP = 6
#: Distance within which a cell's flow obeys the camera's motion, px.
OBEYING_PX = 3.0
#: Fewer cells do not tell it.
LEAST_CELLS = 12


@dataclass(frozen=True, slots=True)
class LeftScene:
    """A scene as it was left.

    Attributes
    ----------
    view : Picture
        The last picture that went on from the one before nearly everywhere.
    last_frame : int
        Last one of the scene.
    registry : RegistryState
        Its objects.
    """

    view: Picture
    last_frame: int
    registry: RegistryState


def moved_registry(scene: LeftScene, flow: DenseFlow) -> RegistryState | None:
    """Return the objects of a scene where the camera's motion has taken them.

    Parameters
    ----------
    scene : LeftScene
    flow : DenseFlow
        From its view to the picture in which that was found again.

    Returns
    -------
    RegistryState or None
        Without candidates; None if the flow does not tell the camera's motion.
    """
    reliable = flow.backward_reliable[::STEP, ::STEP]
    y, x = np.nonzero(reliable)
    if len(x) < LEAST_CELLS:
        return None
    now = np.stack([x, y], axis=1) * np.float32(STEP * flow.side)
    before = now + flow.backward[::STEP, ::STEP][reliable]
    camera, _ = cv2.findHomography(before, now, cv2.USAC_MAGSAC, OBEYING_PX)
    if camera is None:
        return None
    objects = scene.registry.select(scene.registry.labels > BACKGROUND)
    places: Array = objects.centroids.reshape(-1, 1, 2)
    moved = cv2.perspectiveTransform(places, camera).reshape(-1, 2) if len(places) else objects.centroids
    return replace(objects, centroids=moved)
