"""Groups of object regions that no pixel pair connects: each is a labelling problem of its own (§7).

A layer other than the background owns nothing outside its region, so two objects can be neighbours only where
their regions touch. Boxes around the regions, grown by the reach of a pixel pair and merged while any two
overlap, hence split the energy into a sum without common terms, as each label is paid for on its own and the
background is free. Outside all boxes every pixel is background.

Differs from the paper, which labels the whole frame with all layers at once.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from mlbs_actors.messages import Region

__all__ = ["RegionGroup", "around", "common", "group_regions", "slices_in"]


@dataclass(frozen=True, slots=True)
class RegionGroup:
    """Regions that belong together.

    Attributes
    ----------
    box : Region
        Around all of them and one pixel more on each side, as far as the frame goes.
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
    frame = Region(0, 0, shape[1], shape[0])
    groups: list[RegionGroup] = []
    for position, region in enumerate(regions):
        if region.area == 0:
            continue
        merged = RegionGroup(common(around([region], 1), frame), (position,))
        while touching := [one for one in groups if common(one.box, merged.box).area]:
            groups = [one for one in groups if one not in touching]
            for one in touching:
                merged = RegionGroup(around([one.box, merged.box]), one.members + merged.members)
        groups.append(RegionGroup(merged.box, tuple(sorted(merged.members))))
    return sorted(groups, key=lambda group: group.members)


def common(one: Region, other: Region) -> Region:
    """The pixels of both regions; of no area if there are none."""
    x, y = max(one.x, other.x), max(one.y, other.y)
    right, bottom = (
        min(one.x + one.width, other.x + other.width),
        min(one.y + one.height, other.y + other.height),
    )
    return Region(x, y, max(0, right - x), max(0, bottom - y))


def slices_in(region: Region, box: Region) -> tuple[slice, slice]:
    """Row and column slices that cut a region out of an array of the box around it."""
    return Region(region.x - box.x, region.y - box.y, region.width, region.height).slices


def around(regions: Iterable[Region], margin: int = 0) -> Region:
    """The box of all that have an area, with a margin; of no area if there are none."""
    boxes = [(one.x, one.y, one.x + one.width, one.y + one.height) for one in regions if one.area]
    if not boxes:
        return Region(0, 0, 0, 0)
    left, top, right, bottom = zip(*boxes, strict=True)
    x, y = min(left) - margin, min(top) - margin
    return Region(x, y, max(right) + margin - x, max(bottom) + margin - y)
