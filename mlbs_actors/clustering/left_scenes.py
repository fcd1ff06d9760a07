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
from mlbs_actors.config import TrajectoriesConfig
from mlbs_actors.flow.consistency import DenseFlow
from mlbs_actors.flow.estimate import Picture
from mlbs_actors.messages import BACKGROUND
from mlbs_actors.tracking.camera import camera_homography

__all__ = ["LeftScene", "moved_registry"]

#: From one cell whose flow tells the camera's motion to the next.
STEP = 6


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


def moved_registry(
    scene: LeftScene, flow: DenseFlow, scale: float, config: TrajectoriesConfig
) -> RegistryState:
    """Return the objects of a scene where the camera's motion has taken them.

    Parameters
    ----------
    scene : LeftScene
    flow : DenseFlow
        From its view to the picture in which that was found again.
    scale : float
        :func:`~mlbs_actors.config.length_scale` of the frame.
    config : TrajectoriesConfig

    Returns
    -------
    RegistryState
        Without candidates.
    """
    reliable = flow.backward_reliable[::STEP, ::STEP]
    cells = np.stack(np.nonzero(reliable)[::-1], axis=1).astype(np.float32) * np.float32(STEP * flow.side)
    camera = camera_homography(cells, flow.backward[::STEP, ::STEP][reliable], scale, config)
    objects = scene.registry.select(scene.registry.labels > BACKGROUND)
    if not len(objects.labels):
        return objects
    moved = cv2.perspectiveTransform(objects.centroids[None], np.linalg.inv(camera))[0]
    return replace(objects, centroids=moved)
