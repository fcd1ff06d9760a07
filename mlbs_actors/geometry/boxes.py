"""Groups of object regions without pixel pairs between them: each is an independent labelling problem (§7).

A layer other than the background owns nothing outside its region, so two objects can be neighbours only where
their regions touch. Boxes around the regions, grown by the reach of a pixel pair and merged while any two
overlap, hence split the energy into independent sums: each label cost belongs to one group and the background
is free. Outside all boxes every pixel is background.

Differs from the paper, which labels the whole frame with all layers at once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mlbs_actors.kernels.jit import compiled
from mlbs_actors.messages import Array, Region

__all__ = ["RegionGroup", "group_regions", "grown", "merge_boxes", "slices_in"]


@dataclass(frozen=True, slots=True)
class RegionGroup:
    """Regions that belong together.

    Attributes
    ----------
    box : Region
        Around all of them with a margin of one pixel, clipped to the frame.
    members : tuple of int
        Their positions in the given sequence, ascending.
    """

    box: Region
    members: tuple[int, ...]


def group_regions(regions: Sequence[Region], shape: tuple[int, int]) -> list[RegionGroup]:
    """Put regions into groups with disjoint boxes.

    Parameters
    ----------
    regions : sequence of Region
        Inside the frame; empty ones are in no group.
    shape : (H, W)
        Of the frame.

    Returns
    -------
    list of RegionGroup
        In the order of their first members.
    """
    corners = np.array([(one.x, one.y, one.x + one.width, one.y + one.height) for one in regions], np.int64)
    corners = corners.reshape(-1, 4)
    groups: dict[int, list[int]] = {}
    for position, group in enumerate(merge_boxes(corners, *shape).tolist()):
        if group >= 0:
            groups.setdefault(group, []).append(position)
    boxes = [corners[group].tolist() for group in groups]
    return [
        RegionGroup(Region(left, top, right - left, bottom - top), tuple(positions))
        for (left, top, right, bottom), positions in zip(boxes, groups.values(), strict=True)
    ]


@compiled
def merge_boxes(corners: Array, height: int, width: int) -> Array:
    """Grow boxes by one pixel, or cell, and merge them until none overlap.

    Parameters
    ----------
    corners : (n, 4) int64
        Left, top, right and bottom; those of the first of a group become the group's, the others' become
        meaningless.
    height, width : int
        Of the frame, to which they are clipped.

    Returns
    -------
    (n,) int64
        The first of each one's group; −1 for empty boxes.
    """
    group = np.arange(len(corners))
    for one in range(len(corners)):
        box = corners[one]
        if box[0] == box[2] or box[1] == box[3]:
            group[one] = -1
        box[0], box[1] = max(box[0] - 1, 0), max(box[1] - 1, 0)
        box[2], box[3] = min(box[2] + 1, width), min(box[3] + 1, height)
    changed = True
    while changed:
        changed = False
        for one in range(len(corners)):
            for other in range(one + 1, len(corners)):
                if group[one] != one or group[other] != other:
                    continue
                a, b = corners[one], corners[other]
                if max(a[0], b[0]) < min(a[2], b[2]) and max(a[1], b[1]) < min(a[3], b[3]):
                    a[:2], a[2:] = np.minimum(a[:2], b[:2]), np.maximum(a[2:], b[2:])
                    group[group == other] = one
                    changed = True
    return group


def slices_in(region: Region, box: Region) -> tuple[slice, slice]:
    """Return row and column slices that cut a region out of an array of the box around it."""
    return Region(region.x - box.x, region.y - box.y, region.width, region.height).slices


def grown(box: Region, reach: int, shape: tuple[int, ...]) -> Region:
    """Grow a box by the reach of a filter, inside the frame."""
    x, y = max(box.x - reach, 0), max(box.y - reach, 0)
    right, bottom = min(box.x + box.width + reach, shape[1]), min(box.y + box.height + reach, shape[0])
    return Region(x, y, right - x, bottom - y)
