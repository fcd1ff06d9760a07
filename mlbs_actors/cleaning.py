"""Specks and pinholes of a label map (§7; the authors' program cleans the map it learns from).

Differs from the authors' program, which publishes the raw map and learns from the cleaned one: here they
are the same map. A component smaller than the limit goes to the neighbour with the longest common border;
the largest component of a label is never a speck, so a small far object survives.
"""

from __future__ import annotations

import cv2
import numpy as np

from mlbs_actors.messages import Array

__all__ = ["clean_labels"]


def clean_labels(labels: Array, speck_px: float, hole_px: float) -> Array:
    """Remove small components of every label.

    Parameters
    ----------
    labels : (H, W) int
        Label positions, 0 = background.
    speck_px : float
        Components of a label > 0 below this area are removed, except each label's largest, px².
    hole_px : float
        Components of the background below this area are filled, px².

    Returns
    -------
    (H, W) int
        A new array.
    """
    cleaned = labels.copy()
    for label in np.unique(labels)[::-1]:  # specks first: they must not become holes of what is filled
        limit = hole_px if label == 0 else speck_px
        _count, component, stats, _ = cv2.connectedComponentsWithStats(
            (labels == label).astype(np.uint8), connectivity=4
        )
        areas = stats[1:, cv2.CC_STAT_AREA]
        if len(areas) == 0:
            continue
        small = areas < limit
        small[int(np.argmax(areas))] = False
        for index in np.flatnonzero(small) + 1:
            x, y, width, height = stats[index, :4]
            box = np.s_[max(y - 1, 0) : y + height + 1, max(x - 1, 0) : x + width + 1]
            inside = component[box] == index
            ring = cv2.dilate(inside.astype(np.uint8), np.ones((3, 3), np.uint8)).astype(bool) & ~inside
            neighbours = cleaned[box][ring]
            if len(neighbours):
                cleaned[box][inside] = np.bincount(neighbours).argmax()
    return cleaned
