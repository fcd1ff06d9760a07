"""Objects cut out of a frame, each a picture of its own with opacity."""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np

from mlbs_actors.messages import Array, Segmentation

__all__ = ["cutouts"]


def cutouts(segmentation: Segmentation, image: Array) -> Iterator[tuple[int, Array]]:
    """Cut every object out along its bounding box.

    Parameters
    ----------
    segmentation : Segmentation
    image : (H, W, 3) uint8
        BGR.

    Yields
    ------
    int
        Layer id.
    (h, w, 4) uint8
        BGR and opacity: 255 on the object, 0 elsewhere.
    """
    for layer in segmentation.layers:
        mask = segmentation.labels[layer.region.slices] == layer.layer
        opacity = np.where(mask, np.uint8(255), np.uint8(0))
        yield layer.layer, cv2.merge([*cv2.split(image[layer.region.slices]), opacity])
