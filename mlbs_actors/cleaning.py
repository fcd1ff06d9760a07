"""Specks and pinholes of a label map (§7; the authors' program cleans the map it learns from).

Differs from the authors' program, which publishes the raw map and learns from the cleaned one: here they
are the same map. A component smaller than the limit goes to the neighbour with the longest common border;
the largest component of a label is never a speck, so a small far object survives.
"""

from __future__ import annotations

import cv2
import numpy as np

from mlbs_actors.messages import BACKGROUND, Array, Region
from mlbs_actors.region_groups import common

__all__ = ["clean_labels"]


def clean_labels(labels: Array, box: Region, speck_px: float, hole_px: float) -> Array:
    """Remove small components of every label in a box.

    Parameters
    ----------
    labels : (H, W) unsigned integer
        Label map, 0 = background.
    box : Region
        Around objects; along its sides there is only background, except on the border of the frame.
    speck_px : float
        Components of a label > 0 below this area are removed, except each label's largest, px².
    hole_px : float
        Components of the background below this area are filled, px².

    Returns
    -------
    (box.height, box.width) unsigned integer
        A new array.
    """
    before = labels[box.slices]
    cleaned = before.copy()
    whole = Region(0, 0, box.width, box.height)
    # Specks first: they must not become holes of what is filled.
    for label in np.flatnonzero(np.bincount(before.reshape(-1)))[::-1]:
        own = (before == label).view(np.uint8)
        x, y, width, height = cv2.boundingRect(own)
        part = common(Region(x - 1, y - 1, width + 2, height + 2), whole)
        after = cleaned[part.slices]
        _count, component, stats, _ = cv2.connectedComponentsWithStats(own[part.slices], connectivity=4)
        areas = stats[1:, cv2.CC_STAT_AREA]
        if label == BACKGROUND:  # it goes on outside
            areas[_open_components(component, box, labels.shape) - 1] += labels.size - box.area
        small = areas < (hole_px if label == BACKGROUND else speck_px)
        small[int(np.argmax(areas))] = False
        for index in np.flatnonzero(small) + 1:
            x, y, width, height = stats[index, :4]
            place = np.s_[max(y - 1, 0) : y + height + 1, max(x - 1, 0) : x + width + 1]
            inside = component[place] == index
            ring = cv2.dilate(inside.view(np.uint8), np.ones((3, 3), np.uint8)).astype(bool) & ~inside
            neighbours = after[place][ring]
            if len(neighbours):
                after[place][inside] = np.bincount(neighbours).argmax()
    return cleaned


def _open_components(component: Array, box: Region, shape: tuple[int, ...]) -> Array:
    """Components on those sides of the box that are not the frame's border."""
    sides = []
    if box.y > 0:
        sides.append(component[0])
    if box.x > 0:
        sides.append(component[:, 0])
    if box.y + box.height < shape[0]:
        sides.append(component[-1])
    if box.x + box.width < shape[1]:
        sides.append(component[:, -1])
    return np.unique(np.concatenate(sides)) if sides else np.zeros(0, np.intp)
