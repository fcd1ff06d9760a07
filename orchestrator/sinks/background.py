"""The background plate: a frame without the objects that move in it."""

from __future__ import annotations

import cv2
import numpy as np
import scipy

from mlbs_actors.messages import BACKGROUND, Array, LayerAppearance

__all__ = ["background_plate"]

#: Width of an object's fringe outside its outline, px.
NEAR_PX = 8


def background_plate(appearance: LayerAppearance, image: Array, labels: Array) -> Array:
    """Compose the plate of a frame.

    A pixel's colour is the first of these that is known: the frame's own, if it is labelled background and no
    object is near; the median of the background's remembered colours there; the frame's own, if it is
    labelled background; the colour of the nearest pixel of these kinds. Only pixels filled in the last way
    are transparent.

    Parameters
    ----------
    appearance : LayerAppearance
        The background's, of the same frame.
    image : (H, W, 3) uint8
        BGR.
    labels : (H, W) uint16

    Returns
    -------
    (H, W, 4) uint8
        BGR and opacity, 255 or 0.
    """
    remembered: Array = np.zeros(labels.shape, np.bool_)
    remembered[appearance.region.slices] = appearance.known
    near = cv2.dilate((labels > BACKGROUND).view(np.uint8), np.ones((2 * NEAR_PX + 1,) * 2, np.uint8)) > 0
    behind = remembered & near
    colours = image.copy()
    colours[behind] = appearance.colours[behind[appearance.region.slices]]
    known = remembered | (labels == BACKGROUND)
    if known.any() and not known.all():
        rows, columns = scipy.ndimage.distance_transform_edt(
            ~known, return_distances=False, return_indices=True
        )
        colours = colours[rows, columns]
    plate: Array = cv2.merge([*cv2.split(colours), np.where(known, np.uint8(255), np.uint8(0))])
    return plate
